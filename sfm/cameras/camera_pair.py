"""The cameras of two key frames: quasi-Euclidean self-calibration, then bundle adjustment.

Alternated reweighted least squares, as the thesis has it, brings a rough start close; its convergence is
slow, so Levenberg-Marquardt steps on the camera, with the depths eliminated, finish the same problem.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvc.arrays import Floats, Integers, Mask
from dvc.geometry.cameras import PixelFrame, homogeneous, project
from dvc.geometry.triangulation import inverse_depths
from sfm.cameras.projective_basis import (
    CAMERA_NORM,
    camera_basis,
    camera_from_coordinates,
    choose_fixed_points,
    coordinates_of_camera,
    normalized_camera,
    projection_equations,
)
from sfm.decompositions import least_singular, right_singular
from sfm.estimation.epipolar import (
    epipoles,
    fundamental_from_camera,
    fundamental_to_normalized,
    fundamental_to_pixels,
    skew,
)
from sfm.least_squares import Damping, levenberg_marquardt, normal_matrix, solve_damped
from sfm.scene_model import Correspondences

NUM_ENTRIES = 9
"""Number of entries of R; the absolute difference of each from I is a variable."""
MIN_UNIT = 1e-9
"""Least inverse unit of depth, which must be positive."""
PROGRAM_TOLERANCE = 1e-7
MIN_RANK = 1e-12
"""Least singular value of a matrix of full rank, relative to the largest."""
DEPTH_RATIO_FACTOR = 2.0
"""Growth of M, the ratio of the largest to the smallest depth, until a solution exists."""
MAX_DEPTH_RATIO = 4096.0
MIN_CALIBRATED_POINTS = 8
"""Least number of points that the self-calibration does not drop."""
OUTWEIGH = 3.0
"""Weight of the slack: a change of a by 1 changes R by up to sqrt(3), and an inverse depth by about 1."""
TINY, MIN_DEPTH = 1e-300, 1e-12
DAMPING = Damping(start=1e-4, min_factor=1e-12, num_tries=12)
TOLERANCE = 1e-10
"""Relative decrease of the error at convergence."""
MIN_ADJUSTED_POINTS = 9


@dataclass(frozen=True)
class SelfCalibrationSettings:
    """Parameters of the self-calibration."""

    # initial M, the ratio of the largest to the smallest depth, or its lower bound if that is more; None: the
    # ratio of all depths before
    first_depth_ratio: float | None = 16.0
    dropped_share: float = 0.05  # largest share of points that are dropped instead of a growth of M
    max_dropped_share: float = 0.25  # largest share of dropped points
    # whether the unit of depth is free; else it is that of the fundamental matrix, for an R of unit size
    free_unit: bool = True


class SelfCalibration(NamedTuple):
    """Result of the self-calibration."""

    camera: Floats  # second camera in normalised coordinates, norm sqrt(3); the first is ``[I | 0]``
    depths: Floats  # depth of each point in the first camera, in [1, `depth_ratio`]; 1 for dropped points
    inliers: Mask  # points that were not dropped
    depth_ratio: float  # M, the bound on the depths
    reason: str  # reason of a failure; empty on success


def projective_camera(fundamental: Floats) -> Floats:
    """Return a second camera that agrees with a fundamental matrix; the first is ``[I | 0]``."""
    first, second = epipoles(fundamental)
    return np.column_stack([skew(second) @ fundamental - np.outer(second, first), second])


def self_calibration(
    fundamental: Floats,
    correspondences: Correspondences,
    frame: PixelFrame,
    settings: SelfCalibrationSettings | None = None,
) -> SelfCalibration:
    """Find cameras closest to ``[I | 0]`` and ``[I | t]`` with positive and bounded depths."""
    settings = settings or SelfCalibrationSettings()
    num = len(correspondences)
    depths, inliers = np.ones(num), np.zeros(num, dtype=bool)

    def failure(reason: str) -> SelfCalibration:
        return SelfCalibration(np.eye(3, 4), depths, inliers, 1.0, reason)

    singular = right_singular(fundamental)[0] if np.isfinite(fundamental).all() else np.zeros(3)
    if not singular[1] > MIN_RANK * singular[0]:
        return failure("the fundamental matrix has not rank 2")
    if num < MIN_CALIBRATED_POINTS:
        return failure(f"{num} points, {MIN_CALIBRATED_POINTS} are needed")
    normalized = fundamental_to_normalized(fundamental, frame)
    singular = right_singular(normalized)[0]
    camera = projective_camera(normalized / math.sqrt(singular[0] * singular[1]))  # R has unit size
    first, second = frame.to_normalized(correspondences.first), frame.to_normalized(correspondences.second)
    with np.errstate(invalid="ignore", over="ignore"):  # points that are not finite
        inverse, quotient = inverse_depths(first, camera, second)
    if np.count_nonzero(quotient < 0) > np.count_nonzero(quotient > 0):
        camera, quotient = -camera, -quotient
    same_side = np.flatnonzero(np.isfinite(inverse) & (quotient > 0))
    least = max(MIN_CALIBRATED_POINTS, math.ceil((1.0 - settings.max_dropped_share) * num))
    if len(same_side) < least:
        return failure(f"{num - len(same_side)} of {num} points are on the wrong side of a camera")
    x, inverse, quotient = homogeneous(first)[same_side], inverse[same_side], quotient[same_side]
    start = settings.first_depth_ratio
    if start is None:
        before = 1.0 / np.maximum(np.abs(inverse), MIN_UNIT)
        start = np.max(before * np.maximum(quotient, 1.0)) / np.min(before * np.minimum(quotient, 1.0))
    # The ratio of a point's two depths does not depend on the plane at infinity: it bounds M from below.
    bounds = np.maximum(quotient, 1.0 / quotient)
    ratio = max(float(start), float(np.quantile(bounds, 1.0 - settings.dropped_share)))
    solutions: list[tuple[float, Floats, Floats, Floats, Mask]] = []
    while not solutions:
        last = ratio * DEPTH_RATIO_FACTOR > MAX_DEPTH_RATIO
        share = settings.max_dropped_share if last else settings.dropped_share
        enough = max(least, math.ceil((1.0 - share) * len(inverse)))
        for t, signed in ((camera[:, 3], inverse), (-camera[:, 3], -inverse)):
            solved = _linear_program(camera[:, :3], t, x, signed, quotient, ratio, settings)
            if solved is not None and np.count_nonzero(solved[2]) >= enough:
                solutions.append((solved[0], t, signed, *solved[1:]))
        if last and not solutions:
            return failure(f"no plane at infinity bounds the depths by {MAX_DEPTH_RATIO:g}")
        ratio *= 1.0 if solutions else DEPTH_RATIO_FACTOR
    _, t, inverse, solution, within = min(solutions, key=lambda each: each[0])
    # Change the projective frame, with a unit of depth that makes the least depth about 1.
    a, q = solution[:3], float(solution[3])
    inliers[same_side[within]] = True
    depths[inliers] = np.clip(1.0 / ((x @ a + inverse) / q)[within], 1.0, ratio)
    # P is only defined up to scale: the unit of depth scales only t, the norm scales all of P.
    result = np.column_stack([camera[:, :3] - np.outer(t, a), q * t])
    result *= math.sqrt(3.0 / float((result * result).sum()))
    return SelfCalibration(result, depths, inliers, ratio, "")


def _linear_program(
    R: Floats,
    t: Floats,
    x: Floats,
    inverse: Floats,
    quotient: Floats,
    ratio: float,
    settings: SelfCalibrationSettings,
) -> tuple[float, Floats, Mask] | None:
    """Minimise the sum of the magnitudes of R - t a' - I under (5.4); return it, a and q, and inliers."""
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack, vstack

    num = len(inverse)
    lower = np.column_stack([-x, np.maximum(1.0, quotient) / ratio])
    upper = np.column_stack([x, -np.minimum(1.0, quotient)])
    # Entry (i, j) of R - t a' is R_ij - t_i a_j.
    entries = np.hstack([-np.kron(t[:, None], np.eye(3)), np.zeros((NUM_ENTRIES, 1))])
    away = (np.eye(3) - R).ravel()
    shared = csr_array(np.vstack([lower, upper, entries, -entries]))
    slack = vstack([eye_array(num), eye_array(num), csr_array((2 * NUM_ENTRIES, num))])
    identity = vstack([csr_array((2 * num, NUM_ENTRIES)), eye_array(NUM_ENTRIES), eye_array(NUM_ENTRIES)])
    matrix = hstack([shared, -identity, -slack]).tocsr()
    limit = np.concatenate([inverse, -inverse, away, -away])
    # Less than `dropped_share` of the points together cannot outweigh the entries of R.
    price = OUTWEIGH / (max(settings.dropped_share, 1.0 / num) * num)
    cost = np.concatenate([np.zeros(4), np.ones(NUM_ENTRIES), np.full(num, price)])
    unit = (MIN_UNIT, None) if settings.free_unit else (1.0, 1.0)
    most = None if settings.max_dropped_share else 0.0
    ranges = [(None, None)] * 3 + [unit] + [(0.0, None)] * NUM_ENTRIES + [(0.0, most)] * num
    solved = linprog(cost, A_ub=matrix, b_ub=limit, bounds=ranges, method="highs")
    if solved.x is None or not solved.success:
        return None
    return float(solved.fun), solved.x[:4], solved.x[4 + NUM_ENTRIES :] <= PROGRAM_TOLERANCE


