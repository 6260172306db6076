"""Resection: the camera of an intermediate frame from points of the scene and where they are seen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import PixelFrame, homogeneous
from dvc.multiview.triangulation import inverse_depths
from sfm.cameras.projective_basis import CAMERA_NORM
from sfm.least_squares import solve_damped
from sfm.model import Model

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

TINY = 1e-300
NUM_PARAMETERS = 11
MEDIAN_OF_RAYLEIGH = 1.1774  # median distance in the plane, in standard deviations of a coordinate
TUKEY_TUNING = 5.5  # of distances in the plane, in standard deviations of a coordinate


@dataclass(frozen=True)
class ResectionOptions:
    """Parameters of the resection.

    Attributes
    ----------
    min_num_points : int
        Points that are needed; six determine a camera.
    num_linear_iterations : int
        Reweighted linear solutions before the distance in the image is minimised.
    max_iterations : int
        Bound on the number of steps that minimise it.
    min_noise_px : float
        Lower bound on the standard deviation of a coordinate.
    min_threshold_px, threshold_in_sigmas : float
        A point is an outlier from the larger of both.
    max_rms_px : float
        Above this the camera cannot be trusted.
    min_inlier_share : float
        Below this share of the points it cannot either.
    min_prior_sigma_px, max_prior_sigma_px : float
        Bounds on how far the prior camera, moved to fit the points, may be off in the image.
    """

    min_num_points: int = 6
    num_linear_iterations: int = 5
    max_iterations: int = 30
    min_noise_px: float = 0.1
    min_threshold_px: float = 1.0
    threshold_in_sigmas: float = 4.0
    max_rms_px: float = 3.0
    min_inlier_share: float = 0.5
    min_prior_sigma_px: float = 1.0
    max_prior_sigma_px: float = 10.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.min_num_points < 6:
            raise ValueError(f"`min_num_points` must be at least 6, got {self.min_num_points}")
        if not 0 < self.min_prior_sigma_px <= self.max_prior_sigma_px:
            raise ValueError(f"`min_prior_sigma_px` must be in (0, max], got {self.min_prior_sigma_px}")


@dataclass(frozen=True, eq=False)
class Resection:
    """What came of an attempt to find a camera.

    Attributes
    ----------
    camera : ndarray of shape (3, 4), float64
        Projection matrix in normalised coordinates, Frobenius norm sqrt(3). With too few
        points, the prior.
    inliers : ndarray of shape (N,), bool
        Points that it sees where they are.
    residuals_px : ndarray of shape (N,), float64
        Reprojection errors; inf for points that are not finite.
    rms_px : float
        Root mean square error of the inliers.
    reason : str
        Why the camera cannot be trusted; empty if it can.
    """

    camera: Floats
    inliers: Mask
    residuals_px: Floats
    rms_px: float
    reason: str

    @property
    def success(self) -> bool:
        """Whether the camera can be trusted."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Points of the scene and where they are at one instant.

    Attributes
    ----------
    time : float
        Instant, 0 at the first and 1 at the second key frame.
    points : ndarray of shape (N, 4), float64
        Homogeneous points, as `Model.points` has them.
    positions : ndarray of shape (N, 2), float64
        Image points in pixels; nan where a point was not seen.
    """

    time: float
    points: Floats
    positions: Floats


@dataclass(frozen=True, eq=False)
class ExpectedPoints:
    """Where points are expected to be seen by what is known of other instants.

    Attributes
    ----------
    points : ndarray of shape (V, 4), float64
        Homogeneous points, as `Model.points` has them.
    positions : ndarray of shape (V, 2), float64
        Image points in pixels.
    weight : float
        What the mean of their squared distances counts, with respect to the mean of those that are seen.
    """

    points: Floats
    positions: Floats
    weight: float


def linear_tracks(first: Floats, second: Floats, time: float) -> Floats:
    """Move points evenly from one key frame to the other.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Points of the key frames.
    time : float
        Instant, 0 at the first and 1 at the second key frame.

    Returns
    -------
    ndarray of shape (N, 2), float64
        Points at this instant.

    References
    ----------
    [Maitre2008] Eq. (5.8).
    """
    return (1.0 - time) * first + time * second


def linear_points(model: Model, time: float) -> TrackedPoints:
    """Guess where all points of a model are at an instant: the tracks of a codec that sends none.

    Parameters
    ----------
    model : Model
        The scene.
    time : float
        Instant, 0 at the first and 1 at the second key frame.

    Returns
    -------
    TrackedPoints
        All points of the model, moved evenly.
    """
    pairs = model.correspondences
    return TrackedPoints(time, model.points, linear_tracks(pairs.first, pairs.second, time))


def tracked_points(
    model: Model, first: Floats, second: Floats, positions: Floats, time: float
) -> TrackedPoints:
    """Place points that were tracked from key frame to key frame in a scene.

    Parameters
    ----------
    model : Model
        The scene.
    first, second, positions : ndarray of shape (N, 2), float64
        Where the points are in the key frames and at the instant, in pixels.
    time : float
        Instant, 0 at the first and 1 at the second key frame.

    Returns
    -------
    TrackedPoints
        The points, triangulated; nan, with their positions, where they are not known in both key frames or
        would be behind a camera.
    """
    frame = model.pixel_frame
    known = np.asarray(np.isfinite(np.hstack([first, second])).all(axis=1))
    x0 = frame.to_normalized(np.where(known[:, None], first, 0.0))
    x1 = frame.to_normalized(np.where(known[:, None], second, 0.0))
    inverse, quotient = inverse_depths(x0, model.second_camera, x1)
    known &= (inverse > 0) & (quotient > 0)
    depth = 1.0 / np.where(known, inverse, 1.0)
    points = np.column_stack([depth[:, None] * homogeneous(x0), np.ones(len(x0))])
    points[~known] = np.nan
    return TrackedPoints(time, points, np.where(known[:, None], positions, np.nan))


def interpolated_camera(model: Model, time: float) -> Floats:
    """Guess the camera of an instant: between those of the key frames.

    Parameters
    ----------
    model : Model
        The scene.
    time : float
        Instant, 0 at the first and 1 at the second key frame.

    Returns
    -------
    ndarray of shape (3, 4), float64
        Projection matrix in normalised coordinates, Frobenius norm sqrt(3).
    """
    return _normalized((1.0 - time) * model.first_camera + time * model.second_camera)


def intermediate_cameras(
    model: Model, instants: Sequence[TrackedPoints], options: ResectionOptions | None = None
) -> list[Resection]:
    """Find the cameras of any instants, from real tracks or from guessed ones alike.

    The points stay; so the cameras do not depend on each other.

    Parameters
    ----------
    model : Model
        The scene.
    instants : sequence of TrackedPoints
        From `tracked_points`, or from `linear_points` where there are no tracks.
    options : ResectionOptions, optional
        Parameters; the defaults if None.

    Returns
    -------
    list of Resection
        One for each instant.

    References
    ----------
    [Maitre2008] Eq. (5.7) with the depths fixed.
    """
    return [
        resection(
            instant.points,
            instant.positions,
            model.pixel_frame,
            prior=interpolated_camera(model, instant.time),
            options=options,
        )
        for instant in instants
    ]


def resection(
    points: Floats,
    positions: Floats,
    frame: PixelFrame,
    prior: Floats | None = None,
    weights: Floats | None = None,
    options: ResectionOptions | None = None,
    expected: ExpectedPoints | None = None,
) -> Resection:
    """Find the camera that sees points of the scene where they are seen, in spite of outliers.

    Linear least squares, reweighted so that distances in the image count, then robust minimisation of these
    distances. A prior camera, first moved to fit the points by an affine map of its image, settles what
    few points, or points near a plane, leave open.

    Parameters
    ----------
    points : ndarray of shape (N, 4), float64
        Homogeneous 3D points with a third entry that is not 0.
    positions : ndarray of shape (N, 2), float64
        Where they are seen, in pixels; what is not finite is left out.
    frame : PixelFrame
        Size of the image.
    prior : ndarray of shape (3, 4), float64, optional
        A guess, in normalised coordinates; the first key frame's camera ``[I | 0]`` if None.
    weights : ndarray of shape (N,), float64, optional
        Weights of the squared distances; equal if None.
    options : ResectionOptions, optional
        Parameters; the defaults if None.
    expected : ExpectedPoints, optional
        More to minimise: distances, none of them an outlier, from where the path of the camera leads.

    Returns
    -------
    Resection
        The camera, or the reason why it cannot be trusted.

    Raises
    ------
    ValueError
        If shapes do not agree.

    References
    ----------
    [Maitre2008] Sec. 5.3.1 and Appendix B.
    """
    options = options or ResectionOptions()
    num = len(points)
    if (
        points.shape != (num, 4)
        or positions.shape != (num, 2)
        or (weights is not None and len(weights) != num)
    ):
        raise ValueError(
            f"expected (N, 4) points and (N, 2) positions, got {points.shape}, {positions.shape}"
        )
    known = np.isfinite(points).all(axis=1) & np.isfinite(positions).all(axis=1)
    known &= np.abs(np.where(known, points[:, 2], 0.0)) > TINY
    if weights is not None:
        known &= weights > 0
    used = np.flatnonzero(known)
    residuals = np.full(num, np.inf)
    guess = np.eye(3, 4) if prior is None else _normalized(prior)
    if len(used) < options.min_num_points:
        reason = f"{len(used)} points, {options.min_num_points} are needed"
        return Resection(guess, np.zeros(num, dtype=bool), residuals, 0.0, reason)
    x = points[used] / points[used, 2:3]
    seen = frame.to_normalized(positions[used])
    given = np.ones(len(used)) if weights is None else weights[used] / weights[used].max()
    problem = _problem(x, seen, given, guess, frame, options)
    if expected is not None:
        problem = _with_expected(problem, expected, frame)
    camera = _minimize(problem, _linear(problem, options), options)
    residuals[used] = _distances(problem, camera)[: len(used)] * frame.scale_px
    return _judge(camera, residuals, frame, problem, options)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Points as (x, y, 1, inverse depth), well scaled; after the real ones come those that the prior camera
    sees, and those that are expected from other instants.

    `to_scaled` takes unscaled points; `sigma` is the standard deviation of a virtual point, in normalised
    units; `least` that of the noise.
    """

    x: Floats
    seen: Floats
    weights: Floats
    num_real: int
    num_virtual: int
    to_scaled: Floats
    start: Floats
    sigma: float
    least: float


