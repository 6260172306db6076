"""Confidence of surfaces: what it rests on, what it weighs, and whether it orders errors."""

import numpy as np
import pytest

from benchmarks.thesis import chapter2 as figure
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.stereo.evaluation import sparsification
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.surface_completion import Evidence, confidence, evidence

LABELS = DisparityLabels(0.0, 1.0, 8)


def pair(image: np.ndarray, *, vertical: bool = False) -> CameraArray:
    """Return two views of one picture, beside or below each other."""
    places = LatticePosition(0.0, 0.0), LatticePosition(0.0, 1.0) if vertical else LatticePosition(1.0, 0.0)
    return CameraArray(tuple(ArrayView(str(k), image, place) for k, place in enumerate(places)))


def stripes(shape: tuple[int, int]) -> np.ndarray:
    """Return vertical stripes: luma rises by 12 levels a pixel, and falls again."""
    levels = 12 * np.abs(np.arange(shape[1]) % 16 - 8)
    return np.broadcast_to(levels[None, :, None], (*shape, 3)).astype(np.uint8)


@pytest.mark.parametrize(
    ("measures", "expected"),
    [
        ((1, 0, 0, 0, 0), 0.52498),
        ((1, 1, 0, 1, 1), 0.99098),
        ((1, 0, 1, 0, 0), 0.04311),
        ((1, 2, 1, 0, 0.5), 0.52498),
    ],
)
def test_weights_of_the_log_odds(measures: tuple[float, ...], expected: float) -> None:
    """Texture and agreement speak for a disparity, a jump nearby against it."""
    told = Evidence(*(np.full((2, 3), value, np.float32) for value in measures))
    found = confidence(told)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_texture_counts_along_the_parallax() -> None:
    """Vertical stripes tell horizontal parallax, and nothing of vertical one."""
    maps = [np.zeros((40, 64), np.int64)] * 2
    beside, below = (
        evidence(pair(stripes((40, 64)), vertical=way), LABELS, maps, 0) for way in (False, True)
    )
    # 12 levels a pixel but at the turns, where it is 0: one or two of fifteen
    np.testing.assert_allclose(np.asarray(beside.texture)[:, 16:48], np.log1p(12.0 * 13.5 / 15), atol=0.04)
    assert not np.asarray(below.texture).any()


def test_jumps_and_agreement_are_seen() -> None:
    """A jump counts by its distance; what the other camera has elsewhere does not agree."""
    own, other = np.full((40, 64), 2), np.full((40, 64), 2)
    own[:, 32:] = 6
    told = evidence(pair(stripes((40, 64))), LABELS, [own, other], 0)
    near = np.asarray(told.near_jump)[20]
    assert near[31] == near[32] == 1.0
    np.testing.assert_allclose(near[[16, 47]], np.exp(-15.0 / 15.0), rtol=0.02)
    same = np.asarray(told.agreement)
    np.testing.assert_array_equal(
        same, np.broadcast_to((np.arange(64) >= 2) & (np.arange(64) < 32), same.shape)
    )
    support = np.asarray(told.support)[20]
    assert support[16] == pytest.approx(29 / 31, abs=0.04)
    assert support[47] == pytest.approx(0.0, abs=1e-6)
    flat = evidence(pair(stripes((40, 64))), LABELS, [other, other], 0)
    assert not np.asarray(flat.near_jump).any()


def test_order_of_a_reconstruction() -> None:
    """The surest pixels are the best: half of what lies under the curve without any order goes."""
    array, truth = figure.two_planes()
    found = reconstruct(array, figure.LABELS)
    for surface, disparity in zip(found.surfaces, truth, strict=True):
        bad = (np.abs(surface.disparity - disparity) > 1.0).ravel()
        area, _ = sparsification(bad, surface.confidence.ravel())
        assert area <= 50.0 * bad.mean()
