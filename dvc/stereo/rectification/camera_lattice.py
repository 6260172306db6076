"""Lattice of the camera centres: its fit, and the positions of cameras on it.

Convention (2.3): the centre of camera (m, n) is ``origin + m v1 + n v2``; v1 leads to the right and v2
downwards in the pictures, and ``v1 x v2`` points to the scene.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from dvc.arrays import Floats
from dvc.errors import ConfigError

LINE_RATIO = 0.05
"""Largest ratio of width and length of centres on a line."""
MAX_TILT_DEG = 45.0
"""Largest angle between the normal of a plane of cameras and their mean axis; beyond, it faces the scene."""
_NEAR_LATTICE = 0.2
_MAX_ASPECT, _MAX_SKEW = 2.0, 0.25
_NUM_CANDIDATES = 8


@dataclass(frozen=True, eq=False)
class Lattice:
    """Lattice of the cameras of an array (2.3)."""

    origin: Floats  # centre of the camera (0, 0), in units of the world
    v1: Floats  # steps to the cameras (1, 0) and (0, 1)
    v2: Floats

    @property
    def spans_a_plane(self) -> bool:
        """Whether both steps have a length, and they are not parallel."""
        lengths = float(np.linalg.norm(self.v1) * np.linalg.norm(self.v2))
        return bool(np.linalg.norm(np.cross(self.v1, self.v2)) > 1e-6 * lengths)

    @property
    def basis(self) -> Floats:
        """``V = (v1 v2 v3)``; v3 is normal to the plane, as long as the square root of a cell's area."""
        normal = np.cross(self.v1, self.v2)
        area = float(np.linalg.norm(normal))
        return np.column_stack([self.v1, self.v2, normal / math.sqrt(area)])

    def coordinates(self, points: Floats) -> Floats:
        """Return ``V^-1 (X - origin)``: m, n and the distance from the plane in units of v3."""
        return np.asarray(np.linalg.solve(self.basis, (points - self.origin).T).T)


def mean_orientation(rotations: Sequence[Floats]) -> Floats:
    """Return the mean orientation of cameras: unit vectors to the right, down and forward, as rows."""
    axes = np.mean(rotations, axis=0)
    lengths = np.linalg.norm(axes, axis=1)
    if lengths.min() < 0.2:
        raise ConfigError("the cameras look in opposite directions: such views cannot be rectified together")
    return np.asarray(axes / lengths[:, None])


def fit_lattice(centres: Floats, positions: Floats, orientation: Floats) -> tuple[Lattice, Floats]:
    """Fit a lattice to centres with known positions (2.6), v1 to the right and ``v1 x v2`` to the scene."""
    right, _, forward = orientation
    mean, middle = positions.mean(axis=0), centres.mean(axis=0)
    shift, offset = positions - mean, centres - middle
    _, extent, directions = np.linalg.svd(shift, full_matrices=True)
    rank = int(np.count_nonzero(extent > 1e-9 * max(1.0, float(extent[0]))))
    if rank == 2:
        v1, v2 = np.linalg.lstsq(shift, offset, rcond=None)[0]
    else:
        (a, b) = directions[0] if rank else (1.0, 0.0)
        along = offset.T @ (shift @ directions[0]) / extent[0] ** 2 if rank else right
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise ConfigError("the cameras are at one point: nothing has parallax")
        normal = forward - (forward @ (along / length)) * (along / length)
        if np.linalg.norm(normal) < 0.05:
            raise ConfigError("the cameras are one behind the other: such views cannot be rectified")
        across = np.cross(normal / np.linalg.norm(normal), along)
        v1, v2 = a * along - b * across, b * along + a * across
    lattice = Lattice(middle - mean[0] * v1 - mean[1] * v2, v1, v2)
    if not lattice.spans_a_plane:
        raise ConfigError("the cameras are on a line or at one point, but their positions (m, n) are not")
    turn = 1.0 if v1 @ right >= 0.0 else -1.0
    signs = np.array([turn, turn if np.cross(v1, v2) @ forward >= 0.0 else -turn])
    return Lattice(lattice.origin, signs[0] * v1, signs[1] * v2), positions * signs + 0.0


