"""Weak calibration: the fundamental matrix of two frames, and the correspondences that obey it."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from dvc.arrays import Floats, Mask
from sfm.estimation.sample_consensus import RobustSettings, lo_ransac, mapsac
from sfm.estimation.two_view_estimators import FundamentalEstimator
from sfm.scene_model import Correspondences

SEARCH = RobustSettings()
"""Threshold on the Sampson distance, and length of the random search."""
MIN_NUM_INLIERS = 14
"""Least number of inliers that confirms a matrix, which seven points determine."""
MIN_THRESHOLD_PX = 0.35
"""Lower bound on the final threshold."""
THRESHOLD_IN_SIGMAS = 3.5
"""The final threshold, in standard deviations of the noise."""


@dataclass(frozen=True, eq=False)
class WeakCalibration:
    """Result of the weak calibration of two frames."""

    fundamental: Floats  # F with ``x1' F x0 = 0`` in pixels, unit norm; zeros on failure
    inliers: Mask  # correspondences that obey it
    residuals_px: Floats  # Sampson distances, not negative; inf on failure, or for points not finite
    noise_px: float  # standard deviation of the Sampson distances of the inliers
    num_trials: int  # number of samples drawn
    reason: str  # reason why the matrix is missing or cannot be trusted; empty if it can

    @property
    def success(self) -> bool:
        """Whether the matrix can be trusted."""
        return not self.reason

    @classmethod
    def missing(cls, num_points: int, reason: str, num_trials: int = 0) -> Self:
        """Return a failure."""
        none, far = np.zeros(num_points, dtype=bool), np.full(num_points, np.inf)
        return cls(np.zeros((3, 3)), none, far, 0.0, num_trials, reason)


def weak_calibration(correspondences: Correspondences, rng: np.random.Generator) -> WeakCalibration:
    """Estimate the fundamental matrix robustly, refine it over its final inliers, and judge it."""
    usable = correspondences.finite
    estimator = FundamentalEstimator(correspondences.first[usable], correspondences.second[usable])
    result = lo_ransac(estimator, mapsac(estimator, SEARCH, rng), SEARCH, rng)
    num, agreeing = len(correspondences), int(np.count_nonzero(result.inliers))
    if estimator.num_data < MIN_NUM_INLIERS:
        reason = f"{estimator.num_data} correspondences, {MIN_NUM_INLIERS} are needed"
        return WeakCalibration.missing(num, reason)
    if result.model is None or agreeing < MIN_NUM_INLIERS:
        reason = f"{agreeing} of {estimator.num_data} correspondences agree on the epipolar geometry"
        return WeakCalibration.missing(num, reason, result.num_trials)
    model, inliers, noise_px = _settle(estimator, result.model, result.inliers)
    residuals, mask = np.full(num, np.inf), usable.copy()
    residuals[usable], mask[usable] = estimator.residuals(model[None])[0], inliers
    count = int(np.count_nonzero(mask))
    reason = "" if count >= MIN_NUM_INLIERS else f"{count} correspondences remain within the noise"
    fundamental = estimator.scale.to_pixels(model)
    return WeakCalibration(fundamental, mask, residuals, noise_px, result.num_trials, reason)


def _settle(estimator: FundamentalEstimator, model: Floats, inliers: Mask) -> tuple[Floats, Mask, float]:
    """Refine matrix and inliers in turn until the inliers stay; the threshold follows the noise."""
    noise_px = 0.0
    for _ in range(5):
        model = estimator.refine(model, inliers)
        residuals = estimator.residuals(model[None])[0]
        noise_px = _noise(residuals[inliers])
        limit = max(MIN_THRESHOLD_PX, THRESHOLD_IN_SIGMAS * noise_px)
        chosen = residuals < min(limit, SEARCH.threshold_px)
        if np.count_nonzero(chosen) < MIN_NUM_INLIERS or (chosen == inliers).all():
            break
        inliers = chosen
    return model, inliers, noise_px


def _noise(residuals: Floats) -> float:
    free = max(1, len(residuals) - 7)
    return math.sqrt(float((residuals * residuals).sum()) / free)
