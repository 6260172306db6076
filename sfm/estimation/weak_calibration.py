"""Weak calibration: the fundamental matrix of two frames, and which correspondences obey it."""

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

    # threshold on the Sampson distance and length of the random search
    search: RobustSettings = field(default_factory=RobustSettings)
    min_num_inliers: int = 14  # fewer than this do not confirm a matrix that seven points determine
    min_threshold_px: float = 0.35  # the final threshold follows the noise, but is not below this
    threshold_in_sigmas: float = 3.5  # the final threshold, in standard deviations of the noise

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.min_num_inliers < 8:
            raise ValueError(f"`min_num_inliers` must be at least 8, got {self.min_num_inliers}")


@dataclass(frozen=True, eq=False)
class WeakCalibration:
    """What came of an attempt to weakly calibrate two frames."""

    fundamental: Floats  # F with ``x1' F x0 = 0`` in pixels, unit norm; zeros where there is none
    inliers: Mask  # correspondences that obey it
    # sampson distances, not negative; inf where there is no matrix, or the point is not finite
    residuals_px: Floats
    noise_px: float  # standard deviation of the Sampson distances of the inliers
    num_trials: int  # samples that were drawn
    reason: str  # why there is no matrix, or it cannot be trusted; empty if it can

    @property
    def success(self) -> bool:
        """Whether the matrix can be trusted."""
        return not self.reason

    @classmethod
    def missing(cls, num_points: int, reason: str, num_trials: int = 0) -> Self:
        """Say why there is no matrix."""
        nothing, far = np.zeros(num_points, dtype=bool), np.full(num_points, np.inf)
        return cls(np.zeros((3, 3)), nothing, far, 0.0, num_trials, reason)


def least_sampson_distance(
    correspondences: Correspondences,
    estimator: FundamentalEstimator,
    found: RobustResult,
    settings: WeakCalibrationSettings,
) -> WeakCalibration:
    """Refine a fundamental matrix over its final inliers, and judge it."""
    num, agreeing = len(correspondences), int(np.count_nonzero(found.inliers))
    if estimator.num_data < settings.min_num_inliers:
        reason = f"{estimator.num_data} correspondences, {settings.min_num_inliers} are needed"
        return WeakCalibration.missing(num, reason)
    if found.model is None or agreeing < settings.min_num_inliers:
        reason = f"{agreeing} of {estimator.num_data} correspondences agree on the epipolar geometry"
        return WeakCalibration.missing(num, reason, found.num_trials)
    model, inliers, noise_px = _settle(estimator, found.model, found.inliers, settings)
    usable = correspondences.finite
    residuals, mask = np.full(num, np.inf), usable.copy()
    residuals[usable], mask[usable] = estimator.residuals(model[None])[0], inliers
    count = int(np.count_nonzero(mask))
    reason = "" if count >= settings.min_num_inliers else f"{count} correspondences remain within the noise"
    fundamental = estimator.scale.to_pixels(model)
    return WeakCalibration(fundamental, mask, residuals, noise_px, found.num_trials, reason)


def _settle(
    estimator: FundamentalEstimator, model: Floats, inliers: Mask, settings: WeakCalibrationSettings
) -> tuple[Floats, Mask, float]:
    """Refine matrix and inliers in turn, the threshold following the noise, until the inliers stay."""
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
