"""The least Sampson distance, and its derivatives."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from sfm.estimation import two_view_estimators
from sfm.estimation.epipolar import sampson_distances
from sfm.estimation.two_view_estimators import FundamentalEstimator, SharedScale
from tests.sfm.two_views import in_shared_scale, two_views


def test_gradient_agrees_with_differences() -> None:
    """The derivative by the seven parameters is the limit of differences."""
    scene = two_views(15, noise_px=1.0)
    estimator = FundamentalEstimator(scene.measured.first, scene.measured.second)
    a, b = estimator._first, estimator._second
    u, s, vt = np.linalg.svd(in_shared_scale(estimator.scale, scene.fundamental))
    f = (u * [s[0], s[1], 0.0]) @ vt
    f /= np.linalg.norm(f)
    _, gradient = two_view_estimators._sampson_gradient(f, a, b, two_view_estimators.constraint_rows(a, b))
    jacobian = gradient @ two_view_estimators._tangent_space(f)
    for k in range(7):
        step = np.zeros(7)
        step[k] = 1e-6
        ahead = sampson_distances(two_view_estimators._turned(f, step), a, b)
        behind = sampson_distances(two_view_estimators._turned(f, -step), a, b)
        np.testing.assert_allclose((ahead - behind) / 2e-6, jacobian[:, k], atol=1e-7)


@pytest.mark.parametrize("kind", ["general", "planar"])
def test_the_minimum_is_that_of_a_general_solver(kind: str) -> None:
    """The sum of squared Sampson distances is as small as a general solver makes it."""
    scene = two_views(60, kind, noise_px=0.4)  # type: ignore[arg-type]
    estimator = FundamentalEstimator(scene.measured.first, scene.measured.second)
    a, b = estimator._first, estimator._second
    start = in_shared_scale(estimator.scale, scene.fundamental)
    found = two_view_estimators.minimize_sampson(start, a, b, max_iterations=50)
    general = least_squares(
        lambda step: sampson_distances(two_view_estimators._turned(start, step), a, b),
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
    scale = SharedScale.of(scene.exact.first, scene.exact.second)
    np.testing.assert_allclose(
        scale.to_pixels(in_shared_scale(scale, scene.fundamental)), scene.fundamental, atol=1e-14
    )
    assert SharedScale.of(np.empty((0, 2)), np.empty((0, 2))).scale_px == 1.0
    assert SharedScale.of(np.ones((5, 2)), np.ones((5, 2))).scale_px == 1.0
