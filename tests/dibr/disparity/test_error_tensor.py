"""Error tensors: twin, known shifts, planes of general cameras, borders."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from dvc.dibr.disparity.error_tensor import PlaneInduced, RectifiedTranslation, error_tensor
from dvc.multiview.camera_array import DisparityLabels, LatticePosition
from tests.reference import dibr_disparity as reference


def test_agrees_with_its_twin() -> None:
    """Sub-pixel steps, several offsets, and negative disparities, pixel by pixel."""
    rng = np.random.default_rng(0)
    target, *views = rng.uniform(size=(4, 7, 9))
    offsets = [(1.0, 0.0), (-0.5, 1.0), (0.0, -2.0)]
    labels = DisparityLabels(-1.5, 0.5, 8)
    maps = [RectifiedTranslation(LatticePosition(*offset), labels) for offset in offsets]
    tensor = error_tensor(target, views, maps)
    assert tensor.dtype == np.float32
    expected = reference.error_tensor(target, views, offsets, labels.disparity(np.arange(8.0)))
    np.testing.assert_allclose(tensor, expected, atol=1e-5)


def test_least_where_the_views_were_moved() -> None:
    """A texture that is moved by 3 px per unit has its least error there, near 0."""
    texture = gaussian_filter(np.random.default_rng(1).normal(size=(40, 60)), 1.0)
    target, right, below = texture[10:30, 10:50], texture[10:30, 13:53], texture[13:33, 10:50]
    labels = DisparityLabels(0.0, 1.0, 6)
    positions = LatticePosition(1.0, 0.0), LatticePosition(0.0, 1.0)
    tensor = error_tensor(target, [right, below], [RectifiedTranslation(one, labels) for one in positions])
    assert (tensor[3:, 3:].argmin(axis=2) == 3).all()
    assert tensor[3:, 3:, 3].max() == 0.0


def test_planes_of_rectified_cameras_are_translations() -> None:
    """General cameras that differ by a translation see planes as rectified views do."""
    rng = np.random.default_rng(2)
    target, view = rng.uniform(size=(2, 8, 10, 3))
    intrinsics = np.array([[50.0, 0.0, 4.0], [0.0, 50.0, 3.0], [0.0, 0.0, 1.0]])
    inverse_depth = DisparityLabels(0.0, 0.02, 5)
    general = PlaneInduced(intrinsics, intrinsics, np.eye(3), np.array([-1.0, 0.0, 0.0]), inverse_depth)
    rectified = RectifiedTranslation(LatticePosition(1.0, 0.0), DisparityLabels(0.0, 1.0, 5))
    np.testing.assert_allclose(
        error_tensor(target, [view], [general]), error_tensor(target, [view], [rectified]), atol=1e-6
    )


def test_what_is_not_seen_counts_for_nothing() -> None:
    """Pixels that a view has not seen, or that lie behind it, are left to the other views."""
    rng = np.random.default_rng(3)
    target, view = rng.uniform(size=(2, 6, 6))
    blind = np.full((6, 6), np.nan)
    labels = DisparityLabels(0.0, 1.0, 3)
    still = RectifiedTranslation(LatticePosition(0.0, 0.0), labels)
    both = error_tensor(target, [view, blind], [still, still])
    np.testing.assert_allclose(both, error_tensor(target, [view], [still]) * (2 / 3) / (1 / 2), rtol=1e-5)
    assert not error_tensor(target, [blind], [still]).any()
    away = PlaneInduced(np.eye(3), np.eye(3), np.diag([1.0, 1.0, -1.0]), np.zeros(3), labels)
    assert not error_tensor(target, [view], [away]).any()


def test_arguments_must_fit() -> None:
    """Views without maps, of other channels, or of other labels are refused."""
    view, labels = np.zeros((4, 4)), DisparityLabels(0.0, 1.0, 3)
    still = RectifiedTranslation(LatticePosition(0.0, 0.0), labels)
    with pytest.raises(ValueError, match="views"):
        error_tensor(view, [], [])
    with pytest.raises(ValueError, match="channels"):
        error_tensor(view, [np.zeros((4, 4, 3))], [still])
    other = RectifiedTranslation(LatticePosition(0.0, 0.0), DisparityLabels(0.0, 1.0, 4))
    with pytest.raises(ValueError, match="labels"):
        error_tensor(view, [view, view], [still, other])
