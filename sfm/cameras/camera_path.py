"""Cameras of the frames between two key frames: each by resection, or all along a smooth path.

Resection finds the camera of a frame from points of the scene and their image positions: linear equations
give a start, robust Levenberg-Marquardt steps minimise the distances in the image. A prior camera contributes
virtual points.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dvc.arrays import Floats, Mask
from dvc.geometry.cameras import PixelFrame, homogeneous, project
from dvc.geometry.triangulation import inverse_depths
from sfm.cameras.camera_pair import nonzero
from sfm.cameras.projective_basis import CAMERA_NORM, normalized_camera, projection_equations
from sfm.decompositions import least_singular
from sfm.least_squares import Damping, levenberg_marquardt, normal_matrix, solve_damped
from sfm.scene_model import Model

TINY = 1e-300
NUM_PARAMETERS = 11
MEDIAN_OF_RAYLEIGH = 1.1774  # median distance in the plane, in standard deviations of a coordinate
TUKEY_TUNING = 5.5  # largest distance with a weight, in standard deviations of a coordinate
MIN_DEPTH = 1e-9  # least depth of a point in the camera
DAMPING = Damping(start=1e-6, min_factor=1e-12, num_tries=8)
TOLERANCE = 1e-12  # change of a camera of unit norm below which a minimum is reached
MIN_NUM_POINTS = 6  # number of points that determine a camera
NUM_LINEAR_ITERATIONS = 5  # number of reweighted linear solutions
MAX_ITERATIONS = 30  # largest number of steps that minimise distances in the image
NUM_REWEIGHTED = 15  # number of the first steps that change the weights, so that later steps converge
MIN_THRESHOLD_PX, THRESHOLD_IN_SIGMAS = 1.0, 4.0  # an outlier exceeds both thresholds
MAX_RMS_PX = 3.0  # largest error of a trusted camera
MIN_INLIER_SHARE = 0.5  # least share of points that agree with a trusted camera
MIN_NOISE_PX = 0.1  # lower bound on the standard deviation of a coordinate of a point
MIN_SIGMA_PX, MAX_SIGMA_PX = 1.0, 10.0  # bounds on the image error of a prior camera that fits the points
NUM_SWEEPS = 12
"""Largest number of passes along a path; each estimates every camera again with constant neighbours."""
CONVERGED_PX = 0.01
"""Motion of the scene's points in the image, root mean square, below which the passes end."""
JERK_PX = 1.0
"""Second difference above which the cost is linear instead of quadratic: jerks are real."""
NEAREST = 1e-3
"""Least depth of a point that constrains the path, relative to the median of a camera's points."""


@dataclass(frozen=True, eq=False)
class ExpectedPoints:
    """Image positions of points that follow from other instants."""

    points: Floats  # homogeneous points, as `Model.points` has them
    positions: Floats  # image points in pixels
    weight: float  # of their mean squared distance, relative to that of the observed points


@dataclass(frozen=True, eq=False)
class Resection:
    """Result of a resection."""

    camera: Floats  # projection matrix in normalised coordinates, Frobenius norm sqrt(3)
    inliers: Mask  # points that agree with the camera
    residuals_px: Floats  # reprojection errors; inf for points that are not finite
    rms_px: float  # root mean square error of the inliers
    reason: str  # reason why the camera cannot be trusted; empty if it can

    @property
    def success(self) -> bool:
        """Whether the camera can be trusted."""
        return not self.reason


@dataclass(eq=False)
class ResectionProblem:
    """Points as (x, y, 1, inverse depth), well scaled, and their image positions."""

    x: Floats  # scaled points
    seen: Floats  # image positions in normalised units
    weights: Floats  # weights of the squared distances
    num_real: int  # number of observed points, which are first
    num_virtual: int  # number of points of the prior camera, which follow
    to_scaled: Floats  # matrix from unscaled to scaled points
    start: Floats  # the prior camera, moved to fit, for scaled points
    sigma: float  # standard deviation of a virtual point, in normalised units
    min_noise: float  # lower bound on that of a real one