class BundleAdjustment(NamedTuple):
    """Refined camera and points."""

    camera: Floats  # camera of the second key frame; normalised coordinates, Frobenius norm sqrt(3)
    depths: Floats  # depth of each point in the first camera
    fundamental: Floats  # ``[t]x R`` in pixels, unit norm
    second: Floats  # the points projected into the second key frame, in pixels
    in_front: Mask  # points in front of both cameras
    fixed: Integers  # two points that fix the projective basis
    reason: str  # reason of a failure; empty on success


class _State(NamedTuple):
    """Variables: the camera (3, 4), in the basis, and inverse depths (N,)."""

    camera: Floats
    inverse: Floats


def bundle_adjustment(
    correspondences: Correspondences,
    camera: Floats,
    depths: Floats,
    frame: PixelFrame,
    rng: np.random.Generator,
    num_alternations: int = 3,
    max_iterations: int = 100,
) -> BundleAdjustment:
    """Minimise the reprojection error: alternations of the thesis (Appendix B), then joint steps."""
    num = len(correspondences)
    if depths.shape != (num,):
        raise ValueError(f"expected {num} depths, got {depths.shape}")
    first, second = frame.to_normalized(correspondences.first), frame.to_normalized(correspondences.second)
    usable = correspondences.finite & np.isfinite(depths) & (depths != 0)
    camera, fixed, reason = normalized_camera(camera), None, "no two points differ"
    if np.count_nonzero(usable) < MIN_ADJUSTED_POINTS or not usable.all():
        counts = f"{np.count_nonzero(usable)} of {num}"
        reason = f"{counts} points are usable; all must be, and {MIN_ADJUSTED_POINTS} are needed"
    else:
        fit, quotient = inverse_depths(first, camera, second)
        state = _State(camera, np.where((fit > 0) & (quotient > 0), fit, 1.0 / depths))
        offsets = _Adjustment(first, second, usable, np.eye(12)).errors(state)
        fixed = choose_fixed_points(first, second, camera, np.sqrt((offsets**2).sum(axis=1)), rng)
    if fixed is None:
        none = np.zeros(num, dtype=bool)
        return BundleAdjustment(
            camera, depths, np.zeros((3, 3)), correspondences.second, none, np.zeros(2, np.int64), reason
        )
    points = np.column_stack([homogeneous(first[fixed]), state.inverse[fixed]])
    basis, free = camera_basis(points, project(camera, points)[0]), np.ones(num, dtype=bool)
    free[fixed] = False
    problem = _Adjustment(first, second, free, basis)
    state = _State(camera_from_coordinates(basis, coordinates_of_camera(basis, camera)), state.inverse)
    depths, kappa, cost = 1.0 / state.inverse, np.ones(num), problem.cost(state)
    for _ in range(num_alternations):  # while the error falls
        camera = camera_step(first, depths, second, kappa, basis)
        new = depth_step(first, second, camera, kappa)
        depths = np.where(free & np.isfinite(new) & (new != 0), new, depths)
        kappa = denominators(first, depths, camera)
        candidate = _State(camera, 1.0 / depths)
        new_cost = problem.cost(candidate)
        if new_cost >= cost:
            break
        state, cost = candidate, new_cost
    state = levenberg_marquardt(problem, state, DAMPING, max_iterations)
    p, inverse = problem.project(state), state.inverse
    fundamental = fundamental_to_pixels(fundamental_from_camera(state.camera), frame)
    projected = frame.to_pixels(p[:, :2] / nonzero(p[:, 2])[:, None])
    depths = 1.0 / np.where(np.abs(inverse) > TINY, inverse, np.where(inverse < 0, -TINY, TINY))
    in_front = (inverse > 0) & (p[:, 2] > 0)
    return BundleAdjustment(state.camera, depths, fundamental, projected, in_front, fixed, "")


