"""Snakes: curves between two key frames that are drawn to the points received for the frames between.

Each correspondence spans a curve over time. Near received points pull at it, the closer the more; curves
bend little in time, and neighbours in the image deviate alike: linear least squares, as in mesh fitting,
solved again as the curves come closer to their points.

References
----------
[Maitre2008] Sec. 5.4.2; equations as (5.10).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from decoder.tracking.registration import ReceivedPoints
from dvc.arrays import Floats
from sfm.correspondences.outliers import delaunay_neighbours


@dataclass(frozen=True)
class SnakeSettings:
    """How snakes are fitted."""

    # distance beyond which points are ignored, from one fit to the next
    radii_px: tuple[float, ...] = (4.0, 3.0, 2.0, 1.5)
    distance_px: float = 1.0  # from here on the weight of a point decreases as the square of its distance
    bending: float = 0.1  # weight of the second difference in time (mu^2)
    # weight of the difference between neighbours that are close in place and motion (mu^2)
    coupling: float = 1.0
    near_px: float = 40.0  # neighbours that are this far apart are coupled half as much
    alike_px: float = 4.0  # largest difference in motion of neighbours that count as alike
    ridge: float = 0.02  # weight that holds snakes which nothing determines


class Snakes(NamedTuple):
    """Curves between two key frames."""

    positions: Floats  # each curve at the frames between the key frames, in pixels
    received: Floats  # the received point of each, nan without one


def fit_snakes(
    first: Floats, second: Floats, expected: Floats, frames: Sequence[ReceivedPoints], settings: SnakeSettings
) -> Snakes:
    """Draw snakes to received points."""
    deviation = np.zeros_like(expected)
    smoothness = _Smoothness(first, second, len(frames), settings)
    for radius in settings.radii_px:
        deviation = _fit_once(expected, deviation, frames, smoothness, radius, settings)
    positions = expected + deviation
    return Snakes(positions, _received(positions, frames, settings.radii_px[-1]))


def _received(positions: Floats, frames: Sequence[ReceivedPoints], radius: float) -> Floats:
    found = np.full(positions.shape, np.nan)
    for k, frame in enumerate(frames):
        chosen, nearest, _ = frame.match(positions[:, k], radius)
        found[chosen, k] = frame.points[nearest]
    return found


def _fit_once(
    expected: Floats,
    deviation: Floats,
    frames: Sequence[ReceivedPoints],
    smoothness: "_Smoothness",
    radius: float,
    settings: SnakeSettings,
) -> Floats:
    """Solve for the deviations of all snakes in all frames."""
    target = _received(expected + deviation, frames, radius)
    seen = np.isfinite(target[..., 0])
    pull = np.where(seen[..., None], target, expected) - expected
    squared = ((pull - deviation) ** 2).sum(axis=2)
    weight = np.where(seen, 1.0 / (1.0 + squared / settings.distance_px**2), 0.0)
    return smoothness.solve(weight, weight[..., None] * pull, deviation)


class _Smoothness:
    """The terms of the normal equations that do not depend on the received points."""

    def __init__(self, first: Floats, second: Floats, num_frames: int, settings: SnakeSettings) -> None:
        from scipy import sparse

        around = delaunay_neighbours(0.5 * (first + second))
        once = around.point < around.neighbour
        a, b = around.point[once], around.neighbour[once]
        apart = ((first[a] + second[a] - first[b] - second[b]) ** 2).sum(axis=1) / 4.0
        unlike = ((second[a] - first[a] - second[b] + first[b]) ** 2).sum(axis=1)
        weight = 1.0 / ((1.0 + apart / settings.near_px**2) * (1.0 + unlike / settings.alike_px**2))
        ends = np.repeat([1.0, -1.0], len(a)), (np.tile(np.arange(len(a)), 2), np.concatenate([a, b]))
        difference = sparse.csr_array(ends, shape=(len(a), len(first)))
        coupled = settings.coupling * (difference.T @ sparse.diags_array(weight) @ difference)
        self._coupling = sparse.csr_array(coupled)
        self._bending, self._ridge = settings.bending, settings.ridge
        bent = _bent_twice(np.eye(num_frames)[:, :, None])
        self._diagonal = self._coupling.diagonal()[:, None] + self._bending * np.diag(bent[..., 0])
        self._diagonal += self._ridge

    def _applied(self, deviation: Floats) -> Floats:
        coupled = self._coupling @ deviation.reshape(len(deviation), -1)
        applied: Floats = coupled.reshape(deviation.shape) + self._ridge * deviation
        return applied + self._bending * _bent_twice(deviation)

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


TOLERANCE_PX = 1e-4
MAX_ITERATIONS = 200


def _bent_twice(deviation: Floats) -> Floats:
    """Apply the second difference in time (N, T, 2) and its transpose, 0 at both ends."""
    ends = np.zeros_like(deviation[:, :1])
    padded = np.concatenate([ends, deviation, ends], axis=1)
    bent = 2.0 * padded[:, 1:-1] - padded[:, :-2] - padded[:, 2:]
    padded = np.concatenate([ends, bent, ends], axis=1)
    return np.asarray(2.0 * padded[:, 1:-1] - padded[:, :-2] - padded[:, 2:])
