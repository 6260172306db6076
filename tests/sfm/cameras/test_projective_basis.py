"""A camera that keeps two points where they are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.geometry.cameras import project
from sfm.cameras import projective_basis as pb
from tests.sfm.two_views import FRAME, two_views

SCENE = two_views(60)
POINTS = SCENE.model.points
IMAGE = FRAME.to_normalized(SCENE.exact.second)
BASIS = pb.camera_basis(POINTS[:2], IMAGE[:2])


def test_the_basis_is_orthonormal_and_null() -> None:
    """The equations (A.1) of two points have rank 4; W has orthonormal columns and A W = 0 (A.2)."""
    constraints = np.vstack(pb.projection_equations(POINTS[:2], IMAGE[:2]))
    assert np.linalg.matrix_rank(constraints) == 4
    np.testing.assert_allclose(constraints @ SCENE.camera.ravel(), 0.0, atol=1e-13)
    np.testing.assert_allclose(BASIS.T @ BASIS, np.eye(8), atol=1e-14)
    np.testing.assert_allclose(constraints @ BASIS, 0.0, atol=1e-13)
    camera = pb.camera_from_coordinates(BASIS, pb.coordinates_of_camera(BASIS, SCENE.camera))
    np.testing.assert_allclose(camera, SCENE.camera, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_any_coordinates_keep_both_points(seed: int) -> None:
    r = np.random.default_rng(seed).normal(size=8)
    camera = pb.camera_from_coordinates(BASIS, r)
    assert (camera * camera).sum() == pytest.approx(3.0)
    xy, depth = project(camera, POINTS[:2])
    if np.abs(depth).min() > 1e-3:
        np.testing.assert_allclose(xy, IMAGE[:2], atol=1e-9)
    np.testing.assert_allclose(pb.coordinates_of_camera(BASIS, camera), r / np.linalg.norm(r), atol=1e-12)


def test_equal_points_are_refused() -> None:
    with pytest.raises(ValueError, match="differ"):
        pb.camera_basis(POINTS[[0, 0]], IMAGE[[0, 0]])
    with pytest.raises(ValueError, match="two points"):
        pb.camera_basis(POINTS[:3], IMAGE[:3])


def test_choice_obeys_its_constraints() -> None:
    """Chosen points have small errors and are far from each other; the generator decides among them."""
    first, second = FRAME.to_normalized(SCENE.exact.first), IMAGE
    errors = np.linspace(0.0, 1.0, 60)
    pairs = set()
    for seed in range(10):
        pair = pb.choose_fixed_points(first, second, SCENE.camera, errors, np.random.default_rng(seed))
        assert pair is not None
        assert pair.max() < 16
        extent = np.hypot(*np.ptp(first, axis=0))
        assert np.hypot(*(first[pair[0]] - first[pair[1]])) >= 0.4 * extent
        pairs.add(tuple(pair.tolist()))
        again = pb.choose_fixed_points(first, second, SCENE.camera, errors, np.random.default_rng(seed))
        np.testing.assert_array_equal(pair, again)
    assert len(pairs) > 1


def test_choice_relaxes_and_gives_up() -> None:
    """Two points near each other will do if there are no others; equal points, or one, will not."""
    near = np.array([[0.0, 0.0], [1e-3, 0.0], [0.3, 0.3]])
    rng = np.random.default_rng(0)
    errors = np.array([0.0, 0.1, np.inf])
    pair = pb.choose_fixed_points(near, near, SCENE.camera, errors, rng)
    assert pair is not None
    assert set(pair.tolist()) == {0, 1}
    assert pb.choose_fixed_points(np.zeros((5, 2)), np.zeros((5, 2)), SCENE.camera, np.zeros(5), rng) is None
    assert pb.choose_fixed_points(near[:1], near[:1], SCENE.camera, np.zeros(1), rng) is None
