"""Quarter-sample planes, pyramids and overlapped compensation."""

import numpy as np
import pytest

from decoder.side_information.block_motion import compensation
from tests.clips import moving_texture
from tests.reference import block_motion as reference


@pytest.fixture(scope="module")
def luma() -> np.ndarray:
    """Return a plane with all kinds of samples."""
    return np.random.default_rng(0).integers(0, 256, (9, 13), dtype=np.uint8)


def test_phase_planes_are_interpolated(luma: np.ndarray) -> None:
    """Every quarter sample, the border included, is that of the six-tap filter and of means of two."""
    margin = 5
    phases = compensation.phase_planes(luma, margin)
    assert phases.shape == (4, 4, 9 + 2 * margin, 13 + 2 * margin)
    rng = np.random.default_rng(1)
    for row, column in rng.integers(
        (-4 * margin, -4 * margin), (4 * (9 + margin), 4 * (13 + margin)), (400, 2)
    ):
        got = phases[row % 4, column % 4, row // 4 + margin, column // 4 + margin]
        assert got == reference.sample_at(luma, row, column), (row, column)


def test_low_pass_is_the_mean_of_nine(luma: np.ndarray) -> None:
    """Each sample becomes the rounded mean of its neighbourhood, the border replicated."""
    padded = np.pad(luma.astype(int), 1, mode="edge")
    expected = [[(padded[y : y + 3, x : x + 3].sum() + 4) // 9 for x in range(13)] for y in range(9)]
    np.testing.assert_array_equal(compensation.low_pass(luma), expected)


def test_halve_is_the_mean_of_four(luma: np.ndarray) -> None:
    """Odd sides are padded by replication."""
    padded = np.pad(luma.astype(int), ((0, 1), (0, 1)), mode="edge")
    expected = [
        [(padded[y : y + 2, x : x + 2].sum() + 2) // 4 for x in range(0, 14, 2)] for y in range(0, 10, 2)
    ]
    np.testing.assert_array_equal(compensation.halve(luma), expected)


@pytest.mark.parametrize("block", [2, 4, 8, 16])
def test_compensation_without_motion_is_the_reference(block: int) -> None:
    """Zero offsets reproduce each reference; the prediction is their weighted mean."""
    lumas = [frame.luma for frame in moving_texture(2, 17, 23)]
    rows, columns = -(-17 // block), -(-23 // block)
    offsets = [np.zeros((rows, columns, 2), np.int64)] * 2
    weights = [np.full((rows, columns), share) for share in (0.25, 0.75)]
    phases = [compensation.phase_planes(luma) for luma in lumas]
    prediction, compensated = compensation.compensate(phases, offsets, weights, block, (17, 23))
    for luma, own in zip(lumas, compensated, strict=True):
        np.testing.assert_allclose(own, luma)
    np.testing.assert_allclose(prediction, 0.25 * lumas[0] + 0.75 * lumas[1])


def test_compensation_follows_offsets() -> None:
    """Offsets of whole samples shift the reference, the border replicated."""
    luma = moving_texture(1, 16, 24)[0].luma
    offsets = np.broadcast_to(np.array([4 * 2, 4 * -3]), (2, 3, 2)).copy()
    _, [moved] = compensation.compensate(
        [compensation.phase_planes(luma)], [offsets], [np.ones((2, 3))], 8, (16, 24)
    )
    rows, columns = np.clip(np.arange(16) + 2, 0, 15), np.clip(np.arange(24) - 3, 0, 23)
    np.testing.assert_allclose(moved, luma[rows][:, columns])


def test_resize_field_repeats_vectors() -> None:
    """Each vector covers `factor` blocks in both directions; the last row and column fill the rest."""
    field = np.arange(8).reshape(2, 2, 2)
    fine = compensation.resize_field(field, 5, 3, 2)
    assert fine[:, :, 0].tolist() == [[0, 0, 2], [0, 0, 2], [4, 4, 6], [4, 4, 6], [4, 4, 6]]
