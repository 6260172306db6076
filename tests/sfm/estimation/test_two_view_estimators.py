"""Fundamental matrices from seven points and from many, the least Sampson distance, and homographies."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from sfm.estimation.epipolar import sampson_distances
from sfm.estimation.two_view_estimators import (
    FundamentalEstimator,
    HomographyEstimator,
    SampsonProblem,
    minimize_sampson,
    tangent_space,
    turned,
)
from tests.reference import sfm_cameras as reference
from tests.sfm.two_views import in_shared_scale, two_views


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Compare unit matrices that are defined up to sign."""
    return float(min(np.abs(a - b).max(), np.abs(a + b).max()))


def test_seven_points_have_the_solutions_of_the_twin() -> None:
    """All real solutions of many samples are those of the plain solver; the true matrix is among them."""
    scene = two_views(40)
    estimator = FundamentalEstimator(scene.exact.first, scene.exact.second)
    truth = in_shared_scale(estimator, scene.fundamental)
    a, b = estimator.first, estimator.second
    for seed in range(20):
        sample = np.random.default_rng(seed).permutation(40)[:7]
        found = estimator.estimate(sample[None])
        plain = reference.seven_point(a[sample], b[sample])
        assert len(found) == len(plain)
        assert all(min(distance(f, g) for g in plain) < 1e-6 for f in found)
        assert min(distance(f, truth) for f in found) < 1e-8
        assert np.linalg.svd(found)[1][:, 2].max() < 1e-8


def test_many_points_have_the_true_matrix() -> None:
    scene = two_views(60)
    estimator = FundamentalEstimator(scene.exact.first, scene.exact.second)
    truth = in_shared_scale(estimator, scene.fundamental)
    for size in (8, 14, 60):
        found = estimator.estimate(np.arange(size)[None])
        assert distance(found[0], truth) < 1e-9


def test_batched_residuals_are_sampson_distances() -> None:
    scene = two_views(50, noise_px=0.5)
    pair = scene.measured
    estimator = FundamentalEstimator(pair.first, pair.second)
    models = np.stack([in_shared_scale(estimator, scene.fundamental), np.diag([1.0, 0.5, 0.0])])
    found = estimator.residuals(models)
    for model, residuals in zip(models, found, strict=True):
        f = estimator.to_pixels(model)
        np.testing.assert_allclose(
            residuals, np.abs(sampson_distances(f, pair.first, pair.second)), rtol=1e-9
        )


def test_gradient_agrees_with_differences() -> None:
    scene = two_views(15, noise_px=1.0)
    estimator = FundamentalEstimator(scene.measured.first, scene.measured.second)
    a, b = estimator.first, estimator.second
    u, s, vt = np.linalg.svd(in_shared_scale(estimator, scene.fundamental))
    f = (u * [s[0], s[1], 0.0]) @ vt
    f /= np.linalg.norm(f)
    jacobian = SampsonProblem(a, b).at(f).gradient @ tangent_space(f)
    for k in range(7):
        step = np.zeros(7)
        step[k] = 1e-6
        ahead = sampson_distances(turned(f, step), a, b)
        behind = sampson_distances(turned(f, -step), a, b)
        np.testing.assert_allclose((ahead - behind) / 2e-6, jacobian[:, k], atol=1e-7)


@pytest.mark.parametrize("kind", ["general", "planar"])
def test_the_minimum_is_that_of_a_general_solver(kind: str) -> None:
    scene = two_views(60, kind, noise_px=0.4)  # type: ignore[arg-type]
    estimator = FundamentalEstimator(scene.measured.first, scene.measured.second)
    a, b = estimator.first, estimator.second
    start = in_shared_scale(estimator, scene.fundamental)
    found = minimize_sampson(start, a, b, max_iterations=50)
    general = least_squares(
        lambda step: sampson_distances(turned(start, step), a, b),
        np.zeros(7),
        xtol=1e-14,
        ftol=1e-14,
    )
    ours = float((sampson_distances(found, a, b) ** 2).sum())
    assert ours <= 2.0 * general.cost * (1 + 1e-6)
    assert np.linalg.svd(found)[1][2] < 1e-15


def test_shared_scale_is_its_own_inverse() -> None:
    """Matrices go to the shared scale and back; no points, or equal ones, still have a scale."""
    scene = two_views(10)
    estimator = FundamentalEstimator(scene.exact.first, scene.exact.second)
    back = estimator.to_pixels(in_shared_scale(estimator, scene.fundamental))
    np.testing.assert_allclose(back, scene.fundamental, atol=1e-14)
    for points in (np.empty((0, 2)), np.ones((5, 2))):
        assert FundamentalEstimator(points, points).scale_px == 1.0


def test_homographies_are_exact_on_exact_matches() -> None:
    scene = two_views(50, "planar")
    estimator = HomographyEstimator(scene.exact.first, scene.exact.second)
    models = estimator.estimate(np.array([[0, 1, 2, 3], [10, 20, 30, 40]]))
    assert estimator.residuals(models).max() < 1e-7
    refined = estimator.refine(models[0], np.ones(50, dtype=bool))
    assert estimator.residuals(refined[None]).max() < 1e-7
    assert estimator.estimate(np.empty((0, 4), dtype=np.int64)).shape == (0, 3, 3)


def test_sampson_distance_of_a_translation() -> None:
    first = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
    estimator = HomographyEstimator(first, first + np.array([6.0, 8.0]))
    identity = estimator.matrices()
    model = identity[1] @ np.linalg.inv(identity[0])
    np.testing.assert_allclose(estimator.residuals(model[None]), np.sqrt(0.5) * 10.0)
