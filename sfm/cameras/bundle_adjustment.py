"""Bundle adjustment: cameras and depths with the least reprojection error in all frames but the first.

Alternated reweighted least squares, as the thesis has it, brings a rough start close; its convergence is
slow, so Levenberg-Marquardt steps on the cameras, with the depths eliminated, finish the same problem.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import PixelFrame, homogeneous, project
from dvc.multiview.triangulation import inverse_depths
from sfm.cameras.alternation import camera_step, denominators, depth_step, nonzero
from sfm.cameras.projective_basis import (
    CAMERA_NORM,
    FixedPointOptions,
    camera_basis,
    camera_from_coordinates,
    choose_fixed_points,
    coordinates_of_camera,
)
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels
from sfm.least_squares import solve_damped
from sfm.model import Correspondences

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

TINY = 1e-300


@dataclass(frozen=True)
class BundleAdjustmentOptions:
    """Parameters of the bundle adjustment.

    Attributes
    ----------
    num_alternations : int
        Most alternations of the thesis before the joint steps; they end when they do not help.
    max_iterations : int
        Bound on the number of joint steps.
    tolerance : float
        Relative decrease of the error below which the adjustment has converged.
    min_num_points : int
        Points that are needed.
    fixed_points : FixedPointOptions
        Which two points fix the projective basis.
    """

    num_alternations: int = 3
    max_iterations: int = 100
    tolerance: float = 1e-10
    min_num_points: int = 9
    fixed_points: FixedPointOptions = field(default_factory=FixedPointOptions)

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.num_alternations < 0 or self.max_iterations < 0:
            raise ValueError("numbers of iterations must not be negative")
        if self.min_num_points < 9:
            raise ValueError(f"`min_num_points` must be at least 9, got {self.min_num_points}")


@dataclass(frozen=True, eq=False)
class BundleAdjustment:
    """Refined cameras and points.

    Attributes
    ----------
    cameras : ndarray of shape (T, 3, 4), float64
        Cameras of the intermediate frames in order, then of the second key frame; normalised
        coordinates, Frobenius norm sqrt(3).
    depths : ndarray of shape (N,), float64
        Depth of each point in the first camera.
    fundamental : ndarray of shape (3, 3), float64
        ``[t]x R`` of the second key frame, in pixels, unit norm.
    second : ndarray of shape (N, 2), float64
        The points projected into the second key frame, in pixels.
    in_front : ndarray of shape (N,), bool
        Points that are before all cameras.
    fixed : ndarray of shape (2,), int64
        The points that fix the projective basis.
    rms_px : float
        Root mean square of the reprojection errors of all points in all frames but the first.
    start_rms_px : float
        The same before.
    num_iterations : int
        Joint steps.
    reason : str
        Why nothing was refined; empty if all is well.
    """

    cameras: Floats
    depths: Floats
    fundamental: Floats
    second: Floats
    in_front: Mask
    fixed: Indices
    rms_px: float
    start_rms_px: float
    num_iterations: int
    reason: str

    @property
    def success(self) -> bool:
        """Whether the result is an adjusted one."""
        return not self.reason

    @property
    def camera(self) -> Floats:
        """Camera of the second key frame, shape (3, 4)."""
        return np.asarray(self.cameras[-1])


def bundle_adjustment(
    correspondences: Correspondences,
    camera: Floats,
    depths: Floats,
    frame: PixelFrame,
    rng: np.random.Generator,
    options: BundleAdjustmentOptions | None = None,
    tracks: Floats | None = None,
    cameras: Floats | None = None,
) -> BundleAdjustment:
    """Minimise the reprojection error over depths and cameras.

    The first key frame has no error by construction: its points are taken as they are.

    Parameters
    ----------
    correspondences : Correspondences
        Reliable points of the two key frames, in pixels.
    camera : ndarray of shape (3, 4), float64
        The second key frame's camera in normalised coordinates; the first is ``[I | 0]``.
    depths : ndarray of shape (N,), float64
        Depths in the first camera, not zero.
    frame : PixelFrame
        Size of the images.
    rng : Generator
        Source of randomness, for the points that fix the projective basis.
    options : BundleAdjustmentOptions, optional
        Parameters; the defaults if None.
    tracks : ndarray of shape (T, N, 2), float64, optional
        Positions in intermediate frames, in pixels; nan where a point was not seen.
    cameras : ndarray of shape (T, 3, 4), float64, optional
        Cameras of these frames, where to start; needed with `tracks`.

    Returns
    -------
    BundleAdjustment
        What was refined, or what was given with the reason why it could not be.

    Raises
    ------
    ValueError
        If there are tracks without cameras, or their shapes do not agree.

    References
    ----------
    [Maitre2008] Eqs. (5.5) to (5.7), Appendices A and B.
    """
    options = options or BundleAdjustmentOptions()
    problem, start = _prepare(correspondences, camera, depths, frame, tracks, cameras)
    usable = (start.inverse != 0) & (problem.weights[-1] > 0)
    if np.count_nonzero(usable) < options.min_num_points or not usable.all():
        counts = f"{np.count_nonzero(usable)} of {len(usable)}"
        reason = f"{counts} points are usable; all must be, and {options.min_num_points} are needed"
        return _result(problem, start, start, frame, np.zeros(2, dtype=np.int64), 0, reason)
    state = _triangulated(problem, start)
    errors = np.sqrt((_errors(problem, state)[-1] ** 2).sum(axis=1))
    fixed = choose_fixed_points(
        problem.first, problem.observed[-1], state.cameras[-1], errors, rng, options.fixed_points
    )
    if fixed is None:
        reason = "no two points differ"
        return _result(problem, start, start, frame, np.zeros(2, dtype=np.int64), 0, reason)
    problem, state = _fix_basis(problem, state, fixed)
    state = _alternate(problem, state, options.num_alternations)
    state, num_iterations = _minimize(problem, state, options)
    return _result(problem, start, state, frame, fixed, num_iterations, "")


@dataclass(frozen=True, eq=False)
class _Problem:
    """What stays: points of the first frame, observed points (T, N, 2) with weights, and the basis."""

    first: Floats
    observed: Floats
    weights: Floats
    free: Mask
    basis: Floats


@dataclass(frozen=True, eq=False)
class _State:
    """What changes: cameras (T, 3, 4), the last in the basis, and inverse depths (N,)."""

    cameras: Floats
    inverse: Floats


def _prepare(
    correspondences: Correspondences,
    camera: Floats,
    depths: Floats,
    frame: PixelFrame,
    tracks: Floats | None,
    cameras: Floats | None,
) -> tuple[_Problem, _State]:
    num = len(correspondences)
    between = np.empty((0, num, 2)) if tracks is None else tracks
    starts = np.empty((0, 3, 4)) if cameras is None else cameras
    if between.shape != (len(starts), num, 2) or starts.shape[1:] != (3, 4) or depths.shape != (num,):
        raise ValueError(
            f"expected {num} depths, tracks (T, {num}, 2) and cameras (T, 3, 4), "
            f"got {depths.shape}, {between.shape}, {starts.shape}"
        )
    observed = np.concatenate([between, correspondences.second[None]])
    weights = np.isfinite(observed).all(axis=2).astype(np.float64)
    normalized = np.where(weights[:, :, None] > 0, frame.to_normalized(observed), 0.0)
    first = frame.to_normalized(correspondences.first)
    known = np.isfinite(first).all(axis=1) & np.isfinite(depths)
    weights = weights * known
    first = np.where(known[:, None], first, 0.0)
    problem = _Problem(first, normalized, weights, np.ones(num, dtype=bool), np.eye(12))
    everything = np.concatenate([starts, camera[None]])
    norms = np.sqrt((everything * everything).sum(axis=(1, 2)))[:, None, None]
    inverse = 1.0 / np.where(known & (depths != 0), depths, np.inf)
    return problem, _State(CAMERA_NORM * everything / norms, inverse)


def _triangulated(problem: _Problem, start: _State) -> _State:
    """Move all points to the depths that suit the second key frame best, where these are positive."""
    camera = start.cameras[-1]
    inverse, quotient = inverse_depths(problem.first, camera, problem.observed[-1])
    return _State(start.cameras, np.where((inverse > 0) & (quotient > 0), inverse, start.inverse))


def _fix_basis(problem: _Problem, start: _State, fixed: Indices) -> tuple[_Problem, _State]:
    """Fix two points and their projections.

    The projections, not the observed points, which the start would not obey: in noise, two points without
    any error would outweigh all others.
    """
    points = np.column_stack([homogeneous(problem.first[fixed]), start.inverse[fixed]])
    basis = camera_basis(points, project(start.cameras[-1], points)[0])
    free = problem.free.copy()
    free[fixed] = False
    cameras = start.cameras.copy()
    cameras[-1] = camera_from_coordinates(basis, coordinates_of_camera(basis, cameras[-1]))
    fixed_problem = _Problem(problem.first, problem.observed, problem.weights, free, basis)
    return fixed_problem, _State(cameras, start.inverse)


def _errors(problem: _Problem, state: _State) -> Floats:
    """Return the reprojection errors (T, N, 2) in normalised units; 0 where a point was not seen."""
    p = _project(problem, state)
    errors: Floats = (p[:, :, :2] / nonzero(p[:, :, 2])[:, :, None] - problem.observed) * problem.weights[
        :, :, None
    ]
    return errors


def _project(problem: _Problem, state: _State) -> Floats:
    """Return ``R x + inverse depth * t`` for all cameras and points, shape (T, N, 3)."""
    x = homogeneous(problem.first)
    turned = x @ state.cameras[:, :, :3].transpose(0, 2, 1)
    projected: Floats = turned + state.inverse[None, :, None] * state.cameras[:, None, :, 3]
    return projected


def _cost(problem: _Problem, state: _State) -> float:
    return float((_errors(problem, state) ** 2).sum())


def _alternate(problem: _Problem, state: _State, count: int) -> _State:
    """Alternate camera and depth steps (Appendix B) as long as the error becomes less."""
    depths, kappa, cost = 1.0 / state.inverse, problem.weights, _cost(problem, state)
    bases = [np.eye(12)] * (len(problem.observed) - 1) + [problem.basis]
    best = state
    for _ in range(count):
        steps = zip(problem.observed, kappa, bases, strict=True)
        cameras = np.stack([camera_step(problem.first, depths, x, k, basis) for x, k, basis in steps])
        new = depth_step(problem.first, problem.observed, cameras, kappa)
        depths = np.where(problem.free & np.isfinite(new) & (new != 0), new, depths)
        kappa = problem.weights * np.stack(
            [denominators(problem.first, depths, camera) for camera in cameras]
        )
        found = _State(cameras, 1.0 / depths)
        new_cost = _cost(problem, found)
        if new_cost >= cost:
            break
        best, cost = found, new_cost
    return best


def _minimize(problem: _Problem, state: _State, options: BundleAdjustmentOptions) -> tuple[_State, int]:
    """Levenberg-Marquardt steps on the cameras, the depths eliminated (Schur complement)."""
    cost, damping = _cost(problem, state), 1e-4
    for iteration in range(options.max_iterations):
        system = _linearize(problem, state)
        for _ in range(12):
            candidate = _stepped(problem, state, system, damping)
            new_cost = _cost(problem, candidate)
            if new_cost <= cost:
                break
            damping *= 10.0
        else:
            return state, iteration
        decrease, state, cost = cost - new_cost, candidate, new_cost
        damping = max(0.1 * damping, 1e-12)
        if decrease <= options.tolerance * cost:
            return state, iteration + 1
    return state, options.max_iterations


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations: by cameras (D, D) and (D,), by depths (N,) and (N,), and mixed (D, N)."""

    cameras: Floats
    cameras_slope: Floats
    depths: Floats
    depths_slope: Floats
    mixed: Floats


