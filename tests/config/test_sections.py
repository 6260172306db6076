"""Codec configuration: checks, dictionaries, header bytes."""

import json
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.bits import encode_varint
from dvc.config import (
    DISCOVER_LEVELS,
    FIELD_NUMBERS,
    MAX_QP,
    PRIORS,
    REFERENCES,
    SFM_BACKENDS,
    TRACKS_KINDS,
    VARIANTS,
    ZIGZAG,
    CascadeConfig,
    CodecConfig,
    DiscoverMatrix,
    EstimatedRate,
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
    Live,
    ParityBuffer,
    Qp,
    SideInformationConfig,
    TracksConfig,
    TurboConfig,
    VideoConfig,
    WynerZivConfig,
    codec_config,
    decode_config,
    encode_config,
)
from dvc.errors import BitstreamError, ConfigError
from tests.reference.wynerziv_transform import ZIGZAG_RANK

QCIF = VideoConfig(176, 144, 15, 1)
VIDEO: dict[str, Any] = {"width": 176, "height": 144, "frame_rate_num": 15, "frame_rate_den": 1}
DEFAULT = codec_config(QCIF)


@st.composite
def configs(draw: st.DrawFn) -> CodecConfig:
    """Draw any valid configuration that differs from the defaults wherever the draw says so."""
    side = st.integers(1, 4096)
    rate = st.integers(1, 2**31 - 1)
    level = st.sampled_from([0, 2, 4, 8, 16, 32, 64, 128, 256])
    references, cascade = draw(st.sampled_from(REFERENCES)), CascadeConfig(draw(st.integers(0, 100)))
    return CodecConfig(
        VideoConfig(draw(side), draw(side), draw(rate), draw(rate), draw(st.booleans())),
        draw(st.sampled_from(list(VARIANTS))),
        GopConfig(
            draw(st.integers(1, 256)),
            references,
            *draw(st.sampled_from([(0, 0), (1, 1), (8, 96), (256, 1024)])),
        ),
        KeyFrameConfig(draw(st.integers(1, 51)), draw(st.booleans()), draw(st.binary(max_size=1024))),
        WynerZivConfig(
            draw(st.one_of(st.just(()), st.lists(level, min_size=16, max_size=16).filter(any).map(tuple))),
            qp=draw(st.integers(1, 51)),
            priors=draw(st.sampled_from(PRIORS)),
        ),
        draw(st.sampled_from([TurboConfig(), cascade])),
        SideInformationConfig(draw(st.from_regex(r"[a-z0-9_-]{1,32}", fullmatch=True))),
        GeometryConfig(draw(st.sampled_from(SFM_BACKENDS)), draw(st.floats(0, 100))),
        TracksConfig(
            draw(st.sampled_from(TRACKS_KINDS)), draw(st.integers(1, 1024)), draw(st.integers(0, 3))
        ),
        draw(st.integers(0, 2**31 - 1)),
    )


@given(configs())
def test_bytes_and_dictionary_give_back_any_configuration(config: CodecConfig) -> None:
    """Both forms give the configuration back, the dictionary also through JSON text."""
    assert decode_config(encode_config(config)) == config
    assert CodecConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_header_of_a_qcif_stream_is_small() -> None:
    """A header with other quantisers and a key QP stays well below 90 bytes beside the parameter sets."""
    config = replace(
        DEFAULT, key=KeyFrameConfig(25, parameter_sets=bytes(30)), wyner_ziv=DiscoverMatrix(8).wyner_ziv
    )
    assert len(encode_config(config)) <= 55 + 30


def test_field_numbers_cover_all_fields_once() -> None:
    """Every field has its own number, and the table is in increasing order of the numbers."""

    def paths(section: Any, prefix: str = "") -> list[str]:
        found = []
        for field in fields(section):
            value = getattr(section, field.name)
            found += paths(value, f"{field.name}.") if is_dataclass(value) else [prefix + field.name]
        return found

    assert sorted([*paths(DEFAULT), "coder.name"]) == sorted(FIELD_NUMBERS)
    assert list(FIELD_NUMBERS.values()) == sorted(set(FIELD_NUMBERS.values()))


def test_zigzag_and_matrices_follow_the_standard() -> None:
    """The scan is the one that H.264 draws, and matrices follow it."""
    assert np.argsort(ZIGZAG).reshape(4, 4).tolist() == ZIGZAG_RANK.tolist()
    for q, raster in enumerate(DISCOVER_LEVELS, start=1):
        levels = DiscoverMatrix(q).wyner_ziv.levels
        assert [levels[band] for band in ZIGZAG_RANK.ravel()] == list(raster)
    assert [sum(DiscoverMatrix(q).wyner_ziv.max_planes) for q in range(1, 9)] == [
        10,
        11,
        17,
        30,
        36,
        45,
        50,
        63,
    ]
    one_by_one = WynerZivConfig((256, 128, 4, 2) + 12 * (0,)).max_planes
    assert one_by_one == (8, 7, 2, 1) + 12 * (0,)


