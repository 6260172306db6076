"""Cameras: projection and its inverse, epipolar geometry, aim, tremor, paths of any length."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sequences.scene_cameras import Camera, back_project, intrinsics, look_at, project, there_and_back, tremor
from tests.reference.epipolar import fundamental_matrix


def a_camera(eye: tuple[float, float, float], turn: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    return Camera(intrinsics(352, 288, 50.0), look_at(eye, (0.0, 10.0, 1.0), turn), 352, 288)


def test_back_projection_inverts_projection() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform((-3, 5, -1), (3, 20, 4), (50, 3))
    camera = a_camera((0.5, -1.0, 1.6), (1.0, -2.0, 3.0))
    xy, depth = project(camera, points)
    np.testing.assert_allclose(back_project(camera, xy, depth), points, atol=1e-11)


def test_fundamental_matrix_annihilates_images_of_one_point() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform((-3, 5, -1), (3, 20, 4), (50, 3))
    a, b = a_camera((0.0, 0.0, 1.6)), a_camera((0.4, 0.1, 1.5), (0.5, 1.0, -2.0))
    matrix = fundamental_matrix(a, b)
    ones = np.ones((50, 1))
    in_a, in_b = (np.hstack([project(camera, points)[0], ones]) for camera in (a, b))
    lines = in_a @ matrix.T
    distance = np.abs((in_b * lines).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1])
    assert distance.max() < 1e-9
    assert np.linalg.svd(matrix, compute_uv=False)[2] < 1e-12


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (2.0, -3.0, 5.0)])
def test_aim_is_a_rigid_motion(turn: tuple[float, float, float]) -> None:
    camera = a_camera((1.0, -2.0, 1.5), turn)
    rotation = camera.cam_from_world[:, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(camera.centre, (1.0, -2.0, 1.5), atol=1e-12)
    # The target is imaged at the principal point, and points above it at smaller rows.
    camera = a_camera((1.0, -2.0, 1.5))
    xy, _ = project(camera, np.array([[0.0, 10.0, 1.0], [0.0, 10.0, 2.0], [1.0, 10.0, 1.0]]))
    np.testing.assert_allclose(xy[0], (175.5, 143.5), atol=1e-9)
    assert xy[1, 1] < xy[0, 1] - 10
    assert xy[2, 0] > xy[0, 0] + 10


def test_tremor_is_smooth_with_unit_variance() -> None:
    values = np.array([tremor(t, 5, 1.0, 3.0) for t in np.linspace(0, 200, 4001)])
    assert abs(values.mean()) < 0.1
    assert values.std() == pytest.approx(1.0, abs=0.1)
    assert np.abs(np.diff(values)).max() < 4 * 2 * np.pi * 3.0 * 0.05


@given(st.floats(0.0, 1e4), st.floats(20.0, 300.0), st.floats(1.0, 9.0))
def test_path_stays_within_its_ends_and_never_jumps(time: float, period: float, ease: float) -> None:
    """Any instant maps into the path, and a frame later the camera is at most one frame's travel away."""
    here, there = there_and_back(time, period, ease), there_and_back(time + 1.0, period, ease)
    assert -1e-9 <= here <= period + 1e-9
    assert abs(there - here) <= 1.0 + 1e-9


def test_path_starts_at_full_speed() -> None:
    steps = np.diff([there_and_back(float(t), 60.0, 5.0) for t in range(40)])
    np.testing.assert_allclose(steps, 1.0)