def assign_positions(centres: Floats, orientation: Floats) -> tuple[Lattice, Floats]:
    """Find the positions of cameras from their centres."""
    right, _, forward = orientation
    offset = centres - centres.mean(axis=0)
    _, spread, axes = np.linalg.svd(offset, full_matrices=True)
    normal = axes[2] * (1.0 if axes[2] @ forward >= 0.0 else -1.0)
    tilted = normal @ forward < np.cos(np.radians(MAX_TILT_DEG))
    if len(centres) < 3 or spread[1] < LINE_RATIO * spread[0]:
        # (t, 0) or (0, t) of centres on a line that leads rather to the right or downwards
        across, down, _ = orientation @ axes[0]
        in_row = abs(across) >= abs(down)
        distance = offset @ axes[0] * (1.0 if (across if in_row else down) >= 0.0 else -1.0)
        gaps = np.diff(np.sort(distance))
        if not gaps.any():
            raise ConfigError("the cameras are at one point: nothing has parallax")
        steps = [float(np.min(gaps[gaps > 1e-6 * np.ptp(distance)])) / part for part in (1, 2, 3)]
        numbers = next((n for step in steps if (n := _whole_numbers(distance / step)) is not None), None)
        t = distance / float(np.median(gaps[gaps > 0.0])) if numbers is None else numbers
        t = t - t[_middle(distance[:, None] - np.median(distance))]
        positions = np.column_stack([t, 0.0 * t] if in_row else [0.0 * t, t])
    else:
        normal = forward if tilted else normal
        right = right - (right @ normal) * normal
        right /= np.linalg.norm(right)
        points = offset @ np.column_stack([right, np.cross(normal, right)])
        whole = None if tilted else _whole_positions(points)
        if whole is None:
            # square cells, in median distances of neighbours, and real-valued positions
            points = points - points[_middle(points)]
            between = np.linalg.norm(points[:, None] - points[None], axis=2)
            nearest = np.median((between + np.diag(np.full(len(points), np.inf))).min(axis=1))
            if not nearest > 0.0:
                raise ConfigError("cameras are one behind the other: such views cannot be rectified")
            positions = points / nearest
            down = np.cross(normal, right)
            along = right if np.ptp(positions[:, 0]) >= np.ptp(positions[:, 1]) else down
            unit = float(np.ptp(offset @ along) / np.ptp(positions, axis=0).max())
            middle = int(np.argmin(np.abs(positions).sum(axis=1)))
            origin = centres[middle] - (offset[middle] @ normal) * normal
            return Lattice(origin, unit * right, unit * down), positions
        positions = whole
    return fit_lattice(centres, positions, orientation)


def _middle(points: Floats) -> int:
    """Return the index of the point nearest to the origin, the first of several up to rounding."""
    distance = np.linalg.norm(points, axis=1)
    return int(np.argmax(distance <= distance.min() + 1e-6 * distance.max()))


def _whole_numbers(values: Floats) -> Floats | None:
    """Return whole numbers near the values, up to scale and offset; None if impossible."""
    whole: Floats = np.rint(values - values.min())
    scale, offset = np.polyfit(whole, values, 1)
    near = np.abs(values - offset - scale * whole).max() <= _NEAR_LATTICE * abs(scale)
    return whole if near and np.ptp(whole) <= 8 * len(whole) else None


def _whole_positions(points: Floats) -> Floats | None:
    """Return whole coordinates if points of a plane form a nearly rectangular lattice."""
    points = points - points[_middle(points)]
    differences = (points[:, None] - points[None]).reshape(-1, 2)
    differences = differences[np.argsort(np.linalg.norm(differences, axis=1), kind="stable")]
    flat = np.abs(differences[:, 0]) >= np.abs(differences[:, 1])
    rightward = _distinct(differences[flat & (differences[:, 0] > 0)])
    pairs = product(rightward, _distinct(differences[~flat & (differences[:, 1] > 0)]))
    for v1, v2 in sorted(pairs, key=lambda pair: float(np.linalg.norm(pair[0]) + np.linalg.norm(pair[1]))):
        positions = _lattice_positions(points, v1, v2)
        if positions is not None:
            return positions
    return None


def _distinct(vectors: Floats) -> list[Floats]:
    """Return the first clearly distinct ones of vectors sorted by length."""
    distinct: list[Floats] = []
    for vector in vectors:
        if len(distinct) == _NUM_CANDIDATES:
            break
        if all(np.linalg.norm(vector - other) > _NEAR_LATTICE * np.linalg.norm(vector) for other in distinct):
            distinct.append(vector)
    return distinct


def _lattice_positions(points: Floats, v1: Floats, v2: Floats) -> Floats | None:
    lengths = np.linalg.norm(v1), np.linalg.norm(v2)
    if abs(v1 @ v2) > _MAX_SKEW * lengths[0] * lengths[1] or max(lengths) > _MAX_ASPECT * min(lengths):
        return None
    steps = np.stack([v1, v2])
    whole: Floats = np.rint(points @ np.linalg.inv(steps))
    design = np.column_stack([whole, np.ones(len(whole))])
    if np.linalg.matrix_rank(design) < 3 or np.prod(np.ptp(whole, axis=0) + 1) > 8 * len(points):
        return None
    fitted = np.linalg.lstsq(design, points, rcond=None)[0]
    residual = (points - design @ fitted) @ np.linalg.inv(fitted[:2])
    return whole if np.abs(residual).max() <= _NEAR_LATTICE else None
