"""Resection: the camera of an intermediate frame from points of the scene and where they are seen."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import PixelFrame
from sfm.cameras.camera_prior import ExpectedPoints, PriorSettings, ResectionProblem, resection_problem
from sfm.cameras.projective_basis import normalized_camera
from sfm.cameras.robust_resection import image_distances, linear_camera, minimize_distances, robust_weights

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

TINY = 1e-300


@dataclass(frozen=True)
class ResectionSettings:
    """Parameters of the resection."""

    min_num_points: int = 6  # points that are needed; six determine a camera
    # reweighted linear solutions before the distance in the image is minimised
    num_linear_iterations: int = 5
    max_iterations: int = 30  # bound on the number of steps that minimise it
    min_threshold_px: float = 1.0  # a point is an outlier from the larger of both
    threshold_in_sigmas: float = 4.0
    max_rms_px: float = 3.0  # above this the camera cannot be trusted
    min_inlier_share: float = 0.5  # below this share of the points it cannot either
    prior: PriorSettings = field(default_factory=PriorSettings)  # how far the prior camera is trusted

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.min_num_points < 6:
            raise ValueError(f"`min_num_points` must be at least 6, got {self.min_num_points}")


@dataclass(frozen=True, eq=False)
class Resection:
    """What came of an attempt to find a camera."""

    camera: Floats  # projection matrix in normalised coordinates, Frobenius norm sqrt(3)
    inliers: Mask  # points that it sees where they are
    residuals_px: Floats  # reprojection errors; inf for points that are not finite
    rms_px: float  # root mean square error of the inliers
    reason: str  # why the camera cannot be trusted; empty if it can

    @property
    def success(self) -> bool:
        """Whether the camera can be trusted."""
        return not self.reason


def resection(
    points: Floats,
    positions: Floats,
    frame: PixelFrame,
    prior: Floats | None = None,
    settings: ResectionSettings | None = None,
    expected: ExpectedPoints | None = None,
) -> Resection:
    """Find the camera that sees points of the scene where they are seen, in spite of outliers."""
    settings = settings or ResectionSettings()
    num = len(points)
    if points.shape != (num, 4) or positions.shape != (num, 2):
        raise ValueError(
            f"expected (N, 4) points and (N, 2) positions, got {points.shape}, {positions.shape}"
        )
    known = np.isfinite(points).all(axis=1) & np.isfinite(positions).all(axis=1)
    known &= np.abs(np.where(known, points[:, 2], 0.0)) > TINY
    used = np.flatnonzero(known)
    residuals = np.full(num, np.inf)
    guess = np.eye(3, 4) if prior is None else normalized_camera(prior)
    if len(used) < settings.min_num_points:
        reason = f"{len(used)} points, {settings.min_num_points} are needed"
        return Resection(guess, np.zeros(num, dtype=bool), residuals, 0.0, reason)
    x, seen = points[used] / points[used, 2:3], frame.to_normalized(positions[used])
    problem = resection_problem(x, seen, guess, frame, settings.prior)
    if expected is not None:
        problem = problem.with_expected(expected, frame)
    camera = linear_camera(problem, settings.num_linear_iterations)
    camera = minimize_distances(problem, camera, settings.max_iterations)
    residuals[used] = image_distances(problem, camera)[: len(used)] * frame.scale_px
    return _judge(camera, residuals, frame, problem, settings)


def _judge(
    scaled_camera: Floats,
    residuals_px: Floats,
    frame: PixelFrame,
    problem: ResectionProblem,
    settings: ResectionSettings,
) -> Resection:
    camera = normalized_camera(scaled_camera @ problem.to_scaled)
    noise = robust_weights(problem, image_distances(problem, scaled_camera), redescending=True)[1]
    limit = max(settings.min_threshold_px, settings.threshold_in_sigmas * noise * frame.scale_px)
    inliers = residuals_px < limit
    count = int(np.count_nonzero(inliers))
    rms = math.sqrt(float((residuals_px[inliers] ** 2).mean())) if count else 0.0
    ahead = np.count_nonzero(problem.x[: problem.num_real] @ scaled_camera[2] > 0)
    reason = ""
    if count < max(settings.min_num_points, settings.min_inlier_share * problem.num_real):
        reason = f"only {count} of {problem.num_real} points agree with the camera"
    elif rms > settings.max_rms_px:
        reason = f"points are {rms:.1f} px from where the camera sees them"
    elif ahead < 0.9 * problem.num_real:
        reason = f"{problem.num_real - ahead} of {problem.num_real} points are behind the camera"
    return Resection(camera, inliers, residuals_px, rms, reason)
