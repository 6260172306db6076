"""Depth on the canvas of layers and sprites: calibrated, and not."""

import numpy as np
import pytest

from dvc.geometry.camera_array import DisparityLabels
from dvc.layers.canvas import Canvas, Frame

FRAME = Frame(3, 2, 20, 10)


def _canvas(labels: DisparityLabels, matrix: np.ndarray | None = None) -> Canvas:
    return Canvas((15, 30), FRAME, labels, 1.0, "middle", 2, matrix)


def test_depth_is_one_by_disparity() -> None:
    scale = _canvas(DisparityLabels(5.0, 1.0, 10)).depth_scale
    np.testing.assert_allclose(scale.depth(np.array([5.0, 10.0])), [0.2, 0.1])


@pytest.mark.parametrize("labels", [DisparityLabels(-3.0, 0.1, 60), DisparityLabels(0.0, 1.0, 60)])
def test_other_disparities_are_shifted(labels: DisparityLabels) -> None:
    depth = _canvas(labels).depth_scale.depth(np.array([labels.highest, labels.lowest]))
    assert depth[0] > 0.0
    assert depth[1] / depth[0] == pytest.approx(20.0)


def test_nothing_is_behind_the_camera() -> None:
    scale = _canvas(DisparityLabels(5.0, 1.0, 10)).depth_scale
    np.testing.assert_array_equal(scale.depth(np.array([0.0, -1.0, 4.0])), [np.inf, np.inf, 0.25])


def test_one_label() -> None:
    assert np.isfinite(_canvas(DisparityLabels(0.0, 1.0, 1)).depth_scale.depth(np.zeros(1))).all()


def test_points_without_calibration() -> None:
    canvas = _canvas(DisparityLabels(5.0, 1.0, 10))
    points = canvas.points(np.full(canvas.shape, 5.0))
    np.testing.assert_allclose(points[..., 2], 0.2)
    middle = (points[6, 12] + points[7, 13]) / 2 - (points[6, 12] - points[6, 12])
    np.testing.assert_allclose(middle[:2], [0.0, 0.0], atol=1e-12)
    assert points[0, 29, 0] > 0 > points[0, 0, 0]


def test_points_with_calibration() -> None:
    """The homography of (2.12) gives points and distances from the plane of the cameras."""
    rng = np.random.default_rng(4)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    focal, offset, centre = 30.0, 1.7, rng.normal(size=3)
    axes = turn @ np.array([[0.4, 0.1, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.35]])
    lattice_from_world = np.linalg.inv(axes)
    first = np.eye(4)
    intrinsics = np.diag([focal, focal, 1.0])
    first[:3, :3] = intrinsics @ lattice_from_world
    first[:3, 3] = -intrinsics @ lattice_from_world @ centre
    first[3, 3] = focal
    swap = np.eye(4)[[0, 1, 3, 2]]
    moved = np.eye(4)
    moved[:, 3] = [9.5, 4.5, -offset, 1.0]
    rectified_from_world = moved @ swap @ first
    canvas = _canvas(DisparityLabels(1.0, 1.0, 10), np.linalg.inv(rectified_from_world))
    disparity = rng.uniform(1.0, 10.0, canvas.shape)
    points = canvas.points(disparity)
    back = np.concatenate([points, np.ones((*canvas.shape, 1))], axis=-1) @ rectified_from_world.T
    y, x = np.indices(canvas.shape)
    expected = np.stack([x - FRAME.left, y - FRAME.top, disparity], axis=-1)
    np.testing.assert_allclose(back[..., :3] / back[..., 3:], expected, atol=1e-9)
    distance = (points - centre) @ turn[:, 2]
    np.testing.assert_allclose(canvas.depth_scale.depth(disparity), distance, rtol=1e-9)
