"""One quality for key frames, steps and requests."""

from fractions import Fraction

import numpy as np
import pytest

from dvc.config import (
    MAX_QP,
    VARIANTS,
    EstimatedRate,
    ParityBuffer,
    Qp,
    VideoConfig,
    WynerZivConfig,
    codec_config,
    decode_config,
    encode_config,
    key_lambda,
)
from dvc.errors import ConfigError
from dvc.video import VideoInfo
from dvc.wynerziv import quantizer
from encoder.options import parser, session


def test_steps_double_every_six_qps() -> None:
    """As those of H.264 do; a bit must save four times what it must there, in the mean over roundings."""
    fine, coarse = Qp(24), Qp(30)
    assert (fine.key_qp, coarse.key_qp) == (24, 30)
    assert coarse.wyner_ziv.step(2) == pytest.approx(2 * fine.wyner_ziv.step(2))
    found = []
    for qp in range(24, 36):
        index = quantizer.index_of_step(Qp(qp).wyner_ziv.step(2))
        found.append(quantizer.quantization_of_step(index, (1,) * 16).multiplier / key_lambda(qp))
    assert np.exp(np.mean(np.log(found))) == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("qp", [1, 30, MAX_QP])
def test_every_quality_makes_a_stream(qp: int) -> None:
    """The configuration survives its header, and steps can be told."""
    config = codec_config(VideoConfig(16, 16, 25, 1), "2d", Qp(qp))
    assert decode_config(encode_config(config)) == config
    step = config.wyner_ziv.step(2)
    assert quantizer.step_from_index(quantizer.index_of_step(step)) >= min(step, 1440.0)


@pytest.mark.parametrize("options", [["--codec", "3d-te", "--qp", "30"], ["--codec", "3d-td", "--wz-q", "4"]])
def test_references_are_warped_by_tracks_at_every_quality(options: list[str]) -> None:
    """And what is rendered is corrected by them."""
    arguments = parser().parse_args(["in.mkv", "out.dvc", *options])
    config = session(arguments, VideoInfo(16, 16, Fraction(25), None)).config
    assert config.side_information.fallback == "tracks"
    assert config.side_information.track_corrections
    assert decode_config(encode_config(config)) == config


def test_key_frames_are_nearer_where_no_decoder_asks() -> None:
    """After shorter tracks, fewer losses, and a shorter period; unless told otherwise."""
    video, words = VideoInfo(16, 16, Fraction(25), None), ["in.mkv", "out.dvc", "--no-feedback"]
    with_feedback, without = (
        VARIANTS["3d-te"].groups(delivery=of).key_frames for of in (ParityBuffer(), EstimatedRate())
    )
    assert without.longest_track_px < with_feedback.longest_track_px
    assert without.lost_share < with_feedback.lost_share
    usual, given = (
        session(parser().parse_args([*words, *more]), video) for more in ([], ["--intra-period", "90"])
    )
    assert usual.config.gop.intra_period == EstimatedRate.intra_period < ParityBuffer.intra_period
    assert given.config.gop.intra_period == 90


def test_groups_do_not_wait_for_each_other_over_a_long_link() -> None:
    """All end with a key frame there, where P-type frames are known at all, unless told otherwise."""
    video, words = VideoInfo(16, 16, Fraction(25), None), ["in.mkv", "out.dvc", "--long-delay"]
    usual, given, matrix = (
        session(parser().parse_args([*words, *more]), video).config
        for more in ([], ["--intra-period", "90"], ["--wz-q", "4"])
    )
    assert (usual.gop.intra_period, given.gop.intra_period, matrix.gop.intra_period) == (1, 90, 0)
    assert usual.coder != codec_config(usual.video).coder


def test_frames_that_predict_others_are_finer() -> None:
    """The farther the references, the more frames depend on a frame: less has to be saved by a bit."""
    shared = Qp(30).wyner_ziv
    steps = [shared.step(distance) for distance in (2, 3, 4, 5, 8, 9, 16, 17, 250)]
    assert steps == sorted(steps, reverse=True)
    assert steps[1] == steps[2] < steps[0]
    assert steps[3] == steps[4] < steps[2]


@pytest.mark.parametrize("qp", [0, 52])
def test_qualities_out_of_range_are_refused(qp: int) -> None:
    """As damaged streams may hold them."""
    with pytest.raises(ConfigError, match="`qp`"):
        WynerZivConfig(qp=qp)
