"""Warps between views against plain projection of points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.geometry.cameras import PixelFrame, project
from dvc.geometry.triangulation import inverse_depths
from dvc.geometry.warping import EMPTY, inverse_warp, warp_grid, warp_matrix, warp_points
from tests.scenes_3d import camera_at

FRAME = PixelFrame(96, 80)
CAMERAS = [camera_at(position) for position in (0.0, 1.0, 0.4)]


def scene(count: int = 50) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return points of the first view with their images in three views, in pixels."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(2, 9, count), np.ones(count)])
    return points, [FRAME.to_pixels(project(camera, points)[0]) for camera in CAMERAS]


def to_third(second: np.ndarray, third: np.ndarray, images: list[np.ndarray]) -> np.ndarray:
    """Triangulate correspondences of the first two views and warp them to the third."""
    inverse_depth, _ = inverse_depths(images[0], warp_matrix(CAMERAS[0], second, FRAME), images[1])
    warped, visible = warp_points(warp_matrix(CAMERAS[0], third, FRAME), images[0], inverse_depth)
    assert visible.all()
    return warped


@pytest.mark.parametrize("factor", [1.0, -1.0, 3.0, -0.01])
def test_points_of_two_views_are_found_in_the_third(factor: float) -> None:
    _, images = scene()
    third = to_third(factor * CAMERAS[1], -factor * CAMERAS[2], images)
    np.testing.assert_allclose(third, images[2], atol=1e-8)


def test_warps_compose_and_invert() -> None:
    first_second, second_third, first_third = (
        warp_matrix(CAMERAS[a], CAMERAS[b], FRAME) for a, b in ((0, 1), (1, 2), (0, 2))
    )
    depth = np.random.default_rng(1).uniform(0.1, 0.5, (6, 7))
    at_second = warp_grid(first_second, depth, 3.0, 8.0)
    vertices = at_second.reshape(-1, 3)
    onwards = warp_points(second_third, vertices[:, :2], vertices[:, 2])[0]
    direct = warp_grid(first_third, depth, 3.0, 8.0).reshape(-1, 3)[:, :2]
    np.testing.assert_allclose(onwards, direct, atol=1e-8)
    home = warp_points(inverse_warp(first_second), vertices[:, :2], vertices[:, 2])[0]
    rows, columns = np.indices(depth.shape)
    np.testing.assert_allclose(home, np.stack([columns.ravel(), rows.ravel()], -1) * 8.0 + 3.0, atol=1e-8)


def test_what_cannot_be_warped_is_marked() -> None:
    forward = np.column_stack([np.eye(3), [0.0, 0.0, -1.0]])
    warp = warp_matrix(np.eye(3, 4), forward, FRAME)
    points = np.array([[47.5, 39.5], [10.0, 10.0], [10.0, 10.0]])
    warped, visible = warp_points(warp, points, np.array([0.5, 2.0, np.nan]))
    np.testing.assert_array_equal(visible, [True, False, False])
    np.testing.assert_array_equal(warped[1:], points[1:])
    at_epipole, _ = inverse_depths(points[:1], warp, points[:1])
    assert at_epipole[0] == 0.0
    assert warp_grid(warp, np.full((1, 1), 2.0))[0, 0, 2] == EMPTY


@given(st.lists(st.floats(-1e4, 1e4), min_size=4, max_size=4), st.booleans())
def test_never_nan(values: list[float], forward: bool) -> None:
    target = np.column_stack([np.eye(3), [0.0, 0.0, -1.0]]) if forward else CAMERAS[1]
    points, matches = np.array([values[:2]]), np.array([values[2:]])
    inverse_depth, _ = inverse_depths(points, warp_matrix(CAMERAS[0], target, FRAME), matches)
    warped, _ = warp_points(warp_matrix(CAMERAS[0], CAMERAS[2], FRAME), points, inverse_depth)
    assert np.isfinite(inverse_depth).all()
    assert np.isfinite(warped).all()


@pytest.mark.parametrize(
    "camera", [np.eye(3), np.full((3, 4), np.nan), np.column_stack([np.zeros((3, 3)), np.ones(3)])]
)
def test_cameras_that_are_none_are_refused(camera: np.ndarray) -> None:
    with pytest.raises(ValueError, match="source"):
        warp_matrix(camera, CAMERAS[1], FRAME)