def _problem(
    x: Floats,
    seen: Floats,
    given: Floats,
    prior: Floats,
    frame: PixelFrame,
    options: ResectionOptions,
) -> _Problem:
    least = options.min_noise_px / frame.scale_px
    middle, spread = x.mean(axis=0), x.std(axis=0)
    size = np.maximum(spread, np.array([0.05, 0.05, 1.0, 1e-6 + 0.02 * abs(middle[3])]))
    to_scaled = np.diag(1.0 / size)
    to_scaled[[0, 1, 3], 2] = -middle[[0, 1, 3]] / size[[0, 1, 3]]
    to_scaled[2, 2] = 1.0
    moved, error = _moved_to_fit(prior, x, seen, given, least)
    error_px = 3.0 * error * frame.scale_px
    sigma_px = float(np.clip(error_px, options.min_prior_sigma_px, options.max_prior_sigma_px))
    virtual = _virtual_points(x[:, 3], frame)
    p = virtual @ moved.T
    ahead = p[:, 2] > 1e-3 * CAMERA_NORM
    everything = np.vstack([x, virtual[ahead]]) @ to_scaled.T
    observed = np.vstack([seen, p[ahead, :2] / p[ahead, 2:]])
    # Many virtual points stand for few parameters.
    num_virtual = int(np.count_nonzero(ahead))
    each = NUM_PARAMETERS / (2.0 * max(1, num_virtual))
    all_weights = np.concatenate([given, np.full(num_virtual, each)])
    start = moved @ np.linalg.inv(to_scaled)
    return _Problem(
        everything,
        observed,
        all_weights,
        len(x),
        num_virtual,
        to_scaled,
        start,
        sigma_px / frame.scale_px,
        least,
    )


