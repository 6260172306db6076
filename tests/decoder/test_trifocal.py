"""Transfers between views against plain projection of points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decoder.side_information import _kernels_3d
from decoder.side_information.trifocal import (
    Status,
    inverse_depths,
    inverse_transfer,
    transfer_depths,
    transfer_matrix,
    transfer_points,
    transfer_surface,
)
from sfm.model import PixelFrame
from sfm.projection import project
from tests.scenes_3d import camera_at

FRAME = PixelFrame(96, 80)
CAMERAS = [camera_at(late) for late in (0.0, 1.0, 0.4)]


def scene(count: int = 50) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return points of the first view with their images in three views, in pixels."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(2, 9, count), np.ones(count)])
    return points, [FRAME.to_pixels(project(camera, points)[0]) for camera in CAMERAS]


def test_points_of_two_views_are_found_in_the_third() -> None:
    """Exact correspondences give exact positions, and their depths also in the other views."""
    _, images = scene()
    to_second, to_third = (transfer_matrix(CAMERAS[0], camera, FRAME) for camera in CAMERAS[1:])
    moved = transfer_points(to_second, to_third, images[0], images[1])
    assert (moved.status == Status.VALID).all()
    np.testing.assert_allclose(moved.points, images[2], atol=1e-8)
    again = transfer_depths(to_second, images[0], moved.inverse_depth)
    np.testing.assert_allclose(again.points, images[1], atol=1e-8)


@pytest.mark.parametrize("factor", [-1.0, 3.0, -0.01])
def test_scale_and_sign_of_cameras_do_not_matter(factor: float) -> None:
    """Where points go depends on the cameras as rays only."""
    _, images = scene()
    target = transfer_matrix(CAMERAS[0], factor * CAMERAS[1], FRAME)
    third = transfer_matrix(CAMERAS[0], -factor * CAMERAS[2], FRAME)
    moved = transfer_points(target, third, images[0], images[1])
    np.testing.assert_allclose(moved.points, images[2], atol=1e-8)


def test_transfers_compose_and_invert() -> None:
    """Going to a second view and on to a third is going there at once; the way back leads home."""
    first_second, second_third, first_third = (
        transfer_matrix(CAMERAS[a], CAMERAS[b], FRAME) for a, b in ((0, 1), (1, 2), (0, 2))
    )
    surface = np.random.default_rng(1).uniform(0.1, 0.5, (6, 7))
    at_second = transfer_surface(first_second, surface, 3.0, 8.0)
    flat = at_second.reshape(-1, 3)
    onwards = transfer_depths(second_third, flat[:, :2], flat[:, 2]).points
    direct = transfer_surface(first_third, surface, 3.0, 8.0).reshape(-1, 3)[:, :2]
    np.testing.assert_allclose(onwards, direct, atol=1e-8)
    home = transfer_depths(inverse_transfer(first_second), flat[:, :2], flat[:, 2]).points
    rows, columns = np.indices(surface.shape)
    np.testing.assert_allclose(home, np.stack([columns.ravel(), rows.ravel()], -1) * 8.0 + 3.0, atol=1e-8)


def test_what_cannot_be_transferred_is_marked() -> None:
    """Points behind a camera and matches at the epipole have a status instead of a place."""
    forward = np.column_stack([np.eye(3), [0.0, 0.0, -1.0]])
    transfer = transfer_matrix(np.eye(3, 4), forward, FRAME)
    points = np.array([[47.5, 39.5], [10.0, 10.0], [10.0, 10.0]])
    behind = transfer_depths(transfer, points, np.array([0.5, 2.0, np.nan]))
    np.testing.assert_array_equal(behind.status, [Status.VALID, Status.BEHIND, Status.BEHIND])
    np.testing.assert_array_equal(behind.points[1:], points[1:])
    depth, status = inverse_depths(transfer, points[:2], np.array([[47.5, 39.5], [2.5, 3.5]]))
    assert status[0] == Status.NEAR_EPIPOLE
    assert depth[0] == 0.0
    assert status[1] == Status.VALID
    assert transfer_surface(transfer, np.full((1, 1), 2.0))[0, 0, 2] == _kernels_3d.EMPTY


@given(st.lists(st.floats(-1e4, 1e4), min_size=4, max_size=4), st.booleans())
def test_never_nan(values: list[float], forward: bool) -> None:
    """Whatever the points, transferred places are finite numbers, and no warning is given."""
    target = np.column_stack([np.eye(3), [0.0, 0.0, -1.0]]) if forward else CAMERAS[1]
    points, matches = np.array([values[:2]]), np.array([values[2:]])
    transfer = transfer_matrix(CAMERAS[0], target, FRAME)
    moved = transfer_points(transfer, transfer_matrix(CAMERAS[0], CAMERAS[2], FRAME), points, matches)
    assert np.isfinite(moved.points).all()
    assert np.isfinite(moved.inverse_depth).all()


@pytest.mark.parametrize(
    "camera", [np.eye(3), np.full((3, 4), np.nan), np.column_stack([np.zeros((3, 3)), np.ones(3)])]
)
def test_cameras_that_are_none_are_refused(camera: np.ndarray) -> None:
    """Wrong shapes, nan, and centres at infinity are errors of the caller."""
    with pytest.raises(ValueError, match="source"):
        transfer_matrix(camera, CAMERAS[1], FRAME)
