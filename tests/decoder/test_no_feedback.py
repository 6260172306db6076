"""Frames without feedback, decoded one by one: syndromes that are enough, too short, or of another check."""

from dataclasses import replace

import numpy as np
import pytest

from decoder.no_feedback import NoFeedbackDecoder
from decoder.side_information.protocol import Prediction
from decoder.tasks import DecodedFrame
from dvc.config import Qp, VideoConfig, codec_config
from dvc.metrics import psnr_db
from dvc.wynerziv import no_feedback, quantizer
from dvc.wynerziv.lengths import length_code
from dvc.wynerziv.no_feedback import NoFeedbackFrame, SentPlanes, encode_payload
from dvc.wynerziv.payloads import EncodedFrame, quantize_frame
from dvc.wynerziv.quantizer import FrameLayout
from tests.clips import moving_texture

HEIGHT, WIDTH = 96, 128
CONFIG = codec_config(VideoConfig(WIDTH, HEIGHT, 25, 1, luma_only=True), "2d", Qp(32), seed=1)
LAYOUT = FrameLayout.of(CONFIG)
LUMA = next(iter(moving_texture(1, HEIGHT, WIDTH))).luma
QUANTIZATION, WORDS = quantize_frame(LAYOUT, LUMA, quantizer.index_of_step(24.0))
DEPTHS = (QUANTIZATION.planes[0],) + (0,) * 15


def payload(share: float) -> bytes:
    """Encode the frame: the DC band with so many syndrome bits for each of its bits."""
    sent = SentPlanes(DEPTHS, (length_code(share * DEPTHS[0] * LAYOUT.num_bits), 0))
    return encode_payload(EncodedFrame(LAYOUT, QUANTIZATION, WORDS), sent, CONFIG.seed)


def decoded(data: bytes, noise: float) -> DecodedFrame:
    """Decode it from a prediction with errors that are the same in each block, which promises errors of 1."""
    errors = np.random.default_rng(5).laplace(0.0, noise, (HEIGHT // 4, WIDTH // 4)).repeat(4, 0).repeat(4, 1)
    predicted = np.clip(LUMA + errors, 0.0, 255.0)
    prediction = Prediction(predicted, None, (predicted + 1.0, predicted - 1.0), "made up")
    return NoFeedbackDecoder(CONFIG).decode(1, data, prediction)


def gain_db(frame: DecodedFrame) -> float:
    """Return how much better a frame is than its prediction."""
    return psnr_db(LUMA, frame.frame.luma) - psnr_db(LUMA, frame.side_information)


@pytest.mark.parametrize("noise", [2.0, 12.0])
def test_predictions_may_be_worse_than_they_promise(noise: float) -> None:
    """Scales are learned, also from a start that is far too small."""
    frame = decoded(payload(0.9), noise)
    assert frame.num_failed_planes == 0
    assert gain_db(frame) > 1.0


def test_what_is_too_short_serves_as_far_as_it_goes() -> None:
    """It is told, and takes nothing from the prediction."""
    frame = decoded(payload(0.2), 12.0)
    assert frame.num_failed_planes == DEPTHS[0]
    assert gain_db(frame) > 0.0


def test_the_right_syndrome_with_another_check_is_nearly_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few bits that syndromes do not tell apart cost the report, not the picture."""
    right = decoded(payload(0.9), 4.0)
    read = NoFeedbackFrame.read

    def _with_other_checks(*arguments: object) -> NoFeedbackFrame:
        frame = read(*arguments)  # type: ignore[arg-type]
        blocks = (block and replace(block, check=block.check ^ np.uint8(1)) for block in frame.blocks)
        return replace(frame, blocks=tuple(blocks))

    monkeypatch.setattr(no_feedback.NoFeedbackFrame, "read", _with_other_checks)
    frame = decoded(payload(0.9), 4.0)
    assert (right.num_failed_planes, frame.num_failed_planes) == (0, DEPTHS[0])
    np.testing.assert_array_equal(frame.frame.luma, right.frame.luma)