def _with_expected(problem: _Problem, expected: ExpectedPoints, frame: PixelFrame) -> _Problem:
    """Append points that count together as `expected` says."""
    x = expected.points / expected.points[:, 2:3]
    each = expected.weight * float(problem.weights[: problem.num_real].sum()) / len(x)
    return replace(
        problem,
        x=np.vstack([problem.x, x @ problem.to_scaled.T]),
        seen=np.vstack([problem.seen, frame.to_normalized(expected.positions)]),
        weights=np.concatenate([problem.weights, np.full(len(x), each)]),
    )


def _virtual_points(inverse: Floats, frame: PixelFrame) -> Floats:
    """Return points (V, 4) all over the image, nearer and farther than the points of the scene."""
    low, high = float(np.quantile(inverse, 0.05)), float(np.quantile(inverse, 0.95))
    margin = 0.25 * max(abs(low), abs(high)) + 0.25 * (high - low)
    right, bottom = 0.5 * frame.width_px / frame.scale_px, 0.5 * frame.height_px / frame.scale_px
    steps = np.array([-1.0, 0.0, 1.0])
    grid = np.meshgrid(right * steps, bottom * steps, [low - margin, high + margin])
    x, y, depth = (axis.ravel() for axis in grid)
    return np.column_stack([x, y, np.ones_like(x), depth])


