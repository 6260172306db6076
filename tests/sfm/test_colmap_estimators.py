"""COLMAP's estimators behind the project's conventions."""

import numpy as np

from sfm import colmap_estimators
from sfm.estimation.epipolar import symmetric_distances
from sfm.scene_model import Correspondences
from tests.sfm.two_views import FRAME, euclidean_scene


def with_outliers(num_outliers: int) -> Correspondences:
    matches = euclidean_scene(num_points=300, noise_px=0.1).model.correspondences
    second = matches.second.copy()
    second[:num_outliers] += np.random.default_rng(2).uniform(-40, 40, (num_outliers, 2))
    return Correspondences(matches.first, second, matches.error)


def test_fundamental_matrix_through_outliers() -> None:
    """F explains the true points to 0.1 px in the project's pixel convention, and points out the outliers."""
    exact = euclidean_scene(num_points=300).model.correspondences
    found = colmap_estimators.weak_calibration(with_outliers(60), seed=3)
    assert not found.reason
    assert np.median(symmetric_distances(found.fundamental, exact.first, exact.second)) < 0.1
    assert found.inliers[60:].mean() > 0.98
    assert found.inliers[:60].mean() < 0.2


def test_calibrated_pair() -> None:
    exact = euclidean_scene(num_points=300).model.correspondences
    pair = colmap_estimators.camera_pair(with_outliers(0), FRAME, 3)
    assert not pair.reason
    assert np.median(symmetric_distances(pair.fundamental, exact.first, exact.second)) < 0.1
    assert abs(np.linalg.norm(pair.camera) - np.sqrt(3)) < 1e-12
    assert pair.inliers.mean() > 0.98


def test_too_few_points() -> None:
    matches = with_outliers(0)[np.arange(7)]
    assert colmap_estimators.weak_calibration(matches, 0).reason
    assert colmap_estimators.camera_pair(matches, FRAME, 0).reason