def resection(
    points: Floats,
    positions: Floats,
    frame: PixelFrame,
    prior: Floats | None = None,
    expected: ExpectedPoints | None = None,
) -> Resection:
    """Estimate the camera from points of the scene and their image positions, despite outliers."""
    num = len(points)
    if points.shape != (num, 4) or positions.shape != (num, 2):
        raise ValueError(
            f"expected (N, 4) points and (N, 2) positions, got {points.shape}, {positions.shape}"
        )
    finite = np.isfinite(points).all(axis=1) & np.isfinite(positions).all(axis=1)
    finite &= np.abs(np.where(finite, points[:, 2], 0.0)) > TINY
    used = np.flatnonzero(finite)
    residuals = np.full(num, np.inf)
    guess = np.eye(3, 4) if prior is None else normalized_camera(prior)
    if len(used) < MIN_NUM_POINTS:
        reason = f"{len(used)} points, {MIN_NUM_POINTS} are needed"
        return Resection(guess, np.zeros(num, dtype=bool), residuals, 0.0, reason)
    x, seen = points[used] / points[used, 2:3], frame.to_normalized(positions[used])
    problem = resection_problem(x, seen, guess, frame)
    if expected is not None:
        x = expected.points / expected.points[:, 2:3]
        each = expected.weight * problem.num_real / len(x)
        problem.x = np.vstack([problem.x, x @ problem.to_scaled.T])
        problem.seen = np.vstack([problem.seen, frame.to_normalized(expected.positions)])
        problem.weights = np.concatenate([problem.weights, np.full(len(x), each)])
    camera = problem.start  # solve the linear equations of (B.2), reweighted by the denominators and robustly
    for _ in range(NUM_LINEAR_ITERATIONS):
        weights, _ = robust_weights(problem, image_distances(problem, camera), redescending=False)
        kappa = 1.0 / np.maximum(np.abs(problem.x @ camera[2]), 1e-3 * np.abs(camera[2]).max())
        scaled = (np.sqrt(weights) * kappa)[:, None] * problem.x
        camera = least_singular(normal_matrix(*projection_equations(scaled, problem.seen))).reshape(3, 4)
        if 2 * np.count_nonzero(problem.x @ camera[2] < 0) > len(problem.x):
            camera = -camera
    errors = [np.median(image_distances(problem, c)[: len(used)]) for c in (camera, problem.start)]
    camera = camera if errors[0] <= errors[1] else problem.start
    camera = camera / np.sqrt((camera * camera).sum())
    camera = levenberg_marquardt(_RobustDistances(problem), camera, DAMPING, MAX_ITERATIONS)
    distances = image_distances(problem, camera)
    residuals[used] = distances[: len(used)] * frame.scale_px
    noise = robust_weights(problem, distances, redescending=True)[1]
    inliers = residuals < max(MIN_THRESHOLD_PX, THRESHOLD_IN_SIGMAS * noise * frame.scale_px)
    count = int(np.count_nonzero(inliers))
    rms = math.sqrt(float((residuals[inliers] ** 2).mean())) if count else 0.0
    ahead = np.count_nonzero(problem.x[: len(used)] @ camera[2] > 0)
    reason = ""
    if count < max(MIN_NUM_POINTS, MIN_INLIER_SHARE * len(used)):
        reason = f"only {count} of {len(used)} points agree with the camera"
    elif rms > MAX_RMS_PX:
        reason = f"points are {rms:.1f} px from their projections"
    elif ahead < 0.9 * len(used):
        reason = f"{len(used) - ahead} of {len(used)} points are behind the camera"
    return Resection(normalized_camera(camera @ problem.to_scaled), inliers, residuals, rms, reason)


def resection_problem(x: Floats, seen: Floats, prior: Floats, frame: PixelFrame) -> ResectionProblem:
    """Scale the points, and add virtual points all over the image of a prior camera."""
    min_noise = MIN_NOISE_PX / frame.scale_px
    middle, spread = x.mean(axis=0), x.std(axis=0)
    size = np.maximum(spread, np.array([0.05, 0.05, 1.0, 1e-6 + 0.02 * abs(middle[3])]))
    to_scaled = np.diag(1.0 / size)
    to_scaled[[0, 1, 3], 2] = -middle[[0, 1, 3]] / size[[0, 1, 3]]
    to_scaled[2, 2] = 1.0
    moved, error = _moved_to_fit(prior, x, seen, min_noise)
    sigma_px = float(np.clip(3.0 * error * frame.scale_px, MIN_SIGMA_PX, MAX_SIGMA_PX))
    # Virtual points lie in front of and behind the points of the scene.
    low, high = float(np.quantile(x[:, 3], 0.05)), float(np.quantile(x[:, 3], 0.95))
    margin = 0.25 * max(abs(low), abs(high)) + 0.25 * (high - low)
    right, bottom = 0.5 * frame.width_px / frame.scale_px, 0.5 * frame.height_px / frame.scale_px
    steps = np.array([-1.0, 0.0, 1.0])
    grid = np.meshgrid(right * steps, bottom * steps, [low - margin, high + margin])
    across, down, inverse = (axis.ravel() for axis in grid)
    virtual = np.column_stack([across, down, np.ones_like(across), inverse])
    p = virtual @ moved.T
    ahead = p[:, 2] > 1e-3 * CAMERA_NORM
    num_virtual = int(np.count_nonzero(ahead))
    # Many virtual points represent few parameters.
    each = NUM_PARAMETERS / (2.0 * max(1, num_virtual))
    return ResectionProblem(
        x=np.vstack([x, virtual[ahead]]) @ to_scaled.T,
        seen=np.vstack([seen, p[ahead, :2] / p[ahead, 2:]]),
        weights=np.concatenate([np.ones(len(x)), np.full(num_virtual, each)]),
        num_real=len(x),
        num_virtual=num_virtual,
        to_scaled=to_scaled,
        start=moved @ np.linalg.inv(to_scaled),
        sigma=sigma_px / frame.scale_px,
        min_noise=min_noise,
    )