def _moved_to_fit(
    camera: Floats, x: Floats, seen: Floats, given: Floats, least: float
) -> tuple[Floats, float]:
    """Move a camera's image by a robust affine map on to the points; also return the error that remains."""
    p = x @ camera.T
    ahead = p[:, 2] > 1e-6
    if np.count_nonzero(ahead) < 4:
        return camera, math.inf
    guess = homogeneous(p[ahead, :2] / p[ahead, 2:])
    target, weight = seen[ahead], given[ahead]
    affine = np.eye(3)
    affine[:2, 2] = np.median(target - guess[:, :2], axis=0)
    error = 0.0
    for _ in range(10):
        offset = target - guess @ affine[:2].T
        distance = np.hypot(offset[:, 0], offset[:, 1])
        error = max(least, float(np.median(distance)) / MEDIAN_OF_RAYLEIGH)
        robust = weight / np.maximum(distance, error)
        normal = np.einsum("n,ni,nj->ij", robust, guess, guess)
        slope = np.einsum("n,ni,nk->ik", robust, guess, offset)
        # Points on a line leave part of the map open: the damping leaves it at the identity.
        affine[0] += solve_damped(normal, slope[:, 0], 1e-6)
        affine[1] += solve_damped(normal, slope[:, 1], 1e-6)
    return affine @ camera, error


def _distances(problem: _Problem, camera: Floats) -> Floats:
    """Return the reprojection errors of all points, real and virtual, in normalised units."""
    p = problem.x @ camera.T
    offset = p[:, :2] / _nonzero(p[:, 2])[:, None] - problem.seen
    distances: Floats = np.hypot(offset[:, 0], offset[:, 1])
    return distances


def _nonzero(values: Floats) -> Floats:
    return np.where(np.abs(values) > 1e-9, values, 1e-9)


def _robust_weights(problem: _Problem, distances: Floats, redescending: bool) -> tuple[Floats, float]:
    """Weigh points by their errors, and return the noise; virtual points count by their own uncertainty."""
    real = distances[: problem.num_real]
    free = max(1.0, 2.0 * problem.num_real - NUM_PARAMETERS) / (2.0 * problem.num_real)
    noise = max(problem.least, float(np.median(real)) / (MEDIAN_OF_RAYLEIGH * math.sqrt(free)))
    if redescending:
        robust = np.maximum(0.0, 1.0 - (real / (TUKEY_TUNING * noise)) ** 2) ** 2
    else:
        robust = noise / np.maximum(real, noise)
    weights = problem.weights.copy()
    weights[: problem.num_real] *= robust
    weights[problem.num_real : problem.num_real + problem.num_virtual] *= (noise / problem.sigma) ** 2
    return weights, noise