def test_a_coder_has_its_own_settings_only() -> None:
    """Settings of another coder are refused, in a table as in a header."""
    turbo = replace(DEFAULT, coder=TurboConfig())
    assert turbo.to_dict()["coder"] == {"name": "turbo"}
    values = turbo.to_dict() | {"coder": {"name": "turbo", "batch_percent": 3}}
    with pytest.raises(ConfigError, match="`coder` has no field 'batch_percent'"):
        CodecConfig.from_dict(values)
    batched = encode_config(replace(DEFAULT, coder=CascadeConfig(3)))
    number = bytes([FIELD_NUMBERS["coder.batch_percent"]])
    named = encode_varint(FIELD_NUMBERS["coder.name"]) + encode_varint(5) + b"turbo"
    with pytest.raises(BitstreamError, match="`coder` has no field 'batch_percent'"):
        decode_config(batched.replace(number + b"\x03", named + number + b"\x03"))


def test_key_qp_follows_the_quantiser() -> None:
    """Eight quantisers have their key QP, others are refused."""
    assert [DiscoverMatrix(q).key_qp for q in range(1, 9)] == [40, 39, 38, 34, 34, 32, 29, 25]
    for q in (0, 9, -1, True, 2.0, "4"):
        with pytest.raises(ConfigError, match="from 1 to 8"):
            DiscoverMatrix(q)  # type: ignore[arg-type]


def test_sizes_of_planes() -> None:
    """Incomplete 4x4 blocks count."""
    assert [VideoConfig(w, h, 25, 1).num_blocks for w, h in ((176, 144), (352, 288), (1, 1), (5, 9))] == [
        1584,
        6336,
        1,
        6,
    ]


@pytest.mark.parametrize(
    ("section", "name", "value", "message"),
    [
        ("video", "width", 0, "`width` must be from 1 to 16384, got 0"),
        ("video", "width", 16385, "from 1 to 16384"),
        ("video", "width", True, "`width` must be of type int, got True"),
        ("video", "width", 176.0, "of type int"),
        ("video", "width", "176", "of type int, got '176'"),
        ("video", "width", None, "of type int"),
        ("video", "width", 2**14000, "a number of 14001 bits"),
        ("video", "frame_rate_den", 0, "`frame_rate_den`"),
        ("video", "luma_only", 1, "of type bool"),
        ("gop", "length", 257, "from 1 to 256"),
        ("key", "qp", 52, "from 1 to 51"),
        ("key", "parameter_sets", "no base64!", "base64"),
        ("key", "parameter_sets", "A" * 2000, "limited to 1024 bytes"),
        ("key", "parameter_sets", "\u20ac", "base64"),
        ("wyner_ziv", "levels", [2] * 15, "16 entries"),
        ("wyner_ziv", "levels", [3] + [2] * 15, "powers of two"),
        ("wyner_ziv", "levels", [512] + [2] * 15, "powers of two"),
        ("wyner_ziv", "levels", [-2] + [2] * 15, "powers of two"),
        ("wyner_ziv", "levels", [2.0] * 16, "a sequence of integers"),
        ("wyner_ziv", "levels", 2, "a sequence of integers"),
        ("geometry", "path_regularity", float("nan"), "finite"),
        ("geometry", "path_regularity", float("inf"), "finite"),
        ("geometry", "path_regularity", 2**1328, "finite number, got a number of 1329 bits"),
        ("geometry", "path_regularity", -1, "from 0.0"),
        ("coder", "name", "ldpc", "plane coder 'ldpc' is not installed; there are cascade, turbo"),
        ("coder", "batch_percent", 101, "`batch_percent` must be from 0 to 100"),
        ("side_information", "method", "../x", "`method`"),
        ("side_information", "method", "", "`method`"),
        ("side_information", "method", "m" * 33, "`method`"),
        ("side_information", "fallback", "hope", "one of block-motion, tracks, got 'hope'"),
        ("side_information", "unknown", 1, "has no field 'unknown'"),
    ],
)
def test_wrong_values_are_refused(section: str, name: str, value: object, message: str) -> None:
    """A value of the wrong type or out of range is named in one line."""
    values = DEFAULT.to_dict()
    values[section][name] = value
    with pytest.raises(ConfigError, match=message) as caught:
        CodecConfig.from_dict(values)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"codec": "4d", "video": VIDEO}, "`codec` must be one of 2d, 3d, 3d-td, 3d-te, got '4d'"),
        ({"codec": "2d"}, "lacks the field `video`"),
        ({"codec": "2d", "video": {}}, "`video` lacks the field `width`"),
        ({"codec": "2d", "video": 3}, "`video` must be a table"),
        ({"codec": "2d", "video": VIDEO, "seed": 2**31}, "`seed`"),
        ({3: 4}, "has no field 3"),
        ([], "must be a table"),
        (None, "must be a table"),
        ({"codec": "2d", "video": dict(VIDEO, width=8192, height=8192)}, "8192x8192"),
    ],
)
def test_wrong_tables_are_refused(values: object, message: str) -> None:
    """Missing and unknown sections and fields are named."""
    with pytest.raises(ConfigError, match=message):
        CodecConfig.from_dict(values)  # type: ignore[arg-type]


