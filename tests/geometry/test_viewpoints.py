"""Viewpoints and the warps between them."""

import numpy as np
import pytest

from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import (
    CalibratedViewpoint,
    between,
    calibrated_warp,
    distance,
    lattice_warp,
    warp_between,
)
from dvc.geometry.warping import warp_grid


def _camera(seed):
    generator = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(np.eye(3) + 0.05 * generator.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    intrinsic = np.array([[90.0, 0.5, 20], [0, 80.0, 12], [0, 0, 1]])
    return CalibratedViewpoint(intrinsic, np.column_stack([rotation, generator.normal(size=3)]))


def test_calibrated_warp_projects_as_cameras_do():
    first, second = _camera(0), _camera(1)
    point = np.array([1.5, 2.5, 40.0])  # in the first camera
    world = first.pose[:, :3].T @ (point - first.pose[:, 3])
    expected = second.intrinsic @ (second.pose[:, :3] @ world + second.pose[:, 3])
    x, y, z = first.intrinsic @ point
    u, v, w = calibrated_warp(first, second) @ np.array([x / z, y / z, 1.0, 1.0 / point[2]])
    np.testing.assert_allclose((u / w, v / w), expected[:2] / expected[2], rtol=1e-10)


def test_lattice_warp_moves_by_disparity():
    warp = lattice_warp(LatticePosition(1.0, 1.0), LatticePosition(3.0, 0.5))
    np.testing.assert_allclose(warp_grid(warp, np.full((2, 2), 2.0))[1, 1], (1 - 4.0, 1 + 1.0, 2.0))


def test_the_ends_of_a_way_are_its_viewpoints():
    first, second = _camera(2), _camera(3)
    for share, end in ((0.0, first), (1.0, second)):
        np.testing.assert_allclose(between(first, second, share).pose, end.pose, atol=1e-10)
    middle = between(first, second, 0.5)
    np.testing.assert_allclose(middle.pose[:, :3] @ middle.pose[:, :3].T, np.eye(3), atol=1e-10)
    assert distance(first, middle) == pytest.approx(0.5 * distance(first, second))


def test_the_middle_of_two_positions():
    first, second = LatticePosition(0.0, 1.0), LatticePosition(3.0, 5.0)
    assert between(first, second, 0.5) == LatticePosition(1.5, 3.0)
    assert distance(first, second) == 5.0


def test_kinds_do_not_mix():
    with pytest.raises(ValueError, match="of one kind"):
        warp_between(LatticePosition(0.0, 0.0), _camera(4))