def _linear(problem: _Problem, options: ResectionOptions) -> Floats:
    """Solve the linear equations of (B.2), reweighted by the denominators and robustly."""
    camera = problem.start
    for _ in range(options.num_linear_iterations):
        weights, _ = _robust_weights(problem, _distances(problem, camera), redescending=False)
        kappa = 1.0 / np.maximum(np.abs(problem.x @ camera[2]), 1e-3 * np.abs(camera[2]).max())
        scaled = (np.sqrt(weights) * kappa)[:, None] * problem.x
        zero = np.zeros_like(scaled)
        horizontal = np.hstack([-scaled, zero, problem.seen[:, :1] * scaled])
        vertical = np.hstack([zero, -scaled, problem.seen[:, 1:] * scaled])
        normal = np.einsum("ni,nj->ij", horizontal, horizontal) + np.einsum("ni,nj->ij", vertical, vertical)
        found: Floats = np.linalg.eigh(normal)[1][:, 0].reshape(3, 4)
        behind = np.count_nonzero(problem.x @ found[2] < 0)
        camera = -found if 2 * behind > len(problem.x) else found
    return camera


def _minimize(problem: _Problem, start: Floats, options: ResectionOptions) -> Floats:
    """Minimise robust distances in the image by Levenberg-Marquardt steps, from the better of two starts."""
    errors = [np.median(_distances(problem, c)[: problem.num_real]) for c in (start, problem.start)]
    camera = start if errors[0] <= errors[1] else problem.start
    camera, damping = camera / np.sqrt((camera * camera).sum()), 1e-6
    weights = problem.weights
    for iteration in range(options.max_iterations):
        distances = _distances(problem, camera)
        # The weights settle first; then they stay, so that the steps converge.
        if iteration < options.max_iterations // 2:
            weights, _ = _robust_weights(problem, distances, redescending=True)
        cost = float((weights * distances * distances).sum())
        normal, slope = _linearize(problem, camera, weights)
        for _ in range(8):
            candidate = camera - solve_damped(normal, slope, damping).reshape(3, 4)
            candidate /= np.sqrt((candidate * candidate).sum())
            new_cost = float((weights * _distances(problem, candidate) ** 2).sum())
            if new_cost <= cost:
                break
            damping *= 10.0
        else:
            break
        change = float(np.abs(candidate - camera).max())
        camera, damping = candidate, max(0.1 * damping, 1e-12)
        if change < 1e-12:
            break
    best: Floats = camera
    return best


def _linearize(problem: _Problem, camera: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return the normal equations (12, 12) and (12,) of the weighted distances in the image."""
    p = problem.x @ camera.T
    depth = _nonzero(p[:, 2])
    uv = p[:, :2] / depth[:, None]
    root = np.sqrt(weights)[:, None]
    scaled = root * problem.x / depth[:, None]
    zero = np.zeros_like(scaled)
    horizontal = np.hstack([scaled, zero, -uv[:, :1] * scaled])
    vertical = np.hstack([zero, scaled, -uv[:, 1:] * scaled])
    errors = root * (uv - problem.seen)
    normal = np.einsum("ni,nj->ij", horizontal, horizontal) + np.einsum("ni,nj->ij", vertical, vertical)
    slope = np.einsum("ni,n->i", horizontal, errors[:, 0]) + np.einsum("ni,n->i", vertical, errors[:, 1])
    return normal, slope


def _judge(
    scaled_camera: Floats,
    residuals_px: Floats,
    frame: PixelFrame,
    problem: _Problem,
    options: ResectionOptions,
) -> Resection:
    camera = _normalized(scaled_camera @ problem.to_scaled)
    noise = _robust_weights(problem, _distances(problem, scaled_camera), redescending=True)[1]
    limit = max(options.min_threshold_px, options.threshold_in_sigmas * noise * frame.scale_px)
    inliers = residuals_px < limit
    count = int(np.count_nonzero(inliers))
    rms = math.sqrt(float((residuals_px[inliers] ** 2).mean())) if count else 0.0
    ahead = np.count_nonzero(problem.x[: problem.num_real] @ scaled_camera[2] > 0)
    reason = ""
    if count < max(options.min_num_points, options.min_inlier_share * problem.num_real):
        reason = f"only {count} of {problem.num_real} points agree with the camera"
    elif rms > options.max_rms_px:
        reason = f"points are {rms:.1f} px from where the camera sees them"
    elif ahead < 0.9 * problem.num_real:
        reason = f"{problem.num_real - ahead} of {problem.num_real} points are behind the camera"
    return Resection(camera, inliers, residuals_px, rms, reason)


def _normalized(camera: Floats) -> Floats:
    scaled: Floats = CAMERA_NORM * camera / np.sqrt(max(float((camera * camera).sum()), TINY))
    return scaled
