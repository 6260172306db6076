"""The encoder's side of a Wyner-Ziv frame: planes of its coefficients, and what is written of them."""

import numpy as np
import pytest

from dvc.config import (
    CODERS,
    CodecConfig,
    DiscoverMatrix,
    Live,
    NoFeedback,
    ParityBuffer,
    Qp,
    Quality,
    VideoConfig,
    codec_config,
)
from dvc.wynerziv import quantizer
from dvc.wynerziv.quantizer import FrameLayout
from encoder.wyner_ziv import LiveEncoder, WynerZivEncoder, wyner_ziv_encoder
from tests.clips import moving_texture

FRAMES = moving_texture(3, 32, 48, (3.0, 5.0))


def config_of(quality: Quality, coder: str = "cascade") -> CodecConfig:
    return codec_config(VideoConfig(48, 32, 25, 1), quality=quality, coder=CODERS[coder]())


@pytest.mark.parametrize(("quality", "coder"), [(Qp(30), "cascade"), (DiscoverMatrix(4), "turbo")])
def test_frames_of_a_group_are_those_coded_alone(quality: Quality, coder: str) -> None:
    """In every order and with every step, however they are delivered."""
    config = config_of(quality, coder)
    steps = [config.wyner_ziv.step(distance) for distance in (2, 8, 4)]
    together = WynerZivEncoder(config).encode_group(FRAMES, steps)
    for frame, coded, step in zip(FRAMES, together, steps, strict=True):
        alone = LiveEncoder(config).encode(frame, step)
        assert alone.header == coded.header
        assert alone.buffered_payload() == coded.buffered_payload()


def test_steps_are_said_in_the_header() -> None:
    """Finer frames have more planes."""
    config = config_of(Qp(30))
    layout, encoder = FrameLayout.of(config), WynerZivEncoder(config)
    num_planes = []
    for step in (config.wyner_ziv.step(2), config.wyner_ziv.step(16)):
        (coded,) = encoder.encode_group(FRAMES[:1], [step])
        found = layout.read_header(coded.header)
        assert found.step_indices[0] == quantizer.index_of_step(step)
        np.testing.assert_array_equal(found.planes, coded.quantization.planes)
        num_planes.append(sum(found.planes))
    assert 0 < num_planes[0] < num_planes[1]


def test_records_hold_what_the_delivery_sends() -> None:
    """All planes in a file, headers where a decoder asks; nothing is coded without feedback."""
    config = config_of(Qp(30))
    for delivery, is_whole in ((ParityBuffer(), True), (Live(), False)):
        encoder = wyner_ziv_encoder(config, delivery)
        assert encoder is not None
        frames = encoder.encode_group(FRAMES[:2], [8.0, 8.0])
        sent = encoder.payloads(frames)
        assert sent == tuple(frame.buffered_payload() if is_whole else frame.header for frame in frames)
    assert wyner_ziv_encoder(config, NoFeedback()) is None
