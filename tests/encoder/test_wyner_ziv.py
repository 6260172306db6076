"""The encoder's side of a Wyner-Ziv frame: planes of its coefficients, at once or when they are needed."""

import numpy as np
import pytest

from dvc.config import (
    CODERS,
    CodecConfig,
    DiscoverMatrix,
    EstimatedRate,
    Live,
    ParityBuffer,
    Qp,
    Quality,
    VideoConfig,
    codec_config,
)
from dvc.wynerziv import quantizer
from dvc.wynerziv.quantizer import FrameLayout
from encoder.groups import Group
from encoder.wyner_ziv import RateControlledEncoder, wyner_ziv_encoder
from tests.clips import moving_texture

FRAMES = moving_texture(3, 32, 48, (3.0, 5.0))


def config_of(quality: Quality, coder: str = "cascade") -> CodecConfig:
    return codec_config(VideoConfig(48, 32, 25, 1), quality=quality, coder=CODERS[coder]())


@pytest.mark.parametrize(("quality", "coder"), [(Qp(30), "cascade"), (DiscoverMatrix(4), "turbo")])
def test_frames_of_a_group_are_those_coded_alone(quality: Quality, coder: str) -> None:
    """In every order and with every step, and whether planes are packed at once or when they are needed."""
    config = config_of(quality, coder)
    steps = [config.wyner_ziv.step(distance) for distance in (2, 8, 4)]
    at_once, as_needed = wyner_ziv_encoder(config, ParityBuffer()), wyner_ziv_encoder(config, EstimatedRate())
    together = at_once.encode_group(FRAMES, steps)
    later = as_needed.encode_group(FRAMES, steps)
    for frame, coded, packed_later, step in zip(FRAMES, together, later, steps, strict=True):
        alone = wyner_ziv_encoder(config, Live()).encode(frame, step)
        assert alone.header == coded.header == packed_later.header
        assert alone.buffered_payload() == coded.buffered_payload() == packed_later.buffered_payload()


def test_steps_are_said_in_the_header() -> None:
    """Finer frames have more planes; the memory of coefficients is used again, group after group."""
    config = config_of(Qp(30))
    layout, encoder = FrameLayout.of(config), RateControlledEncoder(config, EstimatedRate())
    num_planes = []
    for step in (config.wyner_ziv.step(2), config.wyner_ziv.step(16)):
        (coded,) = encoder.encode_group(FRAMES[:1], [step])
        found = layout.read_header(coded.header)
        assert found.step_indices[0] == quantizer.index_of_step(step)
        np.testing.assert_array_equal(found.planes, coded.quantization.planes)
        num_planes.append(sum(found.planes))
    assert 0 < num_planes[0] < num_planes[1]
    assert len(encoder._memory) == 1


def test_records_hold_what_the_delivery_sends() -> None:
    """All parity in a file, headers where a decoder asks."""
    config = config_of(Qp(30))
    group = Group(tuple(FRAMES[:2]), FRAMES[2])
    for delivery, is_whole in ((ParityBuffer(), True), (Live(), False)):
        encoder = wyner_ziv_encoder(config, delivery)
        frames = encoder.encode_group(group.wyner_ziv, [8.0, 8.0])
        sent = encoder.payloads(group, frames)
        assert sent == tuple(frame.buffered_payload() if is_whole else frame.header for frame in frames)
