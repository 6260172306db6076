"""Exposures of views: what their surfaces tell of them, and surfaces where they differ."""

import numpy as np

from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.stereo.surfaces.occupancy import Occupancy
from dvc.stereo.surfaces.photometric import MIN_POINTS, gains, with_gains
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from tests.stereo.data import pair_of_planes

LABELS = DisparityLabels(0.0, 1.0, 12)
FACTORS = np.array([0.8, 0.9, 1.1])


def shifted_pair(by: int) -> CameraArray:
    """Return a picture and the same moved to the left, with other levels in each channel."""
    levels = np.random.default_rng(213).integers(40, 200, (30, 60, 3)).astype(np.uint8)
    other = np.rint(np.roll(levels, -by, axis=1) * FACTORS).astype(np.uint8)
    return pair_of(levels, other)


def pair_of(left: np.ndarray, right: np.ndarray) -> CameraArray:
    """Return two views beside each other."""
    views = zip("lr", (left, right), (0.0, 1.0), strict=True)
    return CameraArray(tuple(ArrayView(name, image, LatticePosition(m, 0.0)) for name, image, m in views))


def test_gains_are_those_of_what_both_see() -> None:
    """Channel by channel, along the surface; the reference keeps its levels."""
    array = shifted_pair(3)
    surface = Occupancy(np.full(array.shape, 3), np.ones(array.shape, np.bool_))
    found = gains(array, LABELS, surface)
    np.testing.assert_array_equal(found[0], 1.0)
    np.testing.assert_allclose(found[1], 1.0 / FACTORS, rtol=0.01)
    same = with_gains(array, found)
    assert same[0] is array[0]
    difference = same[1].image[:, :57].astype(int) - array[0].image[:, 3:]
    assert np.abs(difference).mean() < 1.0


def test_few_points_tell_nothing() -> None:
    """Where hardly anything is supported, levels stay as they are."""
    array = shifted_pair(3)
    supported = np.zeros(array.shape, np.bool_)
    supported.ravel()[: MIN_POINTS - 1] = True
    found = gains(array, LABELS, Occupancy(np.full(array.shape, 3), supported))
    np.testing.assert_array_equal(found, 1.0)


def test_surfaces_are_those_of_equal_exposures() -> None:
    """A view that is a fifth darker, in one channel more than in others, changes little; as it is, more."""
    left, right, truth = pair_of_planes()
    darker = pair_of(left, np.rint(right * np.array([0.85, 0.8, 0.75])).astype(np.uint8))
    as_it_is = StereoSettings(exposures=False)
    found = [
        reconstruct(pair_of(left, right), LABELS),
        reconstruct(darker, LABELS),
        reconstruct(darker, LABELS, as_it_is),
    ]
    bad = [float((np.abs(one.surfaces[0].disparity - truth) > 1.0).mean()) for one in found]
    assert bad[1] < bad[0] + 0.001 < bad[2]
