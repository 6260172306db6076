"""Curves of points between two key frames, fitted to the points received for the frames between.

The deviation of a hand-held camera from an even path is common to all points of a frame. It is estimated
first, without correspondences: the most frequent difference between predicted and received points is a shift
of the frame. An affine map of the position and of the motion of a point then turns, zooms, advances or
delays the frame; [Maitre2008] does without. Then each correspondence spans a curve over time, a snake. Near
received points pull at it; curves bend little in time, and neighbours in the image deviate alike: linear
least squares, solved again as the curves come closer to their points. [Maitre2008] Sec. 5.4.2, equations as
(5.10).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from dvc.arrays import Floats, Integers
from sfm.correspondences.outliers import delaunay_neighbours
from sfm.least_squares import solve_damped

NUM_TERMS = 5
"""Terms of the affine map: a constant, x and y of the place, x and y of the motion."""
RANGE_PX = 32  # largest shift that is looked for
BLUR_PX = 1.5  # standard deviation of the window under which equal differences are counted
TEMPORAL_OFFSET = 0.3  # share of the motion between the key frames that a frame may be ahead or behind
# offsets that move half of the points less than this, relative to the rest, are not distinguished
OFFSET_STEP_PX = 2.0
NUM_CANDIDATES = 4  # number of shifts that start a refinement of the map
# a change of the deviation from a frame to the next that is as unlikely as one point without a match
JITTER_PX = 6.0
MATCH_RADII_PX = (8.0, 6.0, 5.0, 4.0, 3.0, 2.5)  # largest matching distances of the steps of the refinement
DISTANCE_PX = 1.0  # from here on the weight of a match decreases as the square of its distance
PRIOR_PX = 8.0  # standard deviation of each term of the affine map except the shift, at its largest
SNAKE_RADII_PX = (4.0, 3.0, 2.0, 1.5)  # distance beyond which points are ignored, from one fit to the next
BENDING = 0.1  # weight of the second difference in time (mu^2); that of the difference of neighbours is 1
NEAR_PX = 40.0  # neighbours that are this far apart are coupled half as much
ALIKE_PX = 4.0  # largest difference in motion of neighbours that count as alike
SNAKE_RIDGE = 0.02  # weight that holds snakes which nothing determines
TOLERANCE_PX = 1e-4
MAX_ITERATIONS = 200


class ReceivedPoints:
    """The corners of one frame, and which of them is the nearest to a place."""

    def __init__(self, points: Floats) -> None:
        from scipy.spatial import cKDTree

        self.points = points
        self._tree = cKDTree(points) if len(points) else None

    def __len__(self) -> int:
        """Return the number of corners."""
        return len(self.points)

    def match(self, predicted: Floats, radius_px: float) -> tuple[Integers, Integers, Floats]:
        """Match each corner with at most one of the places that it is the nearest corner to."""
        if self._tree is None or not len(predicted):
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
        distance, nearest = self._tree.query(predicted, distance_upper_bound=radius_px)
        order = np.argsort(distance, kind="stable")
        order = order[np.isfinite(distance[order])]
        found, place = np.unique(nearest[order], return_index=True)
        chosen = order[place]
        return chosen, found.astype(np.int64), np.asarray(distance[chosen], dtype=np.float64)


def affine_terms(first: Floats, second: Floats) -> Floats:
    """Return the linear features of the deviation of a point from constant velocity."""
    middle, motion = 0.5 * (first + second), second - first
    middle = middle - np.median(middle, axis=0)
    motion = motion - np.median(motion, axis=0)
    reach = max(float(np.abs(middle).max()), 1.0)
    spread = max(float(np.quantile(np.abs(motion), 0.9)), 1.0)
    return np.column_stack([np.ones(len(first)), middle / reach, np.clip(motion / spread, -2.0, 2.0)])


def register(
    first: Floats, second: Floats, temporal_positions: Floats, frames: Sequence[ReceivedPoints]
) -> Floats:
    """Find how far points are from constant velocity in each frame: affine in position and motion."""
    searches = [
        _FrameSearch(first, second, float(t), received)
        for t, received in zip(temporal_positions, frames, strict=True)
    ]
    hypotheses = [[search.refine(start) for start in search.starts()] for search in searches]
    end = _Hypothesis(np.zeros_like(hypotheses[0][0].deviation), 0.0)  # key frames do not deviate
    # The best sequence of one hypothesis for each frame (Viterbi).
    stages = [[end], *hypotheses, [end]]
    total, back = np.zeros(1), []
    for before, after in pairwise(stages):
        change = [[_change(a.deviation, b.deviation) for a in before] for b in after]
        cost = total + np.array(change)
        back.append(cost.argmin(axis=1))
        total = cost.min(axis=1) - np.array([hypothesis.support for hypothesis in after])
    path, index = [], 0
    for stage, origin in zip(stages[::-1], back[::-1], strict=False):
        path.append(stage[index])
        index = int(origin[index])
    path = [end, *path[:0:-1], end]
    for k, search in enumerate(searches, start=1):  # the deviations of its neighbours are tried
        left, right = path[k - 1].deviation, path[k + 1].deviation
        starts = left, right, 0.5 * (left + right)
        tried = [path[k], *(search.refine(start) for start in starts)]
        costs = [_change(left, new.deviation) + _change(new.deviation, right) - new.support for new in tried]
        path[k] = tried[int(np.argmin(costs))]
    return np.stack([hypothesis.deviation for hypothesis in path[1:-1]])


class _Hypothesis(NamedTuple):
    """Deviations of all points in a frame, (N, 2), and how many corners agree, the closer the more."""

    deviation: Floats
    support: float


class _FrameSearch:
    """The search for the deviation of one frame."""

    def __init__(
        self, first: Floats, second: Floats, temporal_position: float, received: ReceivedPoints
    ) -> None:
        self._terms = affine_terms(first, second)
        self._even = (1.0 - temporal_position) * first + temporal_position * second
        self._motion = (second - first) - np.median(second - first, axis=0)
        self._received = received

    def starts(self) -> list[Floats]:
        """Return shifts, and shifts with the frame ahead or behind, that many differences agree with."""
        nothing = np.zeros_like(self._even)
        if not len(self._received):
            return [nothing]
        found, size = [], 2 * RANGE_PX + 1
        spread = float(np.quantile(np.hypot(self._motion[:, 0], self._motion[:, 1]), 0.75))
        num_offsets = int(np.clip(TEMPORAL_OFFSET * spread / OFFSET_STEP_PX, 0, 4))
        for step in range(-num_offsets, num_offsets + 1):
            ahead = TEMPORAL_OFFSET * step / max(num_offsets, 1) * self._motion
            # Differences to received points are counted, blurred: rows are y, columns x.
            offset = np.rint(self._received.points[None] - (self._even + ahead)[:, None])
            offset = offset.astype(np.int64) + RANGE_PX
            near = np.logical_and(offset >= 0, offset < size).all(axis=2)
            cells = offset[near] @ np.array([1, size])
            counts = np.bincount(cells, minlength=size * size).reshape(size, size).astype(np.float64)
            counts = gaussian_filter(counts, BLUR_PX, mode="nearest")
            peaks = np.argwhere((counts == maximum_filter(counts, size=5)) & (counts > 0))
            found += [(-counts[y, x], abs(step), step, y, x, ahead) for y, x in peaks]
        found.sort(key=lambda peak: peak[:5])
        shifts = [
            np.array([x, y]) - float(RANGE_PX) + ahead for _, _, _, y, x, ahead in found[:NUM_CANDIDATES]
        ]
        return [nothing, *shifts]

    def refine(self, start: Floats) -> _Hypothesis:
        """Fit the affine map to matched points, closer and closer."""
        deviation = start
        ridge = np.diag([0.0, *[PRIOR_PX**-2] * (NUM_TERMS - 1)])
        for radius in MATCH_RADII_PX:
            chosen, found, weight = self._match(deviation, radius)
            if len(chosen) < NUM_TERMS + 1:
                break
            terms = self._terms[chosen]
            target = self._received.points[found] - self._even[chosen]
            shift = (weight[:, None] * target).sum(axis=0) / weight.sum()
            normal = np.einsum("n,ni,nj->ij", weight, terms, terms) + ridge
            slope = np.einsum("n,ni,nk->ik", weight, terms, target - shift)
            fitted = np.column_stack([solve_damped(normal, slope[:, axis], 1e-9) for axis in (0, 1)])
            deviation = shift + np.einsum("ni,ik->nk", self._terms, fitted)
        return _Hypothesis(deviation, float(self._match(deviation, MATCH_RADII_PX[-1])[2].sum()))

    def _match(self, deviation: Floats, radius: float) -> tuple[Integers, Integers, Floats]:
        """Match points, and weigh the pairs."""
        chosen, nearest, distance = self._received.match(self._even + deviation, radius)
        return chosen, nearest, 1.0 / (1.0 + (distance / DISTANCE_PX) ** 2)


def _change(before: Floats, after: Floats) -> float:
    """Return the cost of a change of the deviation from a frame to the next."""
    return float(((after - before) ** 2).sum() / (len(before) * JITTER_PX**2))


class Snakes(NamedTuple):
    """Curves between two key frames."""

    positions: Floats  # each curve at the frames between the key frames, in pixels
    received: Floats  # the received point of each, nan without one


def fit_snakes(first: Floats, second: Floats, expected: Floats, frames: Sequence[ReceivedPoints]) -> Snakes:
    """Draw snakes to received points."""
    deviation = np.zeros_like(expected)
    smoothness = _Smoothness(first, second, len(frames))
    for radius in SNAKE_RADII_PX:
        target = _received(expected + deviation, frames, radius)
        seen = np.isfinite(target[..., 0])
        pull = np.where(seen[..., None], target, expected) - expected
        squared = ((pull - deviation) ** 2).sum(axis=2)
        weight = np.where(seen, 1.0 / (1.0 + squared / DISTANCE_PX**2), 0.0)
        deviation = smoothness.solve(weight, weight[..., None] * pull, deviation)
    positions = expected + deviation
    return Snakes(positions, _received(positions, frames, SNAKE_RADII_PX[-1]))


def _received(positions: Floats, frames: Sequence[ReceivedPoints], radius: float) -> Floats:
    found = np.full(positions.shape, np.nan)
    for k, frame in enumerate(frames):
        chosen, nearest, _ = frame.match(positions[:, k], radius)
        found[chosen, k] = frame.points[nearest]
    return found


class _Smoothness:
    """The terms of the normal equations that do not depend on the received points."""

    def __init__(self, first: Floats, second: Floats, num_frames: int) -> None:
        from scipy import sparse

        around = delaunay_neighbours(0.5 * (first + second))
        once = around.point < around.neighbour
        a, b = around.point[once], around.neighbour[once]
        apart = ((first[a] + second[a] - first[b] - second[b]) ** 2).sum(axis=1) / 4.0
        unlike = ((second[a] - first[a] - second[b] + first[b]) ** 2).sum(axis=1)
        weight = 1.0 / ((1.0 + apart / NEAR_PX**2) * (1.0 + unlike / ALIKE_PX**2))
        ends = np.repeat([1.0, -1.0], len(a)), (np.tile(np.arange(len(a)), 2), np.concatenate([a, b]))
        difference = sparse.csr_array(ends, shape=(len(a), len(first)))
        self._coupling = sparse.csr_array(difference.T @ sparse.diags_array(weight) @ difference)
        bent = _bent_twice(np.eye(num_frames)[:, :, None])
        self._diagonal = self._coupling.diagonal()[:, None] + BENDING * np.diag(bent[..., 0])
        self._diagonal += SNAKE_RIDGE

    def _applied(self, deviation: Floats) -> Floats:
        coupled = self._coupling @ deviation.reshape(len(deviation), -1)
        applied: Floats = coupled.reshape(deviation.shape) + SNAKE_RIDGE * deviation
        return applied + BENDING * _bent_twice(deviation)

    def solve(self, weight: Floats, right: Floats, start: Floats) -> Floats:
        """Solve the normal equations with weights (N, T) of the data by conjugate gradients."""
        data, scale = weight[..., None], 1.0 / (weight + self._diagonal)[..., None]
        solution = start
        residual = right - data * solution - self._applied(solution)
        direction = scale * residual
        energy = (residual * direction).sum(axis=(0, 1))
        enough = TOLERANCE_PX**2 * (right.size / 2)
        for _ in range(MAX_ITERATIONS):
            applied = data * direction + self._applied(direction)
            curvature = (direction * applied).sum(axis=(0, 1))
            step = np.where(curvature > 0, energy / np.where(curvature > 0, curvature, 1.0), 0.0)
            solution = solution + step * direction
            residual = residual - step * applied
            scaled = scale * residual
            if float((scaled**2).sum()) <= enough:
                break
            before, energy = energy, (residual * scaled).sum(axis=(0, 1))
            direction = (
                scaled + np.where(before > 0, energy / np.where(before > 0, before, 1.0), 0.0) * direction
            )
        return solution


def _bent_twice(deviation: Floats) -> Floats:
    """Apply the second difference in time (N, T, 2) and its transpose, 0 at both ends."""
    ends = np.zeros_like(deviation[:, :1])
    padded = np.concatenate([ends, deviation, ends], axis=1)
    bent = 2.0 * padded[:, 1:-1] - padded[:, :-2] - padded[:, 2:]
    padded = np.concatenate([ends, bent, ends], axis=1)
    return np.asarray(2.0 * padded[:, 1:-1] - padded[:, :-2] - padded[:, 2:])
