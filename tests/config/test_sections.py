"""Codec configuration: checks and dictionaries."""

import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dvc.config import (
    MAX_QP,
    ZIGZAG,
    CodecConfig,
    DiscoverMatrix,
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
    Qp,
    Quality,
    TurboConfig,
    VideoConfig,
    WynerZivConfig,
    codec_config,
)
from dvc.config.sections import DISCOVER_LEVELS
from dvc.errors import ConfigError
from tests.reference.wynerziv import ZIGZAG_RANK

QCIF = VideoConfig(176, 144, 15, 1)
VIDEO: dict[str, Any] = {"width": 176, "height": 144, "frame_rate_num": 15, "frame_rate_den": 1}
DEFAULT = codec_config(QCIF)


def test_zigzag_and_matrices_follow_the_standard() -> None:
    assert np.argsort(ZIGZAG).reshape(4, 4).tolist() == ZIGZAG_RANK.tolist()
    for q, raster in enumerate(DISCOVER_LEVELS, start=1):
        levels = DiscoverMatrix(q).wyner_ziv.levels
        assert [levels[band] for band in ZIGZAG_RANK.ravel()] == list(raster)
    num_planes = [sum(DiscoverMatrix(q).wyner_ziv.max_planes) for q in range(1, 9)]
    assert num_planes == [10, 11, 17, 30, 36, 45, 50, 63]
    one_by_one = WynerZivConfig((256, 128, 4, 2) + 12 * (0,)).max_planes
    assert one_by_one == (8, 7, 2, 1) + 12 * (0,)


def test_a_coder_has_its_own_settings_only() -> None:
    turbo = replace(DEFAULT, coder=TurboConfig())
    assert turbo.to_dict()["coder"] == {"name": "turbo"}
    values = turbo.to_dict() | {"coder": {"name": "turbo", "batch_percent": 3}}
    with pytest.raises(ConfigError, match="`coder` has no field 'batch_percent'"):
        CodecConfig.from_dict(values)


def test_key_qp_follows_the_quantiser() -> None:
    assert [DiscoverMatrix(q).key_qp for q in range(1, 9)] == [40, 39, 38, 34, 34, 32, 29, 25]
    for q in (0, 9, -1, True, 2.0, "4"):
        with pytest.raises(ConfigError, match="from 1 to 8"):
            DiscoverMatrix(q)  # type: ignore[arg-type]


def test_sizes_of_planes() -> None:
    """Incomplete 4x4 blocks count."""
    sizes = {(176, 144): 1584, (352, 288): 6336, (1, 1): 1, (5, 9): 6}
    assert {size: VideoConfig(*size, 25, 1).num_blocks for size in sizes} == sizes


