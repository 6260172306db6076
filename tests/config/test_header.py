"""Configurations as bytes of a stream header."""

import json
from dataclasses import dataclass, fields, replace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import (
    CODERS,
    REFERENCES,
    SFM_BACKENDS,
    VARIANTS,
    CascadeConfig,
    CodecConfig,
    CoderConfig,
    DiscoverMatrix,
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
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
from dvc.config.sections import PRIORS, TRACKS_KINDS
from dvc.errors import BitstreamError

QCIF = VideoConfig(176, 144, 15, 1)
DEFAULT = CodecConfig(QCIF)
BEFORE_SETS = [None] * [field.name for field in fields(KeyFrameConfig)].index("parameter_sets")


def header_of(*values: Any) -> bytes:
    """Return a header with these values after `video`."""
    return msgspec.msgpack.encode([[176, 144, 15, 1], *values])


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
        GopConfig(draw(st.integers(1, 256)), references),
        KeyFrameConfig(
            draw(st.integers(1, 51)),
            draw(st.booleans()),
            draw(st.integers(0, 1024)),
            draw(st.binary(max_size=1024)),
        ),
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
    assert decode_config(encode_config(config)) == config
    assert CodecConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@pytest.mark.parametrize(
    ("config", "num_bytes"),
    [
        (DEFAULT, 8),
        (codec_config(VideoConfig(1920, 1080, 30000, 1001), quality=Qp(37), seed=1), 35),
        (codec_config(QCIF, quality=DiscoverMatrix(8)), 55),
    ],
)
def test_headers_are_small(config: CodecConfig, num_bytes: int) -> None:
    sets = replace(config, key=replace(config.key, parameter_sets=bytes(30)))
    assert len(encode_config(config)) <= num_bytes
    assert len(encode_config(sets)) <= num_bytes + 30 + 8


def test_coders_have_settings_after_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coder of any settings needs nothing but its dataclass; the name of the default coder is left out."""

    @dataclass(frozen=True)
    class Patient(CoderConfig):
        rounds: int = 3
        weights: tuple[int, ...] = ()
        patience: float = 0.5

    monkeypatch.setitem(CODERS._builtin, "patient", Patient)  # type: ignore[attr-defined]
    for coder, values in [
        (CascadeConfig(), None),
        (CascadeConfig(3), [None, 3]),
        (TurboConfig(), ["turbo"]),
        (Patient(), ["patient"]),
        (Patient(3, (1, 2), 0.25), ["patient", None, [1, 2], 0.25]),
    ]:
        config = replace(DEFAULT, coder=coder)
        header = msgspec.msgpack.decode(encode_config(config))
        assert (header[5] if len(header) > 5 else None) == values
        assert decode_config(encode_config(config)) == config


def check_header(data: bytes) -> None:
    """Check that bytes are refused in one line, or are the one form of a configuration."""
    message = ""
    try:
        config = decode_config(data)
    except BitstreamError as err:
        message = str(err)
    assert message or encode_config(config) == data
    assert "\n" not in message
    assert len(message) < 300


LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=40)
    | st.binary(max_size=40)
)
NESTED = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=12) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)


@given(st.binary(max_size=60), st.lists(NESTED, max_size=11))
def test_arbitrary_bytes_and_values_raise_only_bitstream_errors(data: bytes, values: list[Any]) -> None:
    check_header(data)
    check_header(encode_config(DEFAULT) + data)
    check_header(msgspec.msgpack.encode(values))
    check_header(header_of(*values))


@given(configs(), st.data())
def test_changed_values_raise_only_bitstream_errors(config: CodecConfig, data: st.DataObject) -> None:
    values = msgspec.msgpack.decode(encode_config(config))
    array = data.draw(st.sampled_from([values, *(value for value in values if isinstance(value, list))]))
    place = data.draw(st.integers(0, len(array) - 1))
    array[place : place + data.draw(st.integers(0, 1))] = data.draw(st.lists(NESTED, max_size=2))
    check_header(msgspec.msgpack.encode(values))


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"", "truncated"),
        (b"\x90", "lacks the field `video`"),
        (b"\xc0", "`configuration` must be an array, got None"),
        (b"\x91\x93\x01\x01\x01", "`video` lacks the field `frame_rate_den`"),
        (b"\x91\x94\x01\x01\x01\xc0", "`video` lacks the field `frame_rate_den`"),
        (b"\x91\x80", "`video` must be an array, got {}"),
        (b"\x91\x94\x01\x01\x01\xcf" + b"\xff" * 8, "`frame_rate_den` must be from 1 to 2147483647"),
        (b"\x91\x94\x01\x01\x01\xff", "`frame_rate_den` must be from 1 to 2147483647, got -1"),
        (b"\x91" * 4096, "recursion|Expected"),
        (b"\x91\x91" + b"\x81" * 4094, "recursion|truncated"),
        *((b"\x91\x91" + code + b"\xff" * 4, "truncated") for code in (b"\xc6", b"\xc9", b"\xdb")),
        *((code + b"\xff" * 4, "truncated|Expected") for code in (b"\xdd", b"\xdf")),
    ],
)
def test_hostile_headers_are_refused(header: bytes, message: str) -> None:
    """Long lengths, deep nesting, numbers of 64 bits and missing values are refused at no cost."""
    with pytest.raises(BitstreamError, match=f"^configuration: .*({message})"):
        decode_config(header)
    check_header(header)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (["3d-te"], "one form"),
        ([None], "one form"),
        ([None, []], "one form"),
        ([None, [None]], "one form"),
        ([None, [DEFAULT.gop.length, "keys"]], "one form"),
        ([None, None, None, None, ["cascade", 3]], "one form"),
        ([None, None, None, None, ["", 3]], "plane coder '' is not installed"),
        ([None, None, None, None, None, None, [None, 8]], "one form"),
        ([b"2d"], "Expected `str`, got `bytes`"),
        ([None, [True]], "Expected `int`, got `bool`"),
        ([None, None, [*BEFORE_SETS, "30"]], "base64"),
        ([None, None, [*BEFORE_SETS, "MzAw"]], "one form"),
        ([None, None, None, None, ["turbo", 3]], "`coder` has 2 values, 1 known: made by a newer program"),
        ([None, None, None, None, [["turbo"]]], r"must be a string, got \['turbo'\]"),
        ([None, None, None, None, ["t\u00fcrbo"]], "plane coder 't.rbo' is not installed"),
        ([None, None, None, None, None, ["\u20ac"]], "`method` must be"),
        ([None, None, None, None, None, None, [None, float("nan")]], "finite"),
        ([None] * 8 + [0], "one form"),
        ([None] * 9 + [0], "`configuration` has 11 values, 10 known: made by a newer program?"),
        ([None, [2] + 30 * [None]], "`gop` has 31 values, . known: made by a newer program?"),
    ],
)
def test_other_forms_and_kinds_are_refused(values: list[Any], message: str) -> None:
    with pytest.raises(BitstreamError, match=message):
        decode_config(header_of(*values))
    check_header(header_of(*values))


def test_longer_forms_are_refused() -> None:
    assert encode_config(DEFAULT) == bytes.fromhex("91 94 cc b0 cc 90 0f 01")
    for longer in ("dc 00 01 94 cc b0 cc 90 0f 01", "91 94 cd 00 b0 cc 90 0f 01"):
        with pytest.raises(BitstreamError, match="one form"):
            decode_config(bytes.fromhex(longer))


def test_damaged_headers_raise_only_bitstream_errors() -> None:
    """Every cut and changes of every byte of a header is refused, or reads as another valid configuration."""
    key, side_information = KeyFrameConfig(25, True, 8, b"\x01\x02"), SideInformationConfig("x")
    config = codec_config(QCIF, "2d", DiscoverMatrix(8), key=key, side_information=side_information, seed=7)
    header = encode_config(config)
    for position in range(len(header)):
        check_header(header[:position])
        for value in range(0, 256, 5):
            check_header(header[:position] + bytes([value]) + header[position + 1 :])
