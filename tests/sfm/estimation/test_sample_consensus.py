"""The loop of robust estimation, on straight lines."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.arrays import Floats, Integers, Mask
from sfm.estimation.sample_consensus import (
    RobustSettings,
    draw_samples,
    lo_ransac,
    mapsac,
    noise_scale,
    trials_needed,
)


class LineEstimator:
    """Lines y = a x + b: the smallest estimator there is."""

    min_num_samples = 2

    def __init__(self, points: Floats) -> None:
        self.num_data = len(points)
        self.points = points

    def estimate(self, samples: Integers) -> Floats:
        a, b = self.points[samples[:, 0]], self.points[samples[:, -1]]
        step = np.where(b[:, 0] == a[:, 0], 1e-9, b[:, 0] - a[:, 0])
        slope = (b[:, 1] - a[:, 1]) / step
        return np.stack([slope, a[:, 1] - slope * a[:, 0]], axis=1)

    def residuals(self, models: Floats) -> Floats:
        line = models[:, :1] * self.points[:, 0] + models[:, 1:]
        return np.abs(line - self.points[:, 1])

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        del model
        x, y = self.points[inliers].T
        matrix = np.column_stack([x, np.ones_like(x)])
        return np.linalg.lstsq(matrix, y, rcond=None)[0]


def line_with_outliers(num: int, seed: int) -> tuple[LineEstimator, Mask]:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-10.0, 10.0, num)
    y = 0.5 * x + 2.0 + rng.normal(0.0, 0.05, num)
    wrong = rng.random(num) < 0.4
    y[wrong] = rng.uniform(-20.0, 20.0, np.count_nonzero(wrong))
    return LineEstimator(np.column_stack([x, y])), wrong


@pytest.mark.parametrize("seed", range(4))
def test_a_line_among_outliers(seed: int) -> None:
    estimator, wrong = line_with_outliers(200, seed)
    settings = RobustSettings(threshold_px=0.2)
    rng = np.random.default_rng(seed)
    found = mapsac(estimator, settings, rng)
    better = lo_ransac(estimator, found, settings, rng)
    assert better.model is not None
    np.testing.assert_allclose(better.model, [0.5, 2.0], atol=0.02)
    assert better.score_px2 <= found.score_px2
    assert better.inliers[~wrong].mean() > 0.98


@pytest.mark.parametrize("num", [0, 1])
def test_too_few_data_give_no_model(num: int) -> None:
    estimator = LineEstimator(np.zeros((num, 2)))
    rng = np.random.default_rng(0)
    found = mapsac(estimator, RobustSettings(), rng)
    assert found.model is None
    assert lo_ransac(estimator, found, RobustSettings(), rng) is found


@given(st.integers(7, 300), st.integers(1, 7), st.integers(0, 5))
def test_samples_are_distinct(num: int, size: int, seed: int) -> None:
    samples = draw_samples(num, size, 50, np.random.default_rng(seed))
    assert samples.shape[1] == size
    assert len(samples) >= 20
    assert samples.min() >= 0
    assert samples.max() < num
    assert all(len(set(sample)) == size for sample in samples.tolist())


def test_number_of_trials() -> None:
    """The number of samples follows log(1 - p) / log(1 - w^n), and its limits."""
    expected = math.log(1e-4) / math.log(1 - 0.5**7)
    assert trials_needed(0.5, 7) == pytest.approx(expected)
    assert trials_needed(0.0, 7) == math.inf
    assert trials_needed(1.0, 7) < 1.0


def test_noise_scale() -> None:
    """The scale is that of the good residuals, and 0 if the fit has used all of them up."""
    rng = np.random.default_rng(0)
    residuals = rng.normal(0.0, 0.3, 20_000)
    residuals[:4000] = 50.0
    assert 0.3 < noise_scale(residuals, 0) < 0.45
    assert noise_scale(residuals[4000:], 0) == pytest.approx(0.3, rel=0.03)
    assert noise_scale(np.ones(7), 7) == 0.0
