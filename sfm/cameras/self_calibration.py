"""Quasi-Euclidean self-calibration: from a fundamental matrix to cameras and depths that look Euclidean."""

import math
from dataclasses import dataclass

import numpy as np

from dvc.arrays import Floats, Mask
from dvc.geometry.cameras import PixelFrame, homogeneous
from dvc.geometry.triangulation import inverse_depths
from sfm.decompositions import right_singular
from sfm.estimation.epipolar import epipoles, fundamental_to_normalized, skew
from sfm.scene_model import Correspondences

NUM_ENTRIES = 9
"""Number of entries of R; the absolute difference of each from I is a variable."""
MIN_UNIT = 1e-9
"""Least inverse unit of depth, which must be positive."""
TOLERANCE = 1e-7
"""Tolerance of the linear program."""
MIN_RANK = 1e-12
"""Least singular value of a matrix of full rank, relative to the largest."""
DEPTH_RATIO_FACTOR = 2.0
"""Growth of M, the ratio of the largest to the smallest depth, until a solution exists."""
MAX_DEPTH_RATIO = 4096.0
"""Largest M to try."""
MIN_NUM_POINTS = 8
"""Least number of remaining points."""
OUTWEIGH = 3.0
"""Weight of the slack: a change of a by 1 changes R by up to sqrt(3), and an inverse depth by about 1."""


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


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """Result of the self-calibration."""

    # the second camera in normalised coordinates, Frobenius norm sqrt(3); the first is ``[I | 0]``
    camera: Floats
    # depth of each point in the first camera, in [1, `depth_ratio`]; 1 for dropped points
    depths: Floats
    kept: Mask  # points that were not dropped
    depth_ratio: float  # M, the bound on the depths
    reason: str  # reason of a failure; empty on success

    @property
    def success(self) -> bool:
        """Whether the cameras are valid."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class _Points:
    """Points in front of or behind both cameras: homogeneous, with inverse depths and quotients of depths."""

    first: Floats
    inverse: Floats
    quotient: Floats


@dataclass(frozen=True, eq=False)
class _Solution:
    """Solution of a linear program: the sign of t, a, q, the cost, and a mask of points within bounds."""

    sign: float
    a: Floats
    q: float
    cost: float
    kept: Mask


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
    if not np.isfinite(fundamental).all() or not _has_rank_two(fundamental):
        return _failure(num, "the fundamental matrix has not rank 2")
    if num < MIN_NUM_POINTS:
        return _failure(num, f"{num} points, {MIN_NUM_POINTS} are needed")
    camera, inverse, depth_quotient = _projective_depths(fundamental, correspondences, frame)
    same_side = np.isfinite(inverse) & (depth_quotient > 0)
    least = max(MIN_NUM_POINTS, math.ceil((1.0 - settings.max_dropped_share) * num))
    wrong = num - int(np.count_nonzero(same_side))
    if num - wrong < least:
        return _failure(num, f"{wrong} of {num} points are on the wrong side of a camera")
    x = homogeneous(frame.to_normalized(correspondences.first))[same_side]
    points = _Points(x, inverse[same_side], depth_quotient[same_side])
    solved = _solve(camera, points, least, settings)
    if solved is None:
        return _failure(num, f"no plane at infinity bounds the depths by {MAX_DEPTH_RATIO:g}")
    return _apply(camera, points, same_side, *solved)


def _has_rank_two(fundamental: Floats) -> bool:
    singular, _ = right_singular(fundamental)
    return bool(singular[1] > MIN_RANK * singular[0])


def _failure(num: int, reason: str) -> SelfCalibration:
    return SelfCalibration(np.eye(3, 4), np.ones(num), np.zeros(num, dtype=bool), 1.0, reason)


def _projective_depths(
    fundamental: Floats, correspondences: Correspondences, frame: PixelFrame
) -> tuple[Floats, Floats, Floats]:
    """Return a camera with R of unit size, inverse depths, and quotients of depths, mostly positive."""
    normalized = fundamental_to_normalized(fundamental, frame)
    singular, _ = right_singular(normalized)
    camera = projective_camera(normalized / math.sqrt(singular[0] * singular[1]))
    first = frame.to_normalized(correspondences.first)
    second = frame.to_normalized(correspondences.second)
    with np.errstate(invalid="ignore", over="ignore"):  # points that are not finite
        inverse, depth_quotient = inverse_depths(first, camera, second)
    if np.count_nonzero(depth_quotient < 0) > np.count_nonzero(depth_quotient > 0):
        return -camera, inverse, -depth_quotient
    return camera, inverse, depth_quotient


def _solve(
    camera: Floats, points: _Points, least: int, settings: SelfCalibrationSettings
) -> tuple[_Solution, float] | None:
    """Increase M until a solution drops few enough points."""
    # The ratio of a point's two depths does not depend on the plane at infinity: it bounds M from below.
    bounds = np.maximum(points.quotient, 1.0 / points.quotient)
    first = settings.first_depth_ratio or _ratio_of_depths(points)
    ratio = max(first, float(np.quantile(bounds, 1.0 - settings.dropped_share)))
    while True:
        last = ratio * DEPTH_RATIO_FACTOR > MAX_DEPTH_RATIO
        share = settings.max_dropped_share if last else settings.dropped_share
        enough = max(least, math.ceil((1.0 - share) * len(points.inverse)))
        candidates = [_linear_program(camera, points, sign, ratio, settings) for sign in (1.0, -1.0)]
        solutions = [s for s in candidates if s is not None and np.count_nonzero(s.kept) >= enough]
        if solutions:
            return min(solutions, key=lambda solution: solution.cost), ratio
        if last:
            return None
        ratio *= DEPTH_RATIO_FACTOR


def _ratio_of_depths(points: _Points) -> float:
    """Return the largest over the smallest of all depths, of both cameras."""
    depths = 1.0 / np.maximum(np.abs(points.inverse), MIN_UNIT)
    largest, smallest = np.maximum(points.quotient, 1.0), np.minimum(points.quotient, 1.0)
    return float(np.max(depths * largest) / np.min(depths * smallest))


def _linear_program(
    camera: Floats, points: _Points, sign: float, ratio: float, settings: SelfCalibrationSettings
) -> _Solution | None:
    """Minimise the sum of the magnitudes of R - t a' - I under (5.4), for one sign of t."""
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack, vstack

    num = len(points.inverse)
    t, inverse = sign * camera[:, 3], sign * points.inverse
    smallest, largest = np.minimum(1.0, points.quotient), np.maximum(1.0, points.quotient)
    lower = np.column_stack([-points.first, largest / ratio])
    upper = np.column_stack([points.first, -smallest])
    # Entry (i, j) of R - t a' is R_ij - t_i a_j.
    entries = np.hstack([-np.kron(t[:, None], np.eye(3)), np.zeros((NUM_ENTRIES, 1))])
    away = (np.eye(3) - camera[:, :3]).ravel()
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
    a, q = solved.x[:3], float(solved.x[3])
    return _Solution(sign, a, q, float(solved.fun), solved.x[4 + NUM_ENTRIES :] <= TOLERANCE)


def _apply(
    camera: Floats, points: _Points, same_side: Mask, solution: _Solution, ratio: float
) -> SelfCalibration:
    """Change the projective frame, with a unit of depth that makes the least depth about 1."""
    t = solution.sign * camera[:, 3]
    inverse = (points.first @ solution.a + solution.sign * points.inverse) / solution.q
    kept, depths = same_side.copy(), np.ones(len(same_side))
    kept[np.flatnonzero(same_side)[~solution.kept]] = False
    depths[kept] = np.clip(1.0 / inverse[solution.kept], 1.0, ratio)
    # P is only defined up to scale: the unit of depth scales only t, the norm scales all of P.
    found = np.column_stack([camera[:, :3] - np.outer(t, solution.a), solution.q * t])
    found *= math.sqrt(3.0 / float((found * found).sum()))
    return SelfCalibration(found, depths, kept, ratio, "")
