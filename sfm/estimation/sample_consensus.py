"""MAPSAC and LO-RANSAC over anything that can be estimated from samples and has residuals."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dvc.arrays import Floats, Integers, Mask

CONFIDENCE = 0.9999
"""Probability of a sample without outliers that ends the search."""
BATCH = 200
"""Number of samples estimated at once."""
NUM_LOCAL_TRIALS = 20
"""Number of samples of inliers in a local optimisation."""
LOCAL_SAMPLE_FACTOR = 2
"""Size of those samples, in minimal samples."""
NUM_LOCAL_REFINEMENTS = 4
"""Number of refinements with a shrinking threshold that follow."""
SMALL_DATA = 64
"""Largest number of data for sampling by sorted random keys, which avoids frequent repetitions."""


class Estimator(Protocol):
    """A kind of model, together with the data that it explains.

    Attributes
    ----------
    min_num_samples : int
        Number of data that determine a model.
    num_data : int
        Number of all data.
    """

    min_num_samples: int
    num_data: int

    def estimate(self, samples: Integers) -> Floats:
        """Return models (K, ...) from samples (S, m) of data, m >= `min_num_samples`; any number each."""

    def residuals(self, models: Floats) -> Floats:
        """Return the distances (K, N) of all data from models, in pixels and not negative."""

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Return an improved model over its inliers, a mask (N,)."""


@dataclass(frozen=True)
class RobustSettings:
    """Length of the random search, and definition of an outlier."""

    threshold_px: float = 1.0  # least residual of an outlier
    min_num_trials: int = 200  # bounds on the number of samples
    max_num_trials: int = 4000


@dataclass(frozen=True, eq=False)
class RobustResult:
    """The best model of a search."""

    model: Floats | None  # None if no sample gave a model
    score_px2: float  # sum of the squared residuals, each at most the squared threshold
    inliers: Mask  # data within the threshold
    residuals_px: Floats  # distances of all data


def draw_samples(num_data: int, size: int, count: int, rng: np.random.Generator) -> Integers:
    """Draw samples of distinct data."""
    if num_data <= SMALL_DATA:
        keys = rng.random((count, num_data))
        return np.argsort(keys, axis=1, kind="stable")[:, :size].astype(np.int64)
    samples = rng.integers(0, num_data, (count, size))
    ordered = np.sort(samples, axis=1)
    return np.asarray(samples[(ordered[:, 1:] != ordered[:, :-1]).all(axis=1)])


def trials_needed(inlier_fraction: float, sample_size: int) -> float:
    """Return the number of samples after which one is probably free of outliers."""
    good = inlier_fraction**sample_size
    if good <= 1e-12:
        return math.inf
    return math.log1p(-CONFIDENCE) / math.log1p(-min(good, 1 - 1e-12))


def mapsac(estimator: Estimator, settings: RobustSettings, rng: np.random.Generator) -> RobustResult:
    """Search for the model with the least truncated error over random minimal samples."""
    num, size = estimator.num_data, estimator.min_num_samples
    best = RobustResult(None, math.inf, np.zeros(num, dtype=bool), np.full(num, np.inf))
    if num < size:
        return best
    trials, needed = 0, float(settings.max_num_trials)
    while trials < min(max(needed, settings.min_num_trials), settings.max_num_trials):
        count = min(BATCH, settings.max_num_trials - trials)
        trials += count
        models = estimator.estimate(draw_samples(num, size, count, rng))
        best = better(best, estimator, models, settings.threshold_px)
        needed = trials_needed(float(best.inliers.mean()), size)
    return best


def lo_ransac(
    estimator: Estimator, best: RobustResult, settings: RobustSettings, rng: np.random.Generator
) -> RobustResult:
    """Improve a model by larger samples of its inliers and by refinements."""
    inliers = np.flatnonzero(best.inliers)
    if best.model is None or len(inliers) < estimator.min_num_samples:
        return best
    size = min(LOCAL_SAMPLE_FACTOR * estimator.min_num_samples, len(inliers) // 2)
    if size >= estimator.min_num_samples:
        chosen = inliers[draw_samples(len(inliers), size, NUM_LOCAL_TRIALS, rng)]
        best = better(best, estimator, estimator.estimate(chosen), settings.threshold_px)
    for factor in np.linspace(2.0, 1.0, NUM_LOCAL_REFINEMENTS):
        within = best.residuals_px < factor * settings.threshold_px
        if best.model is None or np.count_nonzero(within) < estimator.min_num_samples:
            break
        refined = estimator.refine(best.model, within)
        best = better(best, estimator, refined[None], settings.threshold_px)
    return best


def better(best: RobustResult, estimator: Estimator, models: Floats, threshold_px: float) -> RobustResult:
    """Return the model with the least truncated squared error: one of `models`, if any is better."""
    limit = threshold_px * threshold_px
    step = max(1, 200_000 // max(1, estimator.num_data))  # bounds memory
    for at in range(0, len(models), step):
        residuals = estimator.residuals(models[at : at + step])
        scores = np.minimum(residuals * residuals, limit).sum(axis=1)
        k = int(np.argmin(scores))
        if scores[k] < best.score_px2:
            distances = residuals[k].copy()
            best = RobustResult(models[at + k].copy(), float(scores[k]), distances < threshold_px, distances)
    return best


def noise_scale(residuals: Floats, num_parameters: int) -> float:
    """Estimate the standard deviation of residuals, fewer than half of them wrong."""
    free = residuals.size - num_parameters
    if free <= 0:
        return 0.0
    return 1.4826 * math.sqrt(residuals.size / free) * float(np.median(np.abs(residuals)))
