"""Error tensors: twin, known shifts, planes of general cameras, borders."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from dvc.dibr.disparity.disparity_codec import adjugates, error_tensor
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, calibrated_warp, lattice_warp
from tests.reference import dibr_disparity as reference

ORIGIN = LatticePosition(0.0, 0.0)
STILL = lattice_warp(ORIGIN, ORIGIN)


def test_agrees_with_its_twin() -> None:
    rng = np.random.default_rng(0)
    target, *views = rng.uniform(size=(4, 7, 9))
    offsets = [(1.0, 0.0), (-0.5, 1.0), (0.0, -2.0)]
    disparities = -1.5 + 0.5 * np.arange(8.0)
    warps = [lattice_warp(ORIGIN, LatticePosition(*offset)) for offset in offsets]
    tensor = error_tensor(target, views, warps, disparities)
    assert tensor.dtype == np.float32
    expected = reference.error_tensor(target, views, offsets, disparities)
    np.testing.assert_allclose(tensor, expected, atol=1e-5)


def test_least_where_the_views_were_moved() -> None:
    texture = gaussian_filter(np.random.default_rng(1).normal(size=(40, 60)), 1.0)
    target, right, below = texture[10:30, 10:50], texture[10:30, 13:53], texture[13:33, 10:50]
    warps = [lattice_warp(ORIGIN, LatticePosition(*offset)) for offset in ((1.0, 0.0), (0.0, 1.0))]
    tensor = error_tensor(target, [right, below], warps, np.arange(6.0))
    assert (tensor[3:, 3:].argmin(axis=2) == 3).all()
    assert tensor[3:, 3:, 3].max() == 0.0


def test_planes_of_rectified_cameras_are_translations() -> None:
    rng = np.random.default_rng(2)
    target, view = rng.uniform(size=(2, 8, 10, 3))
    intrinsics = np.array([[50.0, 0.0, 4.0], [0.0, 50.0, 3.0], [0.0, 0.0, 1.0]])
    cameras = [
        CalibratedViewpoint(intrinsics, np.column_stack([np.eye(3), [x, 0.0, 0.0]])) for x in (0.0, -1.0)
    ]
    general = error_tensor(target, [view], [calibrated_warp(*cameras)], 0.02 * np.arange(5.0))
    warp = lattice_warp(ORIGIN, LatticePosition(1.0, 0.0))
    np.testing.assert_allclose(general, error_tensor(target, [view], [warp], np.arange(5.0)), atol=1e-6)


def test_what_is_not_seen_counts_for_nothing() -> None:
    rng = np.random.default_rng(3)
    target, view = rng.uniform(size=(2, 6, 6))
    blind = np.full((6, 6), np.nan)
    labels = np.arange(3.0)
    both = error_tensor(target, [view, blind], [STILL, STILL], labels)
    alone = error_tensor(target, [view], [STILL], labels)
    np.testing.assert_allclose(both, alone * (2 / 3) / (1 / 2), rtol=1e-5)
    assert not error_tensor(target, [blind], [STILL], labels).any()
    away = np.column_stack([np.diag([1.0, 1.0, -1.0]), np.zeros(3)])
    assert not error_tensor(target, [view], [away], labels).any()


def test_labels_outside_are_as_good_as_blind_ones() -> None:
    target, view = np.random.default_rng(4).uniform(size=(2, 6, 12))
    warp = lattice_warp(ORIGIN, LatticePosition(1.0, 0.0))
    tensor = error_tensor(target, [view], [warp], np.arange(8.0))
    np.testing.assert_allclose(
        tensor[:, 3, 4:], tensor[:, 3, :4].mean(axis=1)[:, None].repeat(4, axis=1), rtol=1e-5
    )


def test_arguments_must_fit() -> None:
    view, labels = np.zeros((4, 4)), np.arange(3.0)
    with pytest.raises(ValueError, match="views"):
        error_tensor(view, [], [], labels)
    with pytest.raises(ValueError, match="channels"):
        error_tensor(view, [np.zeros((4, 4, 3))], [STILL], labels)


def test_adjugates_are_inverses_but_for_positive_scales() -> None:
    rng = np.random.default_rng(0)
    matrices = rng.normal(size=(20, 3, 3))
    determinants = np.linalg.det(matrices)
    assert (determinants > 0).any()
    assert (determinants < 0).any()
    expected = np.linalg.inv(matrices) * np.abs(determinants)[:, None, None]
    np.testing.assert_allclose(adjugates(matrices), expected, atol=1e-12)
    assert not adjugates(np.ones((1, 3, 3))).any()
