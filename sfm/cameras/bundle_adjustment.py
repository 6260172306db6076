"""Bundle adjustment: the second camera and the depths with the least reprojection error.

Alternated reweighted least squares, as the thesis has it, brings a rough start close; its convergence is
slow, so Levenberg-Marquardt steps on the camera, with the depths eliminated, finish the same problem.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from sfm.decompositions import least_singular
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels
from sfm.least_squares import Damping, levenberg_marquardt, normal_matrix, solve_damped
from sfm.scene_model import Correspondences

TINY = 1e-300
DAMPING = Damping(start=1e-4, min_factor=1e-12, num_tries=12)
MIN_DEPTH = 1e-12


TOLERANCE = 1e-10
"""Relative decrease of the error at convergence."""
MIN_NUM_POINTS = 9


@dataclass(frozen=True, eq=False)
class BundleAdjustment:
    """Refined camera and points."""

    camera: Floats  # camera of the second key frame; normalised coordinates, Frobenius norm sqrt(3)
    depths: Floats  # depth of each point in the first camera
    fundamental: Floats  # ``[t]x R`` in pixels, unit norm
    second: Floats  # the points projected into the second key frame, in pixels
    in_front: Mask  # points in front of both cameras
    fixed: Integers  # two points that fix the projective basis
    rms_px: float  # root mean square of the reprojection errors of all points in the second key frame
    start_rms_px: float  # the same at the start
    num_iterations: int  # number of joint steps
    reason: str  # reason of a failure; empty on success

    @property
    def success(self) -> bool:
        """Whether the camera was adjusted."""
        return not self.reason


def bundle_adjustment(
    correspondences: Correspondences,
    camera: Floats,
    depths: Floats,
    frame: PixelFrame,
    rng: np.random.Generator,
    num_alternations: int = 3,
    max_iterations: int = 100,
) -> BundleAdjustment:
    """Minimise the reprojection error over depths and camera.

    At most `num_alternations` of the thesis precede at most `max_iterations` joint steps.
    """
    num = len(correspondences)
    if depths.shape != (num,):
        raise ValueError(f"expected {num} depths, got {depths.shape}")
    first, second = frame.to_normalized(correspondences.first), frame.to_normalized(correspondences.second)
    usable = correspondences.finite & np.isfinite(depths) & (depths != 0)
    start = _State(normalized_camera(camera), 1.0 / np.where(usable, depths, np.inf))
    if np.count_nonzero(usable) < MIN_NUM_POINTS or not usable.all():
        counts = f"{np.count_nonzero(usable)} of {num}"
        reason = f"{counts} points are usable; all must be, and {MIN_NUM_POINTS} are needed"
        return _failure(start, correspondences, depths, reason)
    state = _triangulated(first, second, start)
    problem = _Adjustment(first, second, np.ones(num, dtype=bool), np.eye(12))
    errors = np.sqrt((problem.errors(state) ** 2).sum(axis=1))
    fixed = choose_fixed_points(first, second, state.camera, errors, rng)
    if fixed is None:
        return _failure(start, correspondences, depths, "no two points differ")
    problem, state = _fix_basis(problem, state, fixed)
    state = _alternate(problem, state, num_alternations)
    state, num_iterations = levenberg_marquardt(problem, state, DAMPING, max_iterations)
    return _result(problem, start, state, frame, fixed, num_iterations)


class _State(NamedTuple):
    """Variables: the camera (3, 4), in the basis, and inverse depths (N,)."""

    camera: Floats
    inverse: Floats


def _failure(start: _State, pairs: Correspondences, depths: Floats, reason: str) -> BundleAdjustment:
    none, fixed = np.zeros(len(depths), dtype=bool), np.zeros(2, dtype=np.int64)
    return BundleAdjustment(
        start.camera, depths, np.zeros((3, 3)), pairs.second, none, fixed, 0.0, 0.0, 0, reason
    )


def _triangulated(first: Floats, second: Floats, start: _State) -> _State:
    """Move points to the depths that fit the second key frame best, if these are positive."""
    inverse, quotient = inverse_depths(first, start.camera, second)
    return _State(start.camera, np.where((inverse > 0) & (quotient > 0), inverse, start.inverse))


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
        projected: Floats = turned + state.inverse[:, None] * state.camera[:, 3]
        return projected

    def errors(self, state: _State) -> Floats:
        """Return the reprojection errors (N, 2) in normalised units."""
        p = self.project(state)
        errors: Floats = p[:, :2] / nonzero(p[:, 2])[:, None] - self.observed
        return errors

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


def _fix_basis(problem: _Adjustment, start: _State, fixed: Integers) -> tuple[_Adjustment, _State]:
    """Fix two points and their projections."""
    points = np.column_stack([homogeneous(problem.first[fixed]), start.inverse[fixed]])
    basis = camera_basis(points, project(start.camera, points)[0])
    free = problem.free.copy()
    free[fixed] = False
    camera = camera_from_coordinates(basis, coordinates_of_camera(basis, start.camera))
    return replace(problem, free=free, basis=basis), _State(camera, start.inverse)


def _alternate(problem: _Adjustment, state: _State, count: int) -> _State:
    """Alternate camera and depth steps (Appendix B) while the error falls."""
    first, observed = problem.first, problem.observed
    depths, kappa, cost = 1.0 / state.inverse, np.ones(len(first)), problem.cost(state)
    best = state
    for _ in range(count):
        camera = camera_step(first, depths, observed, kappa, problem.basis)
        new = depth_step(first, observed, camera, kappa)
        depths = np.where(problem.free & np.isfinite(new) & (new != 0), new, depths)
        kappa = denominators(first, depths, camera)
        candidate = _State(camera, 1.0 / depths)
        new_cost = problem.cost(candidate)
        if new_cost >= cost:
            break
        best, cost = candidate, new_cost
    return best


def _result(
    problem: _Adjustment,
    start: _State,
    state: _State,
    frame: PixelFrame,
    fixed: Integers,
    num_iterations: int,
) -> BundleAdjustment:
    rms, start_rms = (
        frame.scale_px * math.sqrt(problem.cost(s) / len(problem.first)) for s in (state, start)
    )
    p = problem.project(state)
    fundamental = fundamental_to_pixels(fundamental_from_camera(state.camera), frame)
    second = frame.to_pixels(p[:, :2] / nonzero(p[:, 2])[:, None])
    in_front = (state.inverse > 0) & (p[:, 2] > 0)
    tiny = np.where(state.inverse < 0, -TINY, TINY)
    depths = 1.0 / np.where(np.abs(state.inverse) > TINY, state.inverse, tiny)
    return BundleAdjustment(
        state.camera, depths, fundamental, second, in_front, fixed, rms, start_rms, num_iterations, ""
    )


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
    depths: Floats = np.where(aa > 0, -ab / np.where(aa > 0, aa, 1.0), np.nan)
    return depths


def denominators(first: Floats, depths: Floats, camera: Floats) -> Floats:
    """Return the weights kappa: the inverse depths of the points in a camera."""
    kappa: Floats = 1.0 / nonzero(depths * (homogeneous(first) @ camera[2, :3]) + camera[2, 3])
    return kappa
