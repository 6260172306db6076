"""The encoder's side of a Wyner-Ziv frame: planes of its coefficients, lazily or at once."""

import numpy as np
import pytest

from dvc.config import CodecConfig, TurboConfig, VideoConfig, WynerZivConfig, allocation
from dvc.wynerziv import quantizer
from dvc.wynerziv.layout import FrameLayout
from encoder.wyner_ziv import WynerZivEncoder
from tests.clips import moving_texture

FRAMES = moving_texture(3, 32, 48, (3.0, 5.0))
SHARED = allocation(30)


def config_of(wyner_ziv: WynerZivConfig, family: str) -> CodecConfig:
    return CodecConfig("2d", VideoConfig(48, 32, 25, 1), wyner_ziv=wyner_ziv, turbo=TurboConfig(family))


@pytest.mark.parametrize(
    ("wyner_ziv", "family"), [(SHARED.wyner_ziv, "cascade"), (WynerZivConfig.preset(4), "classical")]
)
def test_frames_of_a_group_are_those_coded_alone(wyner_ziv: WynerZivConfig, family: str) -> None:
    """In every order and with every step, and whether planes are packed at once or when they are needed."""
    config = config_of(wyner_ziv, family)
    steps = [1.0] * 3 if family == "classical" else [SHARED.step(distance) for distance in (2, 8, 4)]
    at_once, lazy = (WynerZivEncoder(config, lazily=lazily) for lazily in (False, True))
    together = at_once.encode_group(FRAMES, steps)
    later = lazy.encode_group(FRAMES, steps)
    for frame, coded, packed_later, step in zip(FRAMES, together, later, steps, strict=True):
        alone = WynerZivEncoder(config).encode(frame, step)
        assert alone.header == coded.header == packed_later.header
        assert alone.buffered_payload() == coded.buffered_payload() == packed_later.buffered_payload()


def test_steps_are_said_in_the_header() -> None:
    """Finer frames have more planes; the room of lazy frames is used again, group after group."""
    config = config_of(SHARED.wyner_ziv, "cascade")
    layout, encoder = FrameLayout.of(config), WynerZivEncoder(config, lazily=True)
    num_planes = []
    for step in (SHARED.step(2), SHARED.step(16)):
        (coded,) = encoder.encode_group(FRAMES[:1], [step])
        found = layout.read_header(coded.header)
        assert found.step_indices[0] == quantizer.index_of_step(step)
        np.testing.assert_array_equal(found.planes, coded.quantization.planes)
        num_planes.append(sum(found.planes))
    assert 0 < num_planes[0] < num_planes[1]
    assert len(encoder._rooms) == 1
