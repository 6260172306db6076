"""Alignment of trajectories."""

import numpy as np
import pytest

from sfm.mapping.map_evaluation import align, centre, trajectory_error
from tests.sfm.mapping.moving_camera import pose_of


def _similar(pose: np.ndarray, scale: float, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the pose after the world has become ``scale R x + t``."""
    rotation = pose[:, :3] @ R.T
    return np.column_stack([rotation, scale * pose[:, 3] - rotation @ t])


R = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
R *= np.sign(np.linalg.det(R))


def test_similar_trajectories_have_no_error() -> None:
    """Rotation, shift and scale of the world do not count."""
    truth = {k: pose_of(k) for k in range(20)}
    own = {k: _similar(pose, 3.0, R, np.array([1.0, -2.0, 0.5])) for k, pose in truth.items()}
    error = trajectory_error(own, truth)
    assert error.rms < 1e-9
    assert error.scale == pytest.approx(1.0 / 3.0)
    assert error.num_located == 20


def test_error_is_that_of_the_centres() -> None:
    """Frames that are off by a known distance, to both sides, give it back."""
    truth = {k: pose_of(k) for k in range(40)}
    own = {
        k: pose - pose[:, :3] @ [[0, 0, 0, 0], [0, 0, 0, 0.01 * (-1) ** k], [0, 0, 0, 0]]
        for k, pose in truth.items()
    }
    error = trajectory_error(own, truth)
    assert error.rms == pytest.approx(0.01, rel=0.05)
    steps = np.diff([centre(pose) for pose in truth.values()], axis=0)
    assert error.relative == pytest.approx(error.rms / np.linalg.norm(steps, axis=1).sum())


def test_only_common_frames_are_compared() -> None:
    """The rest of the truth does not count."""
    truth = {k: pose_of(k) for k in range(20)}
    assert trajectory_error({k: truth[k] for k in (3, 7, 9, 12)}, truth).num_located == 4


def test_two_points_are_too_few() -> None:
    """A similarity needs three."""
    with pytest.raises(ValueError, match="three pairs"):
        align(np.zeros((2, 3)), np.zeros((2, 3)))
