"""One quality for key frames, steps and requests."""

from fractions import Fraction

import pytest

from dvc.config import (
    INTRA_PERIOD,
    MAX_QP,
    ONE_WAY_INTRA_PERIOD,
    VARIANTS,
    CodecConfig,
    VideoConfig,
    WynerZivConfig,
    allocation,
    decode_config,
    encode_config,
)
from dvc.errors import ConfigError
from dvc.video import VideoInfo
from dvc.wynerziv import quantizer
from encoder.options import parser, session


def test_slope_doubles_every_three_qps() -> None:
    """As that of H.264 does, of which it is four times; key frames have the QP itself."""
    fine, coarse = allocation(24), allocation(27)
    assert fine.wyner_ziv.slope == pytest.approx(4.0 * 0.85 * 2.0**4)
    assert (fine.key_qp, coarse.key_qp) == (24, 27)
    assert coarse.wyner_ziv.slope == pytest.approx(2 * fine.wyner_ziv.slope)
    assert coarse.step(2) == pytest.approx(2**0.5 * fine.step(2))


@pytest.mark.parametrize("qp", [1, 30, MAX_QP])
def test_every_quality_makes_a_stream(qp: int) -> None:
    """The configuration survives its header, and steps can be told."""
    shared = allocation(qp)
    config = CodecConfig("2d", VideoConfig(16, 16, 25, 1), wyner_ziv=shared.wyner_ziv)
    assert decode_config(encode_config(config)) == config
    index = quantizer.index_of_step(shared.step(2))
    assert quantizer.step_from_index(index) >= min(shared.step(2), 1440.0)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--codec", "3d-te", "--qp", "30"), "tracks"),
        (("--codec", "3d-te", "--wz-q", "4"), "block-motion"),
        (("--codec", "2d", "--qp", "30"), "block-motion"),
    ],
)
def test_references_are_warped_by_tracks_with_one_quality(options: tuple[str, ...], expected: str) -> None:
    """Presets predict as they did; a codec without points has nothing to warp by."""
    arguments = parser().parse_args(["in.mkv", "out.dvc", *options])
    config = session(arguments, VideoInfo(16, 16, Fraction(25), None)).config
    assert config.side_information.fallback == expected
    assert decode_config(encode_config(config)) == config


def test_key_frames_are_nearer_where_no_decoder_asks() -> None:
    """After shorter tracks, fewer losses, and a shorter period; unless told otherwise."""
    video, words = VideoInfo(16, 16, Fraction(25), None), ["in.mkv", "out.dvc", "--no-feedback"]
    with_feedback, without = (VARIANTS["3d-te"].groups(feedback=of).key_frames for of in (True, False))
    assert without.longest_track_px < with_feedback.longest_track_px
    assert without.lost_share < with_feedback.lost_share
    usual, given = (
        session(parser().parse_args([*words, *more]), video) for more in ([], ["--intra-period", "90"])
    )
    assert usual.config.gop.intra_period == ONE_WAY_INTRA_PERIOD < INTRA_PERIOD
    assert given.config.gop.intra_period == 90


def test_frames_that_predict_others_are_finer() -> None:
    """The farther the references, the more frames depend on a frame: less has to be saved by a bit."""
    shared = allocation(30)
    slopes = [shared.wyner_ziv.slope_between(distance) for distance in (2, 3, 4, 5, 8, 9, 16, 17, 250)]
    assert slopes == sorted(slopes, reverse=True)
    assert slopes[0] == shared.wyner_ziv.slope
    assert slopes[1] == slopes[2] < slopes[0]
    assert slopes[3] == slopes[4] < slopes[2]
    assert WynerZivConfig(slope=5.0).slope_between(7) == 5.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("slope", -1.0),
        ("slope", 1e7),
        ("slope_percent", (0,)),
        ("slope_percent", (101,)),
        ("slope_percent", (9,) * 9),
    ],
)
def test_slopes_out_of_range_are_refused(field: str, value: object) -> None:
    """As damaged streams may hold them."""
    with pytest.raises(ConfigError, match=f"`{field}`"):
        WynerZivConfig(**{field: value})  # type: ignore[arg-type]