def _moved_to_fit(camera: Floats, x: Floats, seen: Floats, least: float) -> tuple[Floats, float]:
    """Move a camera's image by a robust affine map on to the points; also return the error that remains."""
    p = x @ camera.T
    ahead = p[:, 2] > 1e-6
    if np.count_nonzero(ahead) < 4:
        return camera, math.inf
    guess = homogeneous(p[ahead, :2] / p[ahead, 2:])
    target = seen[ahead]
    affine = np.eye(3)
    affine[:2, 2] = np.median(target - guess[:, :2], axis=0)
    error = 0.0
    for _ in range(10):
        offset = target - guess @ affine[:2].T
        distance = np.hypot(offset[:, 0], offset[:, 1])
        error = max(least, float(np.median(distance)) / MEDIAN_OF_RAYLEIGH)
        robust = 1.0 / np.maximum(distance, error)
        normal = np.einsum("n,ni,nj->ij", robust, guess, guess)
        slope = np.einsum("n,ni,nk->ik", robust, guess, offset)
        # Points on a line do not determine the whole map: the damping keeps the rest at the identity.
        affine[0] += solve_damped(normal, slope[:, 0], 1e-6)
        affine[1] += solve_damped(normal, slope[:, 1], 1e-6)
    return affine @ camera, error


def image_distances(problem: ResectionProblem, camera: Floats) -> Floats:
    """Return the distances of projected points from their image positions."""
    p = problem.x @ camera.T
    offset = p[:, :2] / nonzero(p[:, 2], MIN_DEPTH)[:, None] - problem.seen
    return np.hypot(offset[:, 0], offset[:, 1])


def robust_weights(problem: ResectionProblem, distances: Floats, redescending: bool) -> tuple[Floats, float]:
    """Return robust weights of observed points, weights of virtual points by uncertainty, and the noise."""
    real = distances[: problem.num_real]
    free = max(1.0, 2.0 * problem.num_real - NUM_PARAMETERS) / (2.0 * problem.num_real)
    noise = max(problem.min_noise, float(np.median(real)) / (MEDIAN_OF_RAYLEIGH * math.sqrt(free)))
    if redescending:
        robust = np.maximum(0.0, 1.0 - (real / (TUKEY_TUNING * noise)) ** 2) ** 2
    else:
        robust = noise / np.maximum(real, noise)
    weights = problem.weights.copy()
    weights[: problem.num_real] *= robust
    weights[problem.num_real : problem.num_real + problem.num_virtual] *= (noise / problem.sigma) ** 2
    return weights, noise


