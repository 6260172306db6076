"""Cameras of two pictures from points that they share: known cameras, noise and wrong matches."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvc.errors import DvcError
from dvc.geometry import camera_estimation
from dvc.geometry.calibrated_cameras import Camera
from dvc.geometry.camera_estimation import Features, cameras_of_matches, estimate_cameras

NAMES, SIZE = ("a.jpg", "b.jpg"), (640, 480)


def pair_of_cameras(ratio: float) -> list[Camera]:
    """Return a camera, and one that has moved aside, a little forwards, and turned inwards."""
    K = np.array([[ratio * 640.0, 0.0, 319.5], [0.0, ratio * 640.0, 239.5], [0.0, 0.0, 1.0]])
    R = Rotation.from_euler("xyz", (1.0, 7.0, -2.0), degrees=True).as_matrix()
    centre = np.array([0.9, 0.1, 0.3])
    return [Camera(NAMES[0], K, np.eye(3), np.zeros(3), SIZE), Camera(NAMES[1], K, R, -R @ centre, SIZE)]


def seen(camera: Camera, points: np.ndarray) -> np.ndarray:
    image = np.column_stack([points, np.ones(len(points))]) @ camera.projection.T
    return image[:, :2] / image[:, 2:]


@pytest.mark.parametrize("ratio", [0.7, 0.85, 1.5])
@pytest.mark.parametrize("seed", [0, 1])
def test_cameras_and_depths_are_found(ratio: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = pair_of_cameras(ratio)
    pixels, depth = rng.uniform((0, 0), SIZE, (400, 2)), rng.uniform(3.0, 12.0, (400, 1))
    points = depth * (np.column_stack([pixels, np.ones(400)]) @ np.linalg.inv(true[0].K).T)
    first, second = (seen(camera, points) + 0.3 * rng.normal(size=(400, 2)) for camera in true)
    second[:100] = rng.uniform((0, 0), SIZE, (100, 2))
    found = cameras_of_matches(NAMES, SIZE, first, second)
    again = cameras_of_matches(NAMES, SIZE, first, second)
    assert found.points.tobytes() == again.points.tobytes()
    second_camera = found.cameras[1]
    assert second_camera.focal_length_px == pytest.approx(ratio * 640.0, rel=0.1)
    assert Rotation.from_matrix(second_camera.R @ true[1].R.T).magnitude() < np.radians(0.7)
    direction = true[1].t / np.linalg.norm(true[1].t)
    assert second_camera.t @ direction > np.cos(np.radians(4.0))
    image = seen(found.cameras[0], found.points)
    nearest = np.linalg.norm(image[:, None] - first[None, 100:], axis=2).argmin(axis=1)
    share = found.points[:, 2] / depth[100 + nearest, 0]
    assert np.mean(np.abs(share / np.median(share) - 1.0) < 0.05) > 0.85
    assert len(found.points) > 280


def test_points_lie_before_the_cameras_from_whatever_side_they_are_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, true, consensus = np.random.default_rng(4), pair_of_cameras(1.0), camera_estimation._consensus

    def opposite(*given: Any) -> Any:
        start = consensus(*given)
        return None if start is None else replace(start, t=-start.t)

    points = rng.uniform((-2.0, -1.5, 5.0), (2.0, 1.5, 9.0), (200, 3))
    matches = [seen(camera, points) for camera in true]
    monkeypatch.setattr(camera_estimation, "_consensus", opposite)
    found = cameras_of_matches(NAMES, SIZE, *matches)
    assert found.cameras[1].t @ true[1].t > 0.0
    assert len(found.points) > 150


def test_matches_without_a_common_geometry_are_refused() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(0.0, 400.0, (29, 2))
    with pytest.raises(DvcError, match="29 points match, too few"):
        cameras_of_matches(NAMES, SIZE, points, points + 1.0)
    noise = [rng.integers(0, 256, (60, 80, 3), dtype=np.uint8) for _ in NAMES]
    with pytest.raises(DvcError, match="cannot be estimated"):
        estimate_cameras(NAMES, noise)


def test_faint_points_are_found() -> None:
    rng = np.random.default_rng(3)
    levels = rng.normal(size=(40, 60)).repeat(4, axis=0).repeat(4, axis=1)
    wall = np.rint(128.0 + 3.0 * levels).astype(np.uint8)[:, :, None].repeat(3, axis=2)
    first, second = Features(wall[:, :230]).match(Features(wall[:, 6:236]))
    assert len(first) > 60
    np.testing.assert_allclose(np.median(first - second, axis=0), (6.0, 0.0), atol=0.1)