@dataclass(frozen=True, eq=False)
class _Adjustment:
    """Constants: points of both frames, a mask of free points, and the basis of the camera."""

    first: Floats
    observed: Floats
    free: Mask
    basis: Floats

    def project(self, state: _State) -> Floats:
        """Return ``R x + inverse depth * t`` for all points, shape (N, 3)."""
        turned = homogeneous(self.first) @ state.camera[:, :3].T
        return turned + state.inverse[:, None] * state.camera[:, 3]

    def errors(self, state: _State) -> Floats:
        """Return the reprojection errors (N, 2) in normalised units."""
        p = self.project(state)
        return p[:, :2] / nonzero(p[:, 2])[:, None] - self.observed

    def cost(self, state: _State) -> float:
        return float((self.errors(state) ** 2).sum())

    def converged(self, before: _State, after: _State, decrease: float, cost: float) -> bool:
        del before, after
        return decrease <= TOLERANCE * cost

    def linearize(self, state: _State, iteration: int) -> tuple[float, Callable[[float], _State]]:
        del iteration
        p = self.project(state)
        w = 1.0 / nonzero(p[:, 2])
        uv = p[:, :2] / nonzero(p[:, 2])[:, None]
        errors = uv - self.observed
        t = state.camera[:, 3]
        by_depth = w[:, None] * (t[:2] - uv * t[2:]) * self.free[:, None]
        scaled = w[:, None] * np.column_stack([homogeneous(self.first), state.inverse])
        by_camera = np.stack([rows @ self.basis for rows in projection_equations(scaled, uv)], axis=1)
        # Normal equations of the camera, of the depths, and mixed.
        camera = np.einsum("nai,naj->ij", by_camera, by_camera)
        camera_slope = np.einsum("nai,na->i", by_camera, errors)
        depths, depths_slope = (by_depth * by_depth).sum(axis=1), (by_depth * errors).sum(axis=1)
        mixed = np.einsum("nai,na->in", by_camera, by_depth)

        def stepped(damping: float) -> _State:
            inverse = np.where(depths > TINY, 1.0 / np.maximum((1.0 + damping) * depths, TINY), 0.0)
            reduced = camera - np.einsum("in,jn->ij", mixed * inverse, mixed)
            slope = camera_slope - np.einsum("in,n->i", mixed, inverse * depths_slope)
            step = -solve_damped(reduced, slope, damping)
            inverse_step = -inverse * (depths_slope + np.einsum("in,i->n", mixed, step))
            moved = normalized_camera(state.camera + (self.basis @ step).reshape(3, 4))
            return _State(moved, state.inverse + inverse_step)

        return float((errors**2).sum()), stepped


