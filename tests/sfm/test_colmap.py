"""COLMAP's estimators behind the project's conventions."""

import numpy as np

from sfm.colmap import estimate_fundamental, estimate_pair
from sfm.estimation.epipolar import symmetric_distances
from sfm.model import Correspondences
from tests.sfm.euclidean import FOCAL_LENGTH, FRAME, euclidean_scene


def with_outliers(num_outliers: int) -> Correspondences:
    """Return noisy correspondences, the first of which are wrong."""
    matches = euclidean_scene(num_points=300, noise_px=0.1).model.correspondences
    second = matches.second.copy()
    second[:num_outliers] += np.random.default_rng(2).uniform(-40, 40, (num_outliers, 2))
    return Correspondences(matches.first, second, matches.error)


def test_fundamental_matrix_through_outliers() -> None:
    """F explains the true points to 0.1 px in the project's pixel convention, and points out the outliers."""
    exact = euclidean_scene(num_points=300).model.correspondences
    found = estimate_fundamental(with_outliers(60), 1.0, seed=3)
    assert found is not None
    fundamental, inliers = found
    assert np.median(symmetric_distances(fundamental, exact.first, exact.second)) < 0.1
    assert inliers[60:].mean() > 0.98
    assert inliers[:60].mean() < 0.2


def test_calibrated_pair() -> None:
    """The camera explains the points, and the focal length is about right."""
    exact = euclidean_scene(num_points=300).model.correspondences
    pair = estimate_pair(with_outliers(0), FRAME, 1.0, 3)
    assert pair is not None
    assert np.median(symmetric_distances(pair.fundamental, exact.first, exact.second)) < 0.1
    assert abs(np.linalg.norm(pair.second_camera) - np.sqrt(3)) < 1e-12
    assert 0.7 < pair.focal_length_px / FRAME.scale_px / FOCAL_LENGTH < 1.4


def test_the_seed_decides() -> None:
    """The same seed gives the same bytes."""
    matches = with_outliers(60)
    first, second = estimate_fundamental(matches, 1.0, 8), estimate_fundamental(matches, 1.0, 8)
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first[0], second[0])


def test_too_few_points() -> None:
    """Nothing comes of seven points, as a value."""
    matches = with_outliers(0)[np.arange(7)]
    assert estimate_fundamental(matches, 1.0, 0) is None
    assert estimate_pair(matches, FRAME, 1.0, 0) is None
