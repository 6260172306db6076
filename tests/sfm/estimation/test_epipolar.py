"""Lines, epipoles, distances, and fundamental matrices of cameras."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfm.cameras.camera_pair import projective_camera
from sfm.estimation import epipolar
from tests.reference import sfm_cameras as reference
from tests.sfm.two_views import FRAME, two_views

numbers = st.floats(-3.0, 3.0)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(epipolar.skew(a) @ b, np.cross(a, b), atol=1e-14)


def test_the_constraint_holds_on_exact_matches() -> None:
    """F of two cameras has rank 2 and unit norm, and all exact matches obey it (5.1)."""
    scene = two_views()
    f = scene.fundamental
    singular = np.linalg.svd(f)[1]
    assert singular[2] < 1e-15 * singular[0]
    assert np.linalg.norm(f) == pytest.approx(1.0)
    pair = scene.exact
    assert np.abs(epipolar.sampson_distances(f, pair.first, pair.second)).max() < 1e-10
    assert epipolar.symmetric_distances(f, pair.first, pair.second).max() < 1e-10


def test_cameras_give_back_the_matrix() -> None:
    """R and t of (5.2) reproduce F with a minus sign, and t is its left null vector."""
    f = epipolar.fundamental_to_normalized(two_views().fundamental, FRAME)
    camera = projective_camera(f)
    np.testing.assert_allclose(epipolar.skew(camera[:, 3]) @ camera[:, :3], -f, atol=1e-14)
    np.testing.assert_allclose(camera[:, 3] @ f, 0.0, atol=1e-15)
    assert np.linalg.norm(camera[:, 3]) == pytest.approx(1.0)


def test_distances_agree_with_their_twins() -> None:
    scene = two_views(20, noise_px=0.5)
    f, pair = scene.fundamental, scene.measured
    sampson = epipolar.sampson_distances(f, pair.first, pair.second)
    symmetric = epipolar.symmetric_distances(f, pair.first, pair.second)
    for k, (a, b) in enumerate(zip(pair.first, pair.second, strict=True)):
        assert sampson[k] == pytest.approx(reference.sampson_distance(f, a, b), rel=1e-9)
        in_second = reference.distance_to_line(f @ [*a, 1.0], b)
        in_first = reference.distance_to_line(f.T @ [*b, 1.0], a)
        assert symmetric[k] == pytest.approx(np.sqrt(0.5 * (in_second**2 + in_first**2)), rel=1e-9)


def test_lines_meet_points_and_epipoles() -> None:
    """The line of a point has a unit normal and passes through the match and the epipole."""
    scene = two_views(30)
    lines = epipolar.epipolar_lines(scene.fundamental, scene.exact.first)
    _, second = epipolar.epipoles(scene.fundamental)
    np.testing.assert_allclose(np.hypot(lines[:, 0], lines[:, 1]), 1.0)
    np.testing.assert_allclose((lines[:, :2] * scene.exact.second).sum(axis=1) + lines[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(lines @ second, 0.0, atol=1e-9)


def test_a_point_on_the_epipole_has_no_line() -> None:
    f = epipolar.skew(np.array([10.0, 20.0, 1.0]))
    first, second = epipolar.epipoles(f)
    at = first[None, :2] / first[2]
    assert np.abs(epipolar.epipolar_lines(f, np.round(at))).max() == 0.0
    assert np.isfinite(epipolar.sampson_distances(f, np.round(at), np.round(at))).all()
    assert np.isfinite(epipolar.symmetric_distances(f, np.round(at), np.round(at))).all()
    np.testing.assert_allclose(epipolar.distances_to_epipole(second, at + np.array([3.0, 4.0])), 5.0)
    far, _ = epipolar.epipoles(epipolar.skew(np.array([1.0, 0.0, 0.0])))  # at infinity
    assert np.isinf(epipolar.distances_to_epipole(far, np.zeros((3, 2)))).all()


def test_coordinates_of_a_matrix() -> None:
    f = two_views().fundamental
    back = epipolar.fundamental_to_pixels(epipolar.fundamental_to_normalized(f, FRAME), FRAME)
    np.testing.assert_allclose(back, f, atol=1e-15)
    np.testing.assert_array_equal(epipolar.unit_norm(np.zeros((3, 3))), np.zeros((3, 3)))
