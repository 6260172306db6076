"""Weights of points by their distances: what is near counts, what is far away does not."""

import numpy as np
import pytest

from dvc.geometry.cameras import PixelFrame
from sfm.cameras.resection import (
    ResectionProblem,
    image_distances,
    resection_problem,
    robust_weights,
)

FRAME = PixelFrame(352, 288)
IDENTITY = np.hstack([np.eye(3), np.zeros((3, 1))])


def problem_of(num: int) -> ResectionProblem:
    """Return a problem whose camera is the identity, and that has no noise."""
    rng = np.random.default_rng(4)
    x = np.column_stack([rng.uniform(-0.4, 0.4, (num, 2)), np.ones(num), rng.uniform(0.1, 0.4, num)])
    return resection_problem(x, x[:, :2], IDENTITY, FRAME)


def test_weights_fall_with_the_distance_and_end() -> None:
    """Tukey's biweight ends at five and a half standard deviations; Huber's weight never does."""
    problem, num = problem_of(201), 201
    deviations = np.concatenate([np.full(num - 4, 1.1774), [2.75, 5.4, 5.6, 50.0]])
    given = np.concatenate([0.01 * deviations, np.zeros(problem.num_virtual)])
    weights, noise = robust_weights(problem, given, redescending=True)
    assert noise == pytest.approx(0.01, rel=0.02)
    assert weights[num - 4] == pytest.approx((1 - 0.5**2) ** 2, rel=0.02)
    assert weights[num - 3] > 0.0
    assert weights[num - 2] == weights[num - 1] == 0.0
    lasting, _ = robust_weights(problem, given, redescending=False)
    np.testing.assert_allclose(lasting[num - 4 : num], noise / given[num - 4 : num])
    np.testing.assert_allclose(weights[num:], problem.weights[num:] * (noise / problem.sigma) ** 2)


def test_noise_is_never_below_its_bound() -> None:
    """Where all is seen exactly, what is told of the noise is the least that is believed."""
    problem = problem_of(50)
    distances = image_distances(problem, problem.start)
    np.testing.assert_allclose(distances, 0.0, atol=1e-9)
    weights, noise = robust_weights(problem, distances, redescending=True)
    assert noise == problem.min_noise
    np.testing.assert_allclose(weights[:50], 1.0)