@pytest.mark.parametrize(
    ("section", "name", "value", "message"),
    [
        ("video", "width", 0, "`width` must be from 1 to 16384, got 0"),
        ("video", "width", 16385, "from 1 to 16384"),
        ("video", "width", True, "`width` is True: Expected `int`, got `bool`"),
        ("video", "width", "176", "`width` is '176': Expected `int`"),
        ("video", "width", None, "Expected `int`, got `null`"),
        ("video", "width", 2**14000, "a number of 14001 bits"),
        ("video", "luma_only", 1, "Expected `bool`, got `int`"),
        ("gop", "length", 257, "from 1 to 256"),
        ("key", "qp", 52, "from 1 to 51"),
        ("key", "intra_period", 1025, "`intra_period` must be from 0 to 1024, got 1025"),
        ("key", "parameter_sets", "no base64!", "base64"),
        ("key", "parameter_sets", "A" * 2000, "limited to 1024 bytes"),
        ("key", "parameter_sets", "\u20ac", "base64"),
        ("wyner_ziv", "levels", [2] * 15, "16 entries"),
        ("wyner_ziv", "levels", [3] + [2] * 15, "powers of two"),
        ("wyner_ziv", "levels", [-2] + [2] * 15, "powers of two"),
        ("wyner_ziv", "levels", [2.0] * 16, r"Expected `int`, got `float` - at `\$\[0\]`"),
        ("wyner_ziv", "levels", 2, "Expected `array`, got `int`"),
        ("geometry", "path_regularity", float("nan"), "finite"),
        ("geometry", "path_regularity", 2**1328, "a number of 1329 bits: Number out of range"),
        ("geometry", "path_regularity", -1, "from 0.0"),
        ("coder", "name", "ldpc", "plane coder 'ldpc' is not installed; available: cascade, turbo"),
        ("coder", "batch_percent", 101, "`batch_percent` must be from 0 to 100"),
        ("side_information", "method", "../x", "`method`"),
        ("side_information", "method", "m" * 33, "`method`"),
        ("side_information", "fallback", "hope", "one of block-motion, tracks, got 'hope'"),
        ("side_information", "unknown", 1, "has no field 'unknown'"),
    ],
)
def test_wrong_values_are_refused(section: str, name: str, value: object, message: str) -> None:
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
        ({"codec": "2d", "video": VIDEO, "seed": 2**31}, "`seed`"),
        ({3: 4}, "has no field 3"),
        ([], "must be a table"),
        (None, "must be a table"),
        ({"codec": "2d", "video": dict(VIDEO, width=8192, height=8192)}, "8192x8192"),
    ],
)
def test_wrong_tables_are_refused(values: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CodecConfig.from_dict(values)  # type: ignore[arg-type]


def test_constructor_checks_too() -> None:
    with pytest.raises(ConfigError, match="`length`"):
        GopConfig(0)
    with pytest.raises(ConfigError, match="`gop` must be a table of fields, got 2"):
        CodecConfig(QCIF, gop=2)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="`references`"):
        codec_config(QCIF, gop={"references": "none"})
    for qp in (0, MAX_QP + 1):
        for kind in (Qp, lambda qp: WynerZivConfig(qp=qp)):
            with pytest.raises(ConfigError, match="`qp`"):
                kind(qp)
    assert GeometryConfig(path_regularity=8) == GeometryConfig(path_regularity=8.0)


def test_importing_the_configuration_is_quick() -> None:
    check = "import dvc.config, sys; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False, timeout=60).returncode == 0


def test_the_default_of_the_library_is_the_codec_that_is_advertised() -> None:
    assert CodecConfig(QCIF) == codec_config(QCIF) == codec_config(QCIF, "3d-te", Qp(30))


@pytest.mark.parametrize(
    ("codec", "quality", "given", "gop", "intra_period"),
    [
        ("2d", Qp(), {}, GopConfig(2, "keys"), 0),
        ("2d", Qp(), {"key": {"intra_period": 9}}, GopConfig(2, "keys"), 9),
        ("3d-td", Qp(), {"gop": {"length": 4, "references": "all"}}, GopConfig(4, "all"), 0),
        ("3d-te", Qp(), {}, GopConfig(8, "hierarchical"), 96),
        ("3d-te", Qp(), {"key": {"intra_period": 0}}, GopConfig(16, "hierarchical"), 0),
        ("3d-te", Qp(), {"key": KeyFrameConfig(intra_period=0)}, GopConfig(16, "hierarchical"), 0),
        ("3d-te", Qp(), {"gop": {"references": "keys"}}, GopConfig(8, "keys"), 96),
        ("3d-te", Qp(), {"gop": GopConfig(3, "all")}, GopConfig(3, "all"), 96),
        ("3d-te", DiscoverMatrix(4), {}, GopConfig(16, "hierarchical"), 0),
        ("3d-te", DiscoverMatrix(4), {"key": {"intra_period": 9}}, GopConfig(8, "hierarchical"), 9),
    ],
)
def test_groups_of_pictures_follow_from_codec_and_quality(
    codec: str, quality: Quality, given: dict[str, Any], gop: GopConfig, intra_period: int
) -> None:
    """Codecs have their own groups, longer ones if key frames are costly; overrides take precedence."""
    config = codec_config(QCIF, codec, quality, **given)
    assert (config.gop, config.key.intra_period) == (gop, intra_period)
    assert config.key.predicted is (intra_period > 0)