def test_constructor_checks_too() -> None:
    """Sections built in code are checked like those from a dictionary; an integer will do for a float."""
    with pytest.raises(ConfigError, match="`length`"):
        GopConfig(0)
    with pytest.raises(ConfigError, match="of type GopConfig"):
        CodecConfig(QCIF, gop=2)  # type: ignore[arg-type]
    assert GeometryConfig(path_regularity=8) == GeometryConfig(path_regularity=8.0)


@given(st.binary(max_size=60))
def test_arbitrary_bytes_raise_only_bitstream_errors(data: bytes) -> None:
    """Bytes are refused, or are the one form of a configuration."""
    for tail in (data, encode_config(DEFAULT) + data):
        try:
            config = decode_config(tail)
        except BitstreamError:
            continue
        assert encode_config(config) == tail


def test_damaged_headers_raise_only_bitstream_errors() -> None:
    """Every cut and changes of every byte of a header is refused, or reads as another valid configuration."""
    config = codec_config(QCIF, "2d", key=KeyFrameConfig(25, True, b"\x01\x02"), seed=7)
    config = replace(
        config, wyner_ziv=DiscoverMatrix(8).wyner_ziv, side_information=SideInformationConfig("x", True)
    )
    header = encode_config(config)
    cuts = [header[:size] for size in range(len(header))]
    changes = [
        header[:position] + bytes([value]) + header[position + 1 :]
        for position in range(len(header))
        for value in range(0, 256, 5)
    ]
    for damaged in cuts + changes:
        try:
            other = decode_config(damaged)
        except BitstreamError:
            continue
        assert encode_config(other) == damaged


def test_importing_the_configuration_is_quick() -> None:
    """Commands can print their help without numpy."""
    check = "import dvc.config, sys; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False, timeout=60).returncode == 0


def test_the_default_of_the_library_is_the_codec_that_is_advertised() -> None:
    """What is not said is the best codec at the usual quality, in a file with all planes."""
    assert CodecConfig(QCIF) == codec_config(QCIF) == codec_config(QCIF, "3d-te", Qp(30), ParityBuffer())
    assert codec_config(QCIF) == codec_config(QCIF, delivery=Live())
    assert len(encode_config(CodecConfig(QCIF))) == 10


def test_groups_of_pictures_follow_from_codec_quality_and_delivery() -> None:
    """Codecs have their own groups; what is given goes before, and what makes no sense is refused."""
    assert codec_config(QCIF, "2d").gop == GopConfig(2, "keys", 0, 0)
    assert codec_config(QCIF).gop == GopConfig(16, "hierarchical", 8, 96)
    assert codec_config(QCIF, quality=DiscoverMatrix(4)).gop == GopConfig(16, "hierarchical", 0, 0)
    assert codec_config(QCIF, delivery=EstimatedRate()).gop == GopConfig(16, "hierarchical", 8, 16, 0)
    assert codec_config(QCIF, gop={"references": "keys"}).gop.length == 8
    assert codec_config(QCIF, "3d-td", gop={"length": 4, "references": "all"}).gop == GopConfig(
        4, "all", 0, 0
    )
    for wrong in ({"length": 0}, {"references": "none"}):
        with pytest.raises(ConfigError):
            codec_config(QCIF, gop=wrong)
    with pytest.raises(ConfigError, match="codec"):
        codec_config(QCIF, "4d")
    for codec, quality in (("2d", Qp()), ("3d-te", DiscoverMatrix(4))):
        with pytest.raises(ConfigError, match="estimated"):
            codec_config(QCIF, codec, quality, EstimatedRate())


def test_qualities_and_margins_off_their_scales_are_refused() -> None:
    """Where they are made, by name."""
    for qp in (0, MAX_QP + 1):
        with pytest.raises(ConfigError, match="`qp`"):
            Qp(qp)
    with pytest.raises(ConfigError, match="`rate_margin_percent`"):
        EstimatedRate(1001)
