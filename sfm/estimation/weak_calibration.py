"""Weak calibration: the fundamental matrix of two frames, and the correspondences that obey it."""

import math
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sfm.estimation.sample_consensus import RobustResult, RobustSettings
from sfm.estimation.two_view_estimators import FundamentalEstimator
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class WeakCalibrationSettings:
    """Parameters of the robust weak calibration."""

    # threshold on the Sampson distance, and length of the random search
    search: RobustSettings = field(default_factory=RobustSettings)
    min_num_inliers: int = 14  # least number that confirms a matrix, which seven points determine
    min_threshold_px: float = 0.35  # lower bound on the final threshold
    threshold_in_sigmas: float = 3.5  # the final threshold, in standard deviations of the noise

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.min_num_inliers < 8:
            raise ValueError(f"`min_num_inliers` must be at least 8, got {self.min_num_inliers}")


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


def least_sampson_distance(
    correspondences: Correspondences,
    estimator: FundamentalEstimator,
    result: RobustResult,
    settings: WeakCalibrationSettings,
) -> WeakCalibration:
    """Refine a fundamental matrix over its final inliers, and decide whether it can be trusted."""
    num, agreeing = len(correspondences), int(np.count_nonzero(result.inliers))
    if estimator.num_data < settings.min_num_inliers:
        reason = f"{estimator.num_data} correspondences, {settings.min_num_inliers} are needed"
        return WeakCalibration.missing(num, reason)
    if result.model is None or agreeing < settings.min_num_inliers:
        reason = f"{agreeing} of {estimator.num_data} correspondences agree on the epipolar geometry"
        return WeakCalibration.missing(num, reason, result.num_trials)
    model, inliers, noise_px = _settle(estimator, result.model, result.inliers, settings)
    usable = correspondences.finite
    residuals, mask = np.full(num, np.inf), usable.copy()
    residuals[usable], mask[usable] = estimator.residuals(model[None])[0], inliers
    count = int(np.count_nonzero(mask))
    reason = "" if count >= settings.min_num_inliers else f"{count} correspondences remain within the noise"
    fundamental = estimator.scale.to_pixels(model)
    return WeakCalibration(fundamental, mask, residuals, noise_px, result.num_trials, reason)


def _settle(
    estimator: FundamentalEstimator, model: Floats, inliers: Mask, settings: WeakCalibrationSettings
) -> tuple[Floats, Mask, float]:
    """Refine matrix and inliers in turn until the inliers stay; the threshold follows the noise."""
    noise_px = 0.0
    for _ in range(5):
        model = estimator.refine(model, inliers)
        residuals = estimator.residuals(model[None])[0]
        noise_px = _noise(residuals[inliers])
        limit = max(settings.min_threshold_px, settings.threshold_in_sigmas * noise_px)
        chosen = residuals < min(limit, settings.search.threshold_px)
        if np.count_nonzero(chosen) < settings.min_num_inliers or (chosen == inliers).all():
            break
        inliers = chosen
    return model, inliers, noise_px


def _noise(residuals: Floats) -> float:
    free = max(1, len(residuals) - 7)
    return math.sqrt(float((residuals * residuals).sum()) / free)