def _linearize(problem: _Problem, state: _State) -> _System:
    p = _project(problem, state)
    w = problem.weights / nonzero(p[:, :, 2])
    uv = p[:, :, :2] / nonzero(p[:, :, 2])[:, :, None]
    errors = (uv - problem.observed) * problem.weights[:, :, None]
    t = state.cameras[:, None, :, 3]
    by_depth = w[:, :, None] * (t[:, :, :2] - uv * t[:, :, 2:]) * problem.free[None, :, None]
    points = np.column_stack([homogeneous(problem.first), state.inverse])
    blocks, slopes, mixed = [], [], []
    for k in range(len(p)):
        scaled, zero = w[k][:, None] * points, np.zeros_like(points)
        horizontal = np.hstack([scaled, zero, -uv[k, :, :1] * scaled])
        vertical = np.hstack([zero, scaled, -uv[k, :, 1:] * scaled])
        if k == len(p) - 1:
            horizontal, vertical = horizontal @ problem.basis, vertical @ problem.basis
        jacobian = np.stack([horizontal, vertical], axis=1)
        blocks.append(np.einsum("nai,naj->ij", jacobian, jacobian))
        slopes.append(np.einsum("nai,na->i", jacobian, errors[k]))
        mixed.append(np.einsum("nai,na->in", jacobian, by_depth[k]))
    size = sum(len(block) for block in blocks)
    cameras, at = np.zeros((size, size)), 0
    for block in blocks:
        cameras[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    depths = (by_depth * by_depth).sum(axis=(0, 2))
    slope = (by_depth * errors).sum(axis=(0, 2))
    return _System(cameras, np.concatenate(slopes), depths, slope, np.vstack(mixed))


def _stepped(problem: _Problem, state: _State, system: _System, damping: float) -> _State:
    """Solve the damped normal equations and take the step."""
    inverse = np.where(system.depths > TINY, 1.0 / np.maximum((1.0 + damping) * system.depths, TINY), 0.0)
    reduced = system.cameras - np.einsum("in,jn->ij", system.mixed * inverse, system.mixed)
    slope = system.cameras_slope - np.einsum("in,n->i", system.mixed, inverse * system.depths_slope)
    step = -solve_damped(reduced, slope, damping)
    inverse_step = -inverse * (system.depths_slope + np.einsum("in,i->n", system.mixed, step))
    cameras = state.cameras.copy()
    for k in range(len(cameras) - 1):
        cameras[k] = _normalized(cameras[k] + step[12 * k : 12 * k + 12].reshape(3, 4))
    cameras[-1] = _normalized(cameras[-1] + (problem.basis @ step[12 * (len(cameras) - 1) :]).reshape(3, 4))
    return _State(cameras, state.inverse + inverse_step)


def _normalized(camera: Floats) -> Floats:
    scaled: Floats = CAMERA_NORM * camera / np.sqrt(max(float((camera * camera).sum()), TINY))
    return scaled


def _result(
    problem: _Problem,
    start: _State,
    state: _State,
    frame: PixelFrame,
    fixed: Indices,
    num_iterations: int,
    reason: str,
) -> BundleAdjustment:
    seen = max(1.0, float(problem.weights.sum()))
    rms = [
        0.0
        if reason and not len(state.inverse)
        else frame.scale_px * math.sqrt(_finite_cost(problem, s) / seen)
        for s in (start, state)
    ]
    p = _project(problem, state)
    fundamental = fundamental_to_pixels(fundamental_from_camera(state.cameras[-1]), frame)
    second = frame.to_pixels(p[-1, :, :2] / nonzero(p[-1, :, 2])[:, None])
    in_front = (state.inverse > 0) & ((p[:, :, 2] > 0) | (problem.weights == 0)).all(axis=0)
    tiny = np.where(state.inverse < 0, -TINY, TINY)
    depths = 1.0 / np.where(np.abs(state.inverse) > TINY, state.inverse, tiny)
    return BundleAdjustment(
        state.cameras, depths, fundamental, second, in_front, fixed, rms[1], rms[0], num_iterations, reason
    )


def _finite_cost(problem: _Problem, state: _State) -> float:
    squared = _errors(problem, state) ** 2
    return float(squared[np.isfinite(squared)].sum())