class _RobustDistances:
    """Weighted squared distances in the image."""

    def __init__(self, problem: ResectionProblem) -> None:
        self._problem, self._weights = problem, problem.weights

    def cost(self, camera: Floats) -> float:
        return float((self._weights * image_distances(self._problem, camera) ** 2).sum())

    def linearize(self, camera: Floats, iteration: int) -> tuple[float, Callable[[float], Floats]]:
        distances = image_distances(self._problem, camera)
        if iteration < NUM_REWEIGHTED:
            self._weights, _ = robust_weights(self._problem, distances, redescending=True)
        p = self._problem.x @ camera.T
        depth = nonzero(p[:, 2], MIN_DEPTH)
        uv = p[:, :2] / depth[:, None]
        root = np.sqrt(self._weights)[:, None]
        errors = root * (uv - self._problem.seen)
        horizontal, vertical = projection_equations(root * self._problem.x / depth[:, None], uv)
        normal = normal_matrix(horizontal, vertical)
        slope = np.einsum("ni,n->i", horizontal, errors[:, 0]) + np.einsum("ni,n->i", vertical, errors[:, 1])

        def stepped(damping: float) -> Floats:
            candidate = camera - solve_damped(normal, slope, damping).reshape(3, 4)
            return np.asarray(candidate / np.sqrt((candidate * candidate).sum()))

        return float((self._weights * distances * distances).sum()), stepped

    def converged(self, before: Floats, after: Floats, decrease: float, cost: float) -> bool:
        del decrease, cost
        return float(np.abs(after - before).max()) < TOLERANCE


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Points of the scene and their image positions at one temporal position."""

    temporal_position: float  # 0 at the first and 1 at the second key frame
    points: Floats  # homogeneous points, as `Model.points` has them
    positions: Floats  # image points in pixels; nan: not seen


def linear_points(model: Model, temporal_position: float) -> TrackedPoints:
    """Interpolate all points of a model, as the tracks of a codec that sends none."""
    first, second = model.correspondences.first, model.correspondences.second
    positions = (1.0 - temporal_position) * first + temporal_position * second
    return TrackedPoints(temporal_position, model.points, positions)


def tracked_points(
    model: Model, first: Floats, second: Floats, positions: Floats, temporal_position: float
) -> TrackedPoints:
    """Triangulate points that were tracked from key frame to key frame."""
    frame = model.pixel_frame
    valid = np.asarray(np.isfinite(np.hstack([first, second])).all(axis=1))
    x0 = frame.to_normalized(np.where(valid[:, None], first, 0.0))
    x1 = frame.to_normalized(np.where(valid[:, None], second, 0.0))
    inverse, quotient = inverse_depths(x0, model.second_camera, x1)
    valid &= (inverse > 0) & (quotient > 0)
    depth = 1.0 / np.where(valid, inverse, 1.0)
    points = np.column_stack([depth[:, None] * homogeneous(x0), np.ones(len(x0))])
    points[~valid] = np.nan
    return TrackedPoints(temporal_position, points, np.where(valid[:, None], positions, np.nan))


def interpolated_camera(model: Model, temporal_position: float) -> Floats:
    """Interpolate the camera of a temporal position between those of the key frames."""
    first, second = (1.0 - temporal_position) * model.first_camera, temporal_position * model.second_camera
    return normalized_camera(first + second)


def intermediate_cameras(model: Model, instants: Sequence[TrackedPoints]) -> list[Resection]:
    """Estimate the cameras of any instants, from tracked or interpolated points."""
    return [_camera(model, instant) for instant in instants]


def _camera(model: Model, instant: TrackedPoints, expected: ExpectedPoints | None = None) -> Resection:
    prior = interpolated_camera(model, instant.temporal_position)
    return resection(instant.points, instant.positions, model.pixel_frame, prior, expected)


def regular_cameras(model: Model, instants: Sequence[TrackedPoints], regularity: float) -> list[Resection]:
    """Estimate cameras of evenly spaced instants so that the scene's points move smoothly in the images."""
    if not regularity >= 0:
        raise ValueError(f"`regularity` must not be negative, got {regularity}")
    estimates = intermediate_cameras(model, instants)
    if regularity == 0 or not instants:
        return estimates
    between = [estimate.camera if estimate.success else None for estimate in estimates]
    cameras = [model.first_camera, *between, model.second_camera]
    points = instants[0].points
    valid = np.isfinite(points).all(axis=1)
    for camera in cameras:
        if camera is not None:
            depth = np.where(valid, points @ camera[2], 0.0)
            valid &= depth > NEAREST * (np.median(depth[valid]) if valid.any() else 0.0)
    points = points[valid]
    if not len(points):
        return estimates

    def projected(camera: Floats) -> Floats:
        return model.pixel_frame.to_pixels(project(camera, points)[0])

    seen = [None if camera is None else projected(camera) for camera in cameras]
    for _ in range(NUM_SWEEPS):
        moved_px = 0.0
        for t, instant in enumerate(instants, 1):
            expected = _expected(points, seen, t, regularity)
            if expected is None:
                continue
            estimate = _camera(model, instant, expected)
            if estimate.success:
                before, after = seen[t], projected(estimate.camera)
                estimates[t - 1], seen[t] = estimate, after
                moved_px = max(moved_px, 0.0 if before is None else _rms(after - before))
        if moved_px < CONVERGED_PX:
            break
    return estimates


def _expected(
    points: Floats, seen: Sequence[Floats | None], t: int, regularity: float
) -> ExpectedPoints | None:
    """Return the positions of points expected from the neighbours of a frame; None without neighbours."""
    here = seen[t]
    if here is None:
        return None
    total, positions = 0.0, np.zeros((len(points), 2))
    for centre, factor in ((t - 1, 1.0), (t, -2.0), (t + 1, 1.0)):
        if not 0 < centre < len(seen) - 1:
            continue
        before, middle, after = seen[centre - 1 : centre + 2]
        if before is None or middle is None or after is None:
            continue
        difference = before - 2.0 * middle + after
        weight = factor * factor / max(1.0, _rms(difference) / JERK_PX)
        positions += weight * (here - difference / factor)
        total += weight
    if total == 0.0:
        return None
    return ExpectedPoints(points, positions / total, regularity * total)


def _rms(offsets: Floats) -> float:
    return float(np.sqrt((offsets * offsets).sum(axis=1).mean()))
