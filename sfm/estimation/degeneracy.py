"""Degenerate motion: two frames that show no depth, or too little."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dvc.arrays import Floats
from sfm.decompositions import right_singular
from sfm.estimation.sample_consensus import RobustSettings, lo_ransac, mapsac, noise_scale
from sfm.estimation.two_view_estimators import HomographyEstimator
from sfm.estimation.weak_calibration import WeakCalibration
from sfm.scene_model import Correspondences

MotionKind = Literal["general", "rotation", "none", "unknown"]


MIN_MOTION_PX = 0.5
"""Motion below which a camera stood still if nine tenths of the points move less."""
MIN_PARALLAX_PX = 0.5
"""Parallax below which depth is unusable, however small the noise."""
MIN_NOISE_PX = 0.15
"""Lower bound on the noise: the matches of real frames are never better."""
MIN_NUM_POINTS = 14
"""Number of correspondences below which the motion is unknown."""
MIN_SPREAD_PX = 3.0
"""Spread about a straight line below which the motion is unknown."""
MIN_PARALLAX_SHARE = 0.1
"""Least share of the correspondences off the homography in a general scene."""
SURE_PARALLAX_SHARE = 0.2
"""Share above which the scene is general even if the criterion prefers the homography.

The criterion caps the cost of points that disagree, and so overlooks a second plane.
"""
SEARCH = RobustSettings(threshold_px=1.0, min_num_trials=100, max_num_trials=1000)


@dataclass(frozen=True, eq=False)
class MotionClass:
    """Motion of the camera between two frames, according to the points."""

    # ``general``: the frames show depth; ``rotation`` (or a distant or planar scene): a homography explains
    # all; ``none``: no motion; ``unknown``: too few points
    kind: MotionKind
    reason: str  # explanation in one line


def gric(squared_px2: Floats, sigma_px: float, dimension: int, num_parameters: int) -> float:
    """Compute the geometric robust information criterion of a model of two views."""
    num = len(squared_px2)
    limit = 2.0 * (4 - dimension)
    error = float(np.minimum(squared_px2 / (sigma_px * sigma_px), limit).sum())
    return error + math.log(4.0) * dimension * num + math.log(4.0 * max(num, 1)) * num_parameters


def classify_motion(
    correspondences: Correspondences, calibration: WeakCalibration, rng: np.random.Generator
) -> MotionClass:
    """Classify the motion of the camera, and thus whether two frames show depth."""
    finite = np.isfinite(correspondences.motion).all(axis=1)
    num = int(np.count_nonzero(finite))
    if num < MIN_NUM_POINTS:
        return MotionClass("unknown", f"{num} correspondences, {MIN_NUM_POINTS} are needed")
    motion = np.hypot(*correspondences.motion[finite].T)
    if np.quantile(motion, 0.9) < MIN_MOTION_PX:
        reason = f"nine tenths of the points move less than {MIN_MOTION_PX:g} px"
        return MotionClass("none", reason)
    if not calibration.success:
        return MotionClass("unknown", calibration.reason)
    agreeing = correspondences[calibration.inliers]
    if _spread(agreeing.first) < MIN_SPREAD_PX:
        return MotionClass("unknown", "all points lie near a straight line")
    return _compare(agreeing, calibration, rng)


def _spread(points: Floats) -> float:
    """Return the standard deviation of points (N, 2) across their direction of largest spread."""
    offset = points - points.mean(axis=0)
    return float(right_singular(offset)[0][1]) / math.sqrt(len(points))


def _compare(
    agreeing: Correspondences, calibration: WeakCalibration, rng: np.random.Generator
) -> MotionClass:
    """Compare the best homography with the fundamental matrix, over the inliers of the latter."""
    estimator = HomographyEstimator(agreeing.first, agreeing.second)
    result = lo_ransac(estimator, mapsac(estimator, SEARCH, rng), SEARCH, rng)
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
