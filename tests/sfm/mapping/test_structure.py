"""Triangulation, bundle adjustment, and poses of frames."""

import numpy as np
import pytest

from benchmarks.map_evaluation import trajectory_error
from sfm.mapping.structure import (
    Observations,
    Structure,
    adjust_bundle,
    observations,
    register_frame,
    reprojection_errors,
    triangulate,
)
from tests.sfm.mapping.moving_camera import FOCAL, K, pose_of, scene, tracks_of


def _known(count: int, noise_px: float = 0.0):
    points, poses = scene(), [pose_of(k) for k in range(count)]
    tracks = tracks_of(poses, points, noise_px)
    return points, Structure(K, dict(enumerate(poses)), np.full_like(points, np.nan)), tracks


@pytest.mark.parametrize(("noise_px", "bound"), [(0.0, 1e-6), (0.2, 0.05)])
def test_points_are_triangulated(noise_px: float, bound: float) -> None:
    points, structure, tracks = _known(12, noise_px)
    numbers, found = triangulate(structure, observations(tracks.seen, range(12)))
    assert len(numbers) > 100
    assert np.median(np.linalg.norm(found - points[numbers], axis=1)) < bound


def test_a_wrong_observation_does_not_spoil_its_point() -> None:
    points, structure, tracks = _known(10)
    seen = observations(tracks.seen, range(10))
    assert np.isinf(reprojection_errors(structure, seen)).all()  # no point has a position yet
    number = int(np.argmax(np.bincount(seen.points)))
    seen.positions[np.flatnonzero(seen.points == number)[4]] += 30.0
    numbers, found = triangulate(structure, seen)
    assert number in numbers
    np.testing.assert_allclose(found[numbers == number][0], points[number], atol=1e-6)


def test_no_parallax_no_points() -> None:
    points = scene()
    tracks = tracks_of([pose_of(0)] * 5, points)
    structure = Structure(K, dict.fromkeys(range(5), pose_of(0)), np.full_like(points, np.nan))
    numbers, _ = triangulate(structure, observations(tracks.seen, range(5)))
    assert not len(numbers)
    numbers, found = triangulate(Structure(K), observations([], []))  # empty frames
    assert len(numbers) == 0
    assert found.shape == (0, 3)


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
    structure, seen, truth = _disturbed(10)
    for _ in range(2):
        structure = adjust_bundle(structure, seen)
    errors = reprojection_errors(structure, seen)
    assert np.quantile(errors, 0.95) < 0.01
    assert abs(structure.K[0, 0] / FOCAL - 1.0) < 1e-3
    assert trajectory_error(structure.poses, truth).relative < 1e-3


def test_frames_that_are_not_free_stay() -> None:
    structure, seen, _ = _disturbed(6)
    adjusted = adjust_bundle(structure, seen, {4, 5}, focal=False)
    assert adjusted.K[0, 0] == structure.K[0, 0]
    for frame in range(4):
        np.testing.assert_allclose(adjusted.poses[frame], structure.poses[frame], atol=1e-9)
    assert not np.allclose(adjusted.poses[5], structure.poses[5], atol=1e-9)
    # Nothing is adjusted without observations, or if each point is seen only once.
    assert adjust_bundle(structure, seen[np.arange(0)]) is structure
    assert adjust_bundle(structure, seen[seen.frames == 0]) is structure


def test_a_frame_is_located() -> None:
    points = scene()
    seen = observations(tracks_of([pose_of(2.5)], points).seen, [0])
    seen.positions[::5] += 25.0
    pose = register_frame(Structure(K, {}, points), 0, seen)
    assert pose is not None
    np.testing.assert_allclose(pose, pose_of(2.5), atol=1e-4)
    # Random positions agree on no pose, and few points do not suffice.
    random = np.random.default_rng(0).uniform(0, 240, seen.positions.shape)
    structure = Structure(K, {}, points)
    assert register_frame(structure, 0, Observations(seen.frames, seen.points, random)) is None
    assert register_frame(structure, 0, seen[np.arange(10)]) is None
