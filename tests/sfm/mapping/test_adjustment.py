"""Bundle adjustment, and the pose of a frame."""

import numpy as np

from sfm.mapping.map_evaluation import trajectory_error
from sfm.mapping.structure import (
    Observations,
    Structure,
    adjust_bundle,
    observations,
    register_frame,
    reprojection_errors,
)
from tests.sfm.mapping.moving_camera import FOCAL, K, pose_of, scene, tracks_of


def _disturbed(count: int) -> tuple[Structure, Observations, dict[int, np.ndarray]]:
    points, poses = scene(), [pose_of(k) for k in range(count)]
    rng = np.random.default_rng(3)
    wrong = {k: pose + rng.normal(0.0, 0.005, (3, 4)) * [0, 0, 0, 1] for k, pose in enumerate(poses)}
    focal = K * np.array([[1.08], [1.08], [1.0]])
    focal[:, 2] = K[:, 2]
    structure = Structure(focal, wrong, points + rng.normal(0.0, 0.02, points.shape))
    seen = observations(tracks_of(poses, points).seen, range(count))
    return structure, seen, dict(enumerate(poses))


def test_adjustment_finds_cameras_and_focal_length() -> None:
    """From a disturbed start, exact tracks lead back to the truth."""
    structure, seen, truth = _disturbed(10)
    for _ in range(2):
        structure = adjust_bundle(structure, seen)
    errors = reprojection_errors(structure, seen)
    assert np.quantile(errors, 0.95) < 0.01
    assert abs(structure.K[0, 0] / FOCAL - 1.0) < 1e-3
    assert trajectory_error(structure.poses, truth).relative < 1e-3


def test_frames_that_are_not_free_stay() -> None:
    """A local adjustment leaves the rest, and the focal length, alone."""
    structure, seen, _ = _disturbed(6)
    adjusted = adjust_bundle(structure, seen, {4, 5}, focal=False)
    assert adjusted.K[0, 0] == structure.K[0, 0]
    for frame in range(4):
        np.testing.assert_allclose(adjusted.poses[frame], structure.poses[frame], atol=1e-9)
    assert not np.allclose(adjusted.poses[5], structure.poses[5], atol=1e-9)


def test_nothing_is_adjusted_without_observations() -> None:
    """The structure stays where no point is known, or each is seen but once."""
    structure, seen, _ = _disturbed(2)
    assert adjust_bundle(structure, seen[np.arange(0)]) is structure
    assert adjust_bundle(structure, seen[seen.frames == 0]) is structure


def test_a_frame_is_located() -> None:
    """In spite of a fifth of wrong points."""
    points = scene()
    seen = observations(tracks_of([pose_of(2.5)], points).seen, [0])
    seen.positions[::5] += 25.0
    pose = register_frame(Structure(K, {}, points), 0, seen)
    assert pose is not None
    np.testing.assert_allclose(pose, pose_of(2.5), atol=1e-4)


def test_a_frame_that_shows_something_else_is_not_located() -> None:
    """Random positions agree on no pose, and few points do not suffice."""
    points = scene()
    seen = observations(tracks_of([pose_of(0)], points).seen, [0])
    rng = np.random.default_rng(0)
    random = Observations(seen.frames, seen.points, rng.uniform(0, 240, seen.positions.shape))
    structure = Structure(K, {}, points)
    assert register_frame(structure, 0, random) is None
    assert register_frame(structure, 0, seen[np.arange(10)]) is None
