"""Alignment of trajectories, and rendered views of maps."""

import numpy as np
import pytest

from benchmarks.map_evaluation import centre, render_view, trajectory_error
from sfm.mapping.scene_map import MapPiece
from tests.sfm.mapping.moving_camera import pose_of

SHAPE = (16, 20)
INTRINSICS = np.array([[20.0, 0.0, 9.5], [0.0, 20.0, 7.5], [0.0, 0.0, 1.0]])


def _piece_of(depths: dict[int, np.ndarray]) -> MapPiece:
    poses = {k: np.column_stack([np.eye(3), [-0.1 * k, 0.0, 0.0]]) for k in range(5)}
    return MapPiece(INTRINSICS, poses, np.empty((0, 3)), np.empty((0, 3), np.uint8), depths)


def test_what_has_no_depth_stands_at_infinity() -> None:
    depth = np.full(SHAPE, 4.0, np.float32)
    depth[:8] = np.nan
    picture = np.full((*SHAPE, 1), 90, np.uint8)
    picture[:8] = 200
    piece = _piece_of({0: depth, 4: depth})
    view = render_view(piece, {0: picture, 4: picture}, piece.poses[2])
    assert view.drawn[2:6].all()
    assert view.image[2:6] == pytest.approx(200.0, abs=1.0)
    assert view.image[10:14] == pytest.approx(90.0, abs=1.0)


def test_one_wrong_depth_does_not_cover_what_others_see() -> None:
    """Three frames see a wall, and the fourth has something near before it that is not there."""
    wall, wrong = np.full(SHAPE, 4.0, np.float32), np.full(SHAPE, 4.0, np.float32)
    wrong[4:12, 4:12] = 1.0
    grey, dark = np.full((*SHAPE, 1), 120, np.uint8), np.full((*SHAPE, 1), 20, np.uint8)
    piece = _piece_of({0: wall, 1: wall, 3: wall, 4: wrong})
    view = render_view(piece, {0: grey, 1: grey, 3: grey, 4: dark}, piece.poses[2])
    assert view.image.min() > 80.0


def _similar(pose: np.ndarray, scale: float, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the pose after the world has become ``scale R x + t``."""
    rotation = pose[:, :3] @ R.T
    return np.column_stack([rotation, scale * pose[:, 3] - rotation @ t])


R = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
R *= np.sign(np.linalg.det(R))


def test_similar_trajectories_have_no_error() -> None:
    truth = {k: pose_of(k) for k in range(20)}
    own = {k: _similar(pose, 3.0, R, np.array([1.0, -2.0, 0.5])) for k, pose in truth.items()}
    error = trajectory_error(own, truth)
    assert error.rms < 1e-9
    assert error.scale == pytest.approx(1.0 / 3.0)
    assert error.num_located == 20
    assert trajectory_error({k: truth[k] for k in (3, 7, 9, 12)}, truth).num_located == 4
    with pytest.raises(ValueError, match="three frames"):
        trajectory_error({k: truth[k] for k in (3, 7)}, truth)


def test_error_is_that_of_the_centres() -> None:
    truth = {k: pose_of(k) for k in range(40)}
    own = {
        k: pose - pose[:, :3] @ [[0, 0, 0, 0], [0, 0, 0, 0.01 * (-1) ** k], [0, 0, 0, 0]]
        for k, pose in truth.items()
    }
    error = trajectory_error(own, truth)
    assert error.rms == pytest.approx(0.01, rel=0.05)
    steps = np.diff([centre(pose) for pose in truth.values()], axis=0)
    assert error.relative == pytest.approx(error.rms / np.linalg.norm(steps, axis=1).sum())
