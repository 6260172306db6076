"""One quality for key frames, steps and requests."""

from fractions import Fraction

import numpy as np
import pytest

from dvc.config import (
    INTRA_PERIOD,
    MAX_QP,
    CodecConfig,
    Qp,
    VideoConfig,
    codec_config,
    decode_config,
    encode_config,
    key_lambda,
)
from dvc.video import VideoInfo
from dvc.wynerziv import quantizer
from encoder.__main__ import new_session
from encoder.encoder_options import parser


def test_steps_double_every_six_qps() -> None:
    """They follow those of H.264; a bit must save six times as much, in the mean over roundings."""
    fine, coarse = Qp(24), Qp(30)
    assert (fine.key_qp, coarse.key_qp) == (24, 30)
    assert coarse.wyner_ziv.step(2) == pytest.approx(2 * fine.wyner_ziv.step(2))
    found = []
    for qp in range(24, 36):
        index = quantizer.index_of_step(Qp(qp).wyner_ziv.step(2))
        found.append(quantizer.quantization_of_step(index, (1,) * 16).multiplier / key_lambda(qp))
    assert np.exp(np.mean(np.log(found))) == pytest.approx(6.0, rel=0.1)


@pytest.mark.parametrize("qp", [1, 30, MAX_QP])
def test_every_quality_makes_a_stream(qp: int) -> None:
    config = codec_config(VideoConfig(16, 16, 25, 1), "2d", Qp(qp))
    assert decode_config(encode_config(config)) == config
    step = config.wyner_ziv.step(2)
    assert quantizer.STEPS[quantizer.index_of_step(step)] >= min(step, 1440.0)


def config_of(*options: str) -> CodecConfig:
    arguments = parser().parse_args(["in.mkv", "out.dvc", *options])
    return new_session(arguments, VideoInfo(16, 16, Fraction(25), None)).config


@pytest.mark.parametrize(
    ("options", "length", "intra_period"),
    [
        ("", 8, INTRA_PERIOD),
        ("--no-feedback", 8, INTRA_PERIOD),
        ("--intra-period 7", 8, 7),
        ("--key-frames intra", 16, 0),
        ("--key-frames intra --gop 5", 5, 0),
        ("--wz-q 4", 16, 0),
        ("--wz-q 4 --key-frames predicted", 8, INTRA_PERIOD),
        ("--codec 2d", 2, 0),
        ("--codec 2d --key-frames predicted", 2, INTRA_PERIOD),
        ("--codec 2d --intra-period 5", 2, 5),
        ("--codec 3d-td --wz-q 4", 10, 0),
    ],
)
def test_options_say_whether_key_frames_are_predicted(options: str, length: int, intra_period: int) -> None:
    """Groups are longer if key frames are not predicted, so that each costs more."""
    config = config_of(*options.split())
    assert (config.gop.length, config.key.intra_period) == (length, intra_period)
    assert config.side_information.fallback == "tracks"
    assert config.side_information.track_corrections
    assert decode_config(encode_config(config)) == config


def test_frames_that_predict_others_are_finer() -> None:
    """The farther the references, the more frames depend on a frame: less has to be saved by a bit."""
    shared = Qp(30).wyner_ziv
    steps = [shared.step(distance) for distance in (2, 3, 4, 5, 8, 9, 16, 17, 250)]
    assert steps == sorted(steps, reverse=True)
    assert steps[1] == steps[2] < steps[0]
    assert steps[3] == steps[4] < steps[2]
