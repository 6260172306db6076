"""Fundamental matrices from seven points, and from many."""

import numpy as np

from sfm.estimation.epipolar import sampson_distances
from sfm.estimation.two_view_estimators import FundamentalEstimator
from tests.reference import sfm_cameras as reference
from tests.sfm.two_views import in_shared_scale, two_views


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Compare unit matrices that are defined up to sign."""
    return float(min(np.abs(a - b).max(), np.abs(a + b).max()))


def test_seven_points_have_the_solutions_of_the_twin() -> None:
    """All real solutions of many samples are those of the plain solver; the true matrix is among them."""
    scene = two_views(40)
    estimator = FundamentalEstimator(scene.exact.first, scene.exact.second)
    truth = in_shared_scale(estimator.scale, scene.fundamental)
    a, b = estimator._first, estimator._second
    for seed in range(20):
        sample = np.random.default_rng(seed).permutation(40)[:7]
        found = estimator.estimate(sample[None])
        plain = reference.seven_point(a[sample], b[sample])
        assert len(found) == len(plain)
        assert all(min(distance(f, g) for g in plain) < 1e-6 for f in found)
        assert min(distance(f, truth) for f in found) < 1e-8
        assert np.linalg.svd(found)[1][:, 2].max() < 1e-8


def test_many_points_have_the_true_matrix() -> None:
    """Exact matches give the true matrix, of rank 2, from samples of any size above seven."""
    scene = two_views(60)
    estimator = FundamentalEstimator(scene.exact.first, scene.exact.second)
    truth = in_shared_scale(estimator.scale, scene.fundamental)
    for size in (8, 14, 60):
        found = estimator.estimate(np.arange(size)[None])
        assert distance(found[0], truth) < 1e-9


def test_batched_residuals_are_sampson_distances() -> None:
    """The residuals of many models at once are the distances of each in pixels."""
    scene = two_views(50, noise_px=0.5)
    pair = scene.measured
    estimator = FundamentalEstimator(pair.first, pair.second)
    models = np.stack([in_shared_scale(estimator.scale, scene.fundamental), np.diag([1.0, 0.5, 0.0])])
    found = estimator.residuals(models)
    for model, residuals in zip(models, found, strict=True):
        f = estimator.scale.to_pixels(model)
        np.testing.assert_allclose(
            residuals, np.abs(sampson_distances(f, pair.first, pair.second)), rtol=1e-9
        )