def nonzero(values: Floats, min_magnitude: float = MIN_DEPTH) -> Floats:
    """Replace values too close to zero for a division."""
    return np.where(np.abs(values) > min_magnitude, values, min_magnitude)


def camera_step(first: Floats, depths: Floats, observed: Floats, kappa: Floats, basis: Floats) -> Floats:
    """Return the camera of least reweighted error for constant depths."""
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(first))])
    equations = projection_equations(kappa[:, None] * points, observed)
    normal = normal_matrix(*(rows @ basis for rows in equations))
    camera: Floats = CAMERA_NORM * (basis @ least_singular(normal)).reshape(3, 4)
    return -camera if np.count_nonzero(points @ camera[2] < 0) > 0.5 * len(points) else camera


def depth_step(first: Floats, observed: Floats, camera: Floats, kappa: Floats) -> Floats:
    """Return the depths of least reweighted error for a constant camera."""
    turned, moved = homogeneous(first) @ camera[:, :3].T, camera[:, 3]
    a = kappa[:, None] * (observed * turned[:, 2:] - turned[:, :2])
    b = kappa[:, None] * (observed * moved[2:] - moved[:2])
    aa, ab = (a * a).sum(axis=1), (a * b).sum(axis=1)
    return np.where(aa > 0, -ab / np.where(aa > 0, aa, 1.0), np.nan)


def denominators(first: Floats, depths: Floats, camera: Floats) -> Floats:
    """Return the weights kappa: the inverse depths of the points in a camera."""
    return 1.0 / nonzero(depths * (homogeneous(first) @ camera[2, :3]) + camera[2, 3])
