"""What is sent: more where more is left to be told, and never more than there is."""

import numpy as np
import pytest

from dvc.config import CodecConfig, VideoConfig, allocation
from dvc.wynerziv import quantizer
from dvc.wynerziv.buffered import quantize_frame
from dvc.wynerziv.layout import FrameLayout
from dvc.wynerziv.one_way import syndrome_length
from encoder.one_way import needs
from encoder.one_way.needs import NeedEstimator

SHARED = allocation(28)
CONFIG = CodecConfig.preset("3d-te", VideoConfig(64, 48, 25, 1, luma_only=True), wyner_ziv=SHARED.wyner_ziv)
LAYOUT = FrameLayout.of(CONFIG)
LUMA = np.random.default_rng(1).integers(0, 256, (48, 64), dtype=np.uint8)
QUANTIZATION, _ = quantize_frame(LAYOUT, LUMA, quantizer.index_of_step(SHARED.step(4)))


def lengths(magnitude: float, margin_percent: int = 60, distance: int = 4) -> tuple[int, int]:
    """Return planes and bits that are sent where the residual is the same everywhere."""
    magnitudes = np.full((48, 16), magnitude)
    sent = NeedEstimator(CONFIG, margin_percent).choose(QUANTIZATION, magnitudes, distance, LAYOUT.num_bits)
    assert all(depth <= planes for depth, planes in zip(sent.depths, QUANTIZATION.planes, strict=True))
    return sum(sent.depths), sum(map(syndrome_length, sent.length_codes))


def test_larger_residuals_need_more() -> None:
    """More planes, and longer syndromes; nothing where there is nothing to tell."""
    found = [lengths(magnitude) for magnitude in (0.0, 5.0, 20.0, 80.0)]
    assert found[0] == (0, 0)
    assert found == sorted(found)
    assert found[1][1] < found[2][1] < found[3][1]


def test_margins_lengthen_syndromes_alone() -> None:
    """Up to what the planes hold."""
    planes, bits = zip(*(lengths(20.0, margin) for margin in (0, 60, 1000)), strict=True)
    assert len(set(planes)) == 1
    assert bits[0] < bits[1] < bits[2]
    assert bits[1] / bits[0] == pytest.approx(1.6, rel=0.1)
    assert lengths(20.0, 10**9)[1] < 1.3 * planes[0] * LAYOUT.num_bits


@pytest.mark.parametrize("distance", [2, 3, 4, 8, 16, 32, 256])
def test_every_distance_has_its_needs(distance: int) -> None:
    """Anchors, too."""
    planes, bits = lengths(30.0, distance=distance)
    assert planes > 0
    assert bits > 0


def test_pictures_without_whole_blocks_are_sent_as_if_unknown() -> None:
    """What cannot be estimated is expected to be large."""
    sent = NeedEstimator(CONFIG, 0).choose(QUANTIZATION, np.empty((0, 16)), 2, LAYOUT.num_bits)
    assert sent.depths[0] == QUANTIZATION.planes[0]


def test_tables_are_those_of_a_laplacian() -> None:
    """Entropy of wide distributions grows by one bit an octave, where the error is that of a bin."""
    entropy, error = needs._tables()
    assert entropy[0] < 0.15
    assert (np.diff(entropy) > 0).all()
    assert entropy[-9] - entropy[-17] == pytest.approx(1.0, abs=0.02)
    assert error[0] == pytest.approx(2.0, rel=0.1)
    assert error[-17] * 4.0**2 == pytest.approx(1 / 12, rel=0.05)  # bins of a quarter of the scale
