"""Weak calibration: the fundamental matrix of two frames, its inliers, and whether they show depth."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np

from dvc.arrays import Floats, Mask
from sfm.decompositions import right_singular
from sfm.estimation.sample_consensus import RobustSettings, lo_ransac, mapsac, noise_scale
from sfm.estimation.two_view_estimators import FundamentalEstimator, HomographyEstimator
from sfm.scene_model import Correspondences

SEARCH = RobustSettings()
"""Threshold on the Sampson distance, and length of the random search."""
MIN_NUM_INLIERS = 14
"""Least number of inliers that confirms a matrix, which seven points determine."""
MIN_THRESHOLD_PX = 0.35
"""Lower bound on the final threshold."""
THRESHOLD_IN_SIGMAS = 3.5
"""The final threshold, in standard deviations of the noise."""
MIN_MOTION_PX = 0.5
"""Motion below which a camera stood still if nine tenths of the points move less."""
MIN_PARALLAX_PX = 0.5
"""Parallax below which depth is unusable, however small the noise."""
MIN_NOISE_PX = 0.15
"""Lower bound on the noise: the matches of real frames are never better."""
MIN_SPREAD_PX = 3.0
"""Spread about a straight line below which the motion is unknown."""
MIN_PARALLAX_SHARE = 0.1
"""Least share of the correspondences off the homography in a general scene."""
SURE_PARALLAX_SHARE = 0.2
"""Share above which the scene is general, even if the criterion, as it caps costs, overlooks a plane."""
HOMOGRAPHY_SEARCH = RobustSettings(min_num_trials=100, max_num_trials=1000)


@dataclass(frozen=True, eq=False)
class WeakCalibration:
    """Result of the weak calibration of two frames."""

    fundamental: Floats  # F with ``x1' F x0 = 0`` in pixels, unit norm; zeros on failure
    inliers: Mask  # correspondences that obey it
    residuals_px: Floats  # Sampson distances, not negative; inf on failure, or for points not finite
    noise_px: float  # standard deviation of the Sampson distances of the inliers
    reason: str  # reason why the matrix is missing or cannot be trusted; empty if it can

    @classmethod
    def missing(cls, num_points: int, reason: str) -> Self:
        """Return a failure."""
        none, far = np.zeros(num_points, dtype=bool), np.full(num_points, np.inf)
        return cls(np.zeros((3, 3)), none, far, 0.0, reason)


def weak_calibration(correspondences: Correspondences, rng: np.random.Generator) -> WeakCalibration:
    """Estimate the fundamental matrix robustly, refine it over its final inliers, and judge it."""
    usable = correspondences.finite
    estimator = FundamentalEstimator(correspondences.first[usable], correspondences.second[usable])
    result = lo_ransac(estimator, mapsac(estimator, SEARCH, rng), SEARCH, rng)
    num, model, inliers = len(correspondences), result.model, result.inliers
    if estimator.num_data < MIN_NUM_INLIERS:
        reason = f"{estimator.num_data} correspondences, {MIN_NUM_INLIERS} are needed"
        return WeakCalibration.missing(num, reason)
    if model is None or np.count_nonzero(inliers) < MIN_NUM_INLIERS:
        counts = f"{np.count_nonzero(inliers)} of {estimator.num_data}"
        return WeakCalibration.missing(num, f"{counts} correspondences agree on the epipolar geometry")
    for _ in range(5):  # until the inliers stay; the threshold follows the noise
        model = estimator.refine(model, inliers)
        distances = estimator.residuals(model[None])[0]
        squares = float((distances[inliers] * distances[inliers]).sum())
        noise_px = math.sqrt(squares / max(1, int(np.count_nonzero(inliers)) - 7))
        limit = max(MIN_THRESHOLD_PX, THRESHOLD_IN_SIGMAS * noise_px)
        chosen = distances < min(limit, SEARCH.threshold_px)
        if np.count_nonzero(chosen) < MIN_NUM_INLIERS or (chosen == inliers).all():
            break
        inliers = chosen
    residuals, mask = np.full(num, np.inf), usable.copy()
    residuals[usable], mask[usable] = estimator.residuals(model[None])[0], inliers
    count = int(np.count_nonzero(mask))
    reason = "" if count >= MIN_NUM_INLIERS else f"{count} correspondences remain within the noise"
    return WeakCalibration(estimator.to_pixels(model), mask, residuals, noise_px, reason)


class MotionClass(NamedTuple):
    """Motion of the camera between two frames, according to the points, and an explanation in one line.

    ``general``: the frames show depth; ``rotation`` (or a distant or planar scene): a homography explains
    all; ``none``: no motion; ``unknown``: too few points.
    """

    kind: Literal["general", "rotation", "none", "unknown"]
    reason: str


def classify_motion(
    correspondences: Correspondences, calibration: WeakCalibration, rng: np.random.Generator
) -> MotionClass:
    """Classify the motion of the camera, and thus whether two frames show depth."""
    finite = np.isfinite(correspondences.motion).all(axis=1)
    num = int(np.count_nonzero(finite))
    if num < MIN_NUM_INLIERS:
        return MotionClass("unknown", f"{num} correspondences, {MIN_NUM_INLIERS} are needed")
    if np.quantile(np.hypot(*correspondences.motion[finite].T), 0.9) < MIN_MOTION_PX:
        return MotionClass("none", f"nine tenths of the points move less than {MIN_MOTION_PX:g} px")
    reason, agreeing = calibration.reason, correspondences[calibration.inliers]
    if not reason and spread(agreeing.first) < MIN_SPREAD_PX:
        reason = "all points lie near a straight line"
    if reason:
        return MotionClass("unknown", reason)
    # Compare the best homography with the fundamental matrix, over the inliers of the latter.
    estimator = HomographyEstimator(agreeing.first, agreeing.second)
    result = lo_ransac(estimator, mapsac(estimator, HOMOGRAPHY_SEARCH, rng), HOMOGRAPHY_SEARCH, rng)
    if result.model is None:
        return MotionClass("unknown", "no homography could be fitted for comparison")
    to_lines = calibration.residuals_px[calibration.inliers]
    noise_px = max(MIN_NOISE_PX, noise_scale(to_lines, 7))
    difference = gric(result.residuals_px**2, noise_px, 2, 8) - gric(to_lines**2, noise_px, 3, 7)
    # Noise of both points adds up to sqrt(2) sigma between a point and its image by the homography.
    parallax = math.sqrt(2.0) * result.residuals_px
    least = max(MIN_PARALLAX_PX, 3.0 * math.sqrt(2.0) * noise_px)
    share = float((parallax > least).mean())
    unsure = difference <= 0 and share < SURE_PARALLAX_SHARE
    if unsure or share < MIN_PARALLAX_SHARE:
        reason = (
            f"a homography explains {100 * (1 - share):.0f} % of the points within {least:.2f} px: "
            "the camera only turned, or the scene is distant or planar"
        )
        return MotionClass("rotation", reason)
    return MotionClass("general", f"{100 * share:.0f} % of the points show parallax")


def gric(squared_px2: Floats, sigma_px: float, dimension: int, num_parameters: int) -> float:
    """Compute the geometric robust information criterion of a model of two views."""
    num = len(squared_px2)
    limit = 2.0 * (4 - dimension)
    error = float(np.minimum(squared_px2 / (sigma_px * sigma_px), limit).sum())
    return error + math.log(4.0) * dimension * num + math.log(4.0 * max(num, 1)) * num_parameters


def spread(points: Floats) -> float:
    """Return the standard deviation of points (N, 2) across their direction of largest spread."""
    offset = points - points.mean(axis=0)
    return float(right_singular(offset)[0][1]) / math.sqrt(len(points))
