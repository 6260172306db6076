"""MAPSAC and LO-RANSAC over anything that can be estimated from samples and has residuals."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

SMALL_DATA = 64  # below this, samples are drawn by sorting random keys: repeated points would be too frequent


class Estimator(Protocol):
    """A kind of model, together with the data that it is to explain.

    Attributes
    ----------
    min_num_samples : int
        Data that determine a model.
    num_data : int
        All data.
    """

    min_num_samples: int
    num_data: int

    def estimate(self, samples: Indices) -> Floats:
        """Estimate models from many samples at once.

        Parameters
        ----------
        samples : ndarray of shape (S, m), int64
            Data of each sample, m >= `min_num_samples`.

        Returns
        -------
        ndarray of shape (K, ...), float64
            Models of all samples; none or several per sample are fine.
        """

    def residuals(self, models: Floats) -> Floats:
        """Measure how far all data are from models.

        Parameters
        ----------
        models : ndarray of shape (K, ...), float64
            Models.

        Returns
        -------
        ndarray of shape (K, N), float64
            Distances in pixels, not negative.
        """

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Improve one model over its inliers.

        Parameters
        ----------
        model : ndarray, float64
            Where to start.
        inliers : ndarray of shape (N,), bool
            Which data count.

        Returns
        -------
        ndarray, float64
            The refined model.
        """


@dataclass(frozen=True)
class RobustSettings:
    """How long to search, and what an outlier is."""

    threshold_px: float = 1.0  # residual from which a datum is an outlier
    # probability of having drawn one sample without outliers before the search stops
    confidence: float = 0.9999
    min_num_trials: int = 200  # bounds on the number of samples
    max_num_trials: int = 4000
    batch: int = 200  # samples that are estimated at once
    num_local_trials: int = 20  # samples of inliers in a local optimisation
    local_sample_factor: int = 2  # size of those samples, in minimal samples
    num_local_refinements: int = 4  # refinements with a shrinking threshold that follow

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if not self.threshold_px > 0:
            raise ValueError(f"`threshold_px` must be positive, got {self.threshold_px}")
        if not 0 < self.confidence < 1:
            raise ValueError(f"`confidence` must be in (0, 1), got {self.confidence}")
        if not 1 <= self.min_num_trials <= self.max_num_trials:
            bounds = f"{self.min_num_trials} and {self.max_num_trials}"
            raise ValueError(f"`min_num_trials` must be in [1, max_num_trials], got {bounds}")


@dataclass(frozen=True, eq=False)
class RobustResult:
    """The best model that was found."""

    model: Floats | None  # the model; None if no sample gave any
    score_px2: float  # sum of the squared residuals, each at most the squared threshold
    inliers: Mask  # data within the threshold
    residuals_px: Floats  # distances of all data
    num_trials: int  # samples drawn


def draw_samples(num_data: int, size: int, count: int, rng: np.random.Generator) -> Indices:
    """Draw samples of distinct data."""
    if num_data <= SMALL_DATA:
        keys = rng.random((count, num_data))
        return np.argsort(keys, axis=1, kind="stable")[:, :size].astype(np.int64)
    samples = rng.integers(0, num_data, (count, size))
    ordered = np.sort(samples, axis=1)
    distinct: Indices = samples[(ordered[:, 1:] != ordered[:, :-1]).all(axis=1)]
    return distinct


def trials_needed(inlier_fraction: float, sample_size: int, confidence: float) -> float:
    """Return how many samples make it likely that one is free of outliers."""
    good = inlier_fraction**sample_size
    if good <= 1e-12:
        return math.inf
    return math.log1p(-confidence) / math.log1p(-min(good, 1 - 1e-12))


def mapsac(estimator: Estimator, settings: RobustSettings, rng: np.random.Generator) -> RobustResult:
    """Search for the model with the least truncated error over random minimal samples."""
    best = no_model(estimator.num_data)
    if estimator.num_data < estimator.min_num_samples:
        return best
    trials = 0
    needed: float = settings.max_num_trials
    while trials < min(max(needed, settings.min_num_trials), settings.max_num_trials):
        count = min(settings.batch, settings.max_num_trials - trials)
        trials += count
        samples = draw_samples(estimator.num_data, estimator.min_num_samples, count, rng)
        best = better(best, best_of(estimator, estimator.estimate(samples), settings.threshold_px))
        share = best.inliers.mean()
        needed = trials_needed(float(share), estimator.min_num_samples, settings.confidence)
    return RobustResult(best.model, best.score_px2, best.inliers, best.residuals_px, trials)


def lo_ransac(
    estimator: Estimator, start: RobustResult, settings: RobustSettings, rng: np.random.Generator
) -> RobustResult:
    """Improve a model by larger samples of its inliers and by refinements."""
    best = start
    inliers = np.flatnonzero(start.inliers)
    if best.model is None or len(inliers) < estimator.min_num_samples:
        return start
    size = min(settings.local_sample_factor * estimator.min_num_samples, len(inliers) // 2)
    if size >= estimator.min_num_samples and settings.num_local_trials:
        chosen = inliers[draw_samples(len(inliers), size, settings.num_local_trials, rng)]
        best = better(best, best_of(estimator, estimator.estimate(chosen), settings.threshold_px))
    for factor in np.linspace(2.0, 1.0, settings.num_local_refinements):
        within = best.residuals_px < factor * settings.threshold_px
        if best.model is None or np.count_nonzero(within) < estimator.min_num_samples:
            break
        refined = estimator.refine(best.model, within)
        best = better(best, best_of(estimator, refined[None], settings.threshold_px))
    trials = start.num_trials + settings.num_local_trials
    return RobustResult(best.model, best.score_px2, best.inliers, best.residuals_px, trials)


def best_of(estimator: Estimator, models: Floats, threshold_px: float) -> RobustResult:
    """Choose among models the one with the least truncated squared error."""
    best = no_model(estimator.num_data)
    limit = threshold_px * threshold_px
    step = max(1, 200_000 // max(1, estimator.num_data))  # bounds memory
    for at in range(0, len(models), step):
        residuals = estimator.residuals(models[at : at + step])
        scores = np.minimum(residuals * residuals, limit).sum(axis=1)
        k = int(np.argmin(scores))
        if scores[k] < best.score_px2:
            found = residuals[k].copy()
            best = RobustResult(models[at + k].copy(), float(scores[k]), found < threshold_px, found, 0)
    return best


def better(a: RobustResult, b: RobustResult) -> RobustResult:
    """Return the one with the lower score; `a` if they are equal."""
    return b if b.score_px2 < a.score_px2 else a


def no_model(num_data: int) -> RobustResult:
    """Return the result of a search that found nothing."""
    return RobustResult(None, math.inf, np.zeros(num_data, dtype=bool), np.full(num_data, np.inf), 0)


def noise_scale(residuals: Floats, num_parameters: int = 0) -> float:
    """Estimate the standard deviation of residuals of which fewer than half are wrong."""
    free = residuals.size - num_parameters
    if free <= 0:
        return 0.0
    return 1.4826 * math.sqrt(residuals.size / free) * float(np.median(np.abs(residuals)))
