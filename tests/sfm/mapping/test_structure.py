"""Triangulation of points from all frames that see them."""

import numpy as np
import pytest

from sfm.mapping.structure import Structure, observations, reprojection_errors, triangulate
from tests.sfm.mapping.moving_camera import K, pose_of, scene, tracks_of


def _known(count: int, noise_px: float = 0.0):
    points, poses = scene(), [pose_of(k) for k in range(count)]
    tracks = tracks_of(poses, points, noise_px)
    return points, Structure(K, dict(enumerate(poses)), np.full_like(points, np.nan)), tracks


def test_exact_tracks_give_exact_points() -> None:
    """Every point with enough parallax is where it is."""
    points, structure, tracks = _known(8)
    numbers, found = triangulate(structure, observations(tracks.seen, range(8)))
    assert len(numbers) > 100
    np.testing.assert_allclose(found, points[numbers], atol=1e-6)


def test_noise_moves_points_little() -> None:
    """A fifth of a pixel stays far below a per cent of the depth at this baseline."""
    points, structure, tracks = _known(12, 0.2)
    numbers, found = triangulate(structure, observations(tracks.seen, range(12)))
    assert np.median(np.linalg.norm(found - points[numbers], axis=1)) < 0.05


def test_a_wrong_observation_does_not_spoil_its_point() -> None:
    """The others agree."""
    points, structure, tracks = _known(10)
    seen = observations(tracks.seen, range(10))
    number = int(np.argmax(np.bincount(seen.points)))
    seen.positions[np.flatnonzero(seen.points == number)[4]] += 30.0
    numbers, found = triangulate(structure, seen)
    assert number in numbers
    np.testing.assert_allclose(found[numbers == number][0], points[number], atol=1e-6)


def test_no_parallax_no_points() -> None:
    """A camera that stands still triangulates nothing."""
    points = scene()
    tracks = tracks_of([pose_of(0)] * 5, points)
    structure = Structure(K, dict.fromkeys(range(5), pose_of(0)), np.full_like(points, np.nan))
    numbers, _ = triangulate(structure, observations(tracks.seen, range(5)))
    assert not len(numbers)


def test_nothing_seen() -> None:
    """Empty frames are no error."""
    numbers, found = triangulate(Structure(K), observations([], []))
    assert len(numbers) == 0
    assert found.shape == (0, 3)


def test_errors_of_unknown_points_are_infinite() -> None:
    """They agree with nothing."""
    _, structure, tracks = _known(3)
    errors = reprojection_errors(structure, observations(tracks.seen, range(3)))
    assert np.isinf(errors).all()
    assert errors.size == pytest.approx(sum(len(each.ids) for each in tracks.seen))
