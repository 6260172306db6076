"""The lattice of the camera centres: its fit, and the places of cameras on it.

Convention (2.3): the camera (m, n) stands at ``origin + m v1 + n v2``; v1 leads to the right and v2
downwards in the pictures, and ``v1 x v2`` points to the scene.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError
from dvc.geometry.camera_array import LatticePosition

Floats = NDArray[np.float64]

LINE_RATIO = 0.05
"""A set of centres that is narrower than this part of its length is a line."""
MAX_TILT_DEG = 45.0
"""Between the normal of a plane of cameras and their mean axis; beyond, a plane facing the scene is taken."""
_NEAR_LATTICE = 0.2
_MAX_ASPECT, _MAX_SKEW = 2.0, 0.25
_NUM_CANDIDATES = 8


@dataclass(frozen=True, eq=False)
class Orientation:
    """How the cameras look, on the mean: unit vectors in the world."""

    right: Floats  # along rows and columns of the pictures, and the optical axis
    down: Floats
    forward: Floats


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where the cameras of an array stand (2.3)."""

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


def fit_lattice(centres: Floats, positions: Floats, orientation: Orientation) -> Lattice:
    """Fit a lattice to centres whose places are known, by least squares (2.6)."""
    place, middle = positions.mean(axis=0), centres.mean(axis=0)
    shift, offset = positions - place, centres - middle
    _, extent, directions = np.linalg.svd(shift, full_matrices=True)
    rank = int(np.count_nonzero(extent > 1e-9 * max(1.0, float(extent[0]))))
    if rank == 2:
        steps: Floats = np.linalg.lstsq(shift, offset, rcond=None)[0]
        v1, v2 = steps
    else:
        (a, b) = directions[0] if rank else (1.0, 0.0)
        along = offset.T @ (shift @ directions[0]) / extent[0] ** 2 if rank else orientation.right
        across = _across(along, orientation.forward)
        v1, v2 = a * along - b * across, b * along + a * across
    lattice = Lattice(middle - place[0] * v1 - place[1] * v2, v1, v2)
    if not lattice.spans_a_plane:
        raise ConfigError("the cameras stand on a line or at one place, but their positions (m, n) do not")
    return lattice


def _across(along: Floats, forward: Floats) -> Floats:
    """Return the vector perpendicular to a row of cameras in their plane, ``n x v1`` of (2.6)."""
    length = float(np.linalg.norm(along))
    if not length > 0.0:
        raise ConfigError("the cameras stand at one place: nothing has parallax")
    unit = along / length
    normal = forward - (forward @ unit) * unit
    if np.linalg.norm(normal) < 0.05:
        raise ConfigError("the cameras stand one behind the other: such views cannot be rectified")
    across: Floats = np.cross(normal / np.linalg.norm(normal), along)
    return across


def upright(lattice: Lattice, positions: Floats, orientation: Orientation) -> tuple[Lattice, Floats]:
    """Turn a lattice so that ``v1 x v2`` points to the scene and v1 to the right."""
    faces = float(np.cross(lattice.v1, lattice.v2) @ orientation.forward) >= 0.0
    n_sign = 1 if faces else -1
    turn = 1 if lattice.v1 @ orientation.right >= 0.0 else -1
    signs = turn, turn * n_sign
    turned = Lattice(lattice.origin, signs[0] * lattice.v1, signs[1] * lattice.v2)
    return turned, positions * np.array(signs, dtype=np.float64) + 0.0


def assign_positions(centres: Floats, orientation: Orientation) -> tuple[Lattice, Floats]:
    """Find the places of cameras that are given none."""
    offset = centres - centres.mean(axis=0)
    _, spread, axes = np.linalg.svd(offset, full_matrices=True)
    normal = axes[2] * (1.0 if axes[2] @ orientation.forward >= 0.0 else -1.0)
    tilted = normal @ orientation.forward < np.cos(np.radians(MAX_TILT_DEG))
    if len(centres) < 3 or spread[1] < LINE_RATIO * spread[0]:
        places = _places_on_line(offset, axes[0], orientation)
    else:
        normal = orientation.forward if tilted else normal
        right = orientation.right - (orientation.right @ normal) * normal
        right /= np.linalg.norm(right)
        points = offset @ np.column_stack([right, np.cross(normal, right)])
        found = None if tilted else _whole_places(points)
        if found is None:
            return _square_lattice(centres, _neighbour_units(points), right, normal)
        places = found
    lattice = fit_lattice(centres, places, orientation)
    return upright(lattice, places, orientation)


def snapped(lattice: Lattice, centres: Floats, positions: Floats, tolerance: float) -> Floats:
    """Return where cameras really stand: their places if they are there, else real-valued ones."""
    found = lattice.coordinates(centres)[:, :2]
    return positions if np.abs(found - positions).max() <= tolerance else found


def as_positions(places: Floats) -> tuple[LatticePosition, ...]:
    """Return places as positions."""
    return tuple(LatticePosition(float(m), float(n)) for m, n in places)


def _places_on_line(offset: Floats, direction: Floats, orientation: Orientation) -> Floats:
    """Return (t, 0) or (0, t) of centres on a line, as it leads rather to the right or rather downwards."""
    across, down = float(direction @ orientation.right), float(direction @ orientation.down)
    in_row = abs(across) >= abs(down)
    distance = offset @ direction * (1.0 if (across if in_row else down) >= 0.0 else -1.0)
    gaps = np.diff(np.sort(distance))
    if not gaps.any():
        raise ConfigError("the cameras stand at one place: nothing has parallax")
    steps = [float(np.min(gaps[gaps > 1e-6 * np.ptp(distance)])) / part for part in (1, 2, 3)]
    whole = next((found for step in steps if (found := _whole_numbers(distance / step)) is not None), None)
    place = distance / float(np.median(gaps[gaps > 0.0])) if whole is None else whole
    place = place - place[_middle(distance[:, None] - np.median(distance))]
    return np.column_stack([place, 0.0 * place] if in_row else [0.0 * place, place])


def _middle(points: Floats) -> int:
    """Return the index of the point nearest to the origin, the first of several but for rounding."""
    distance = np.linalg.norm(points, axis=1)
    return int(np.argmax(distance <= distance.min() + 1e-6 * distance.max()))


def _whole_numbers(place: Floats) -> Floats | None:
    """Return whole numbers that are, up to scale and offset, near `place`; None if there are none."""
    whole: Floats = np.rint(place - place.min())
    scale, offset = np.polyfit(whole, place, 1)
    near = np.abs(place - offset - scale * whole).max() <= _NEAR_LATTICE * abs(scale)
    return whole if near and np.ptp(whole) <= 8 * len(whole) else None


def _whole_places(points: Floats) -> Floats | None:
    """Return whole numbers if points of a plane form a nearly rectangular lattice."""
    points = points - points[_middle(points)]
    differences = (points[:, None] - points[None]).reshape(-1, 2)
    order = np.argsort(np.linalg.norm(differences, axis=1), kind="stable")
    differences = differences[order]
    flat = np.abs(differences[:, 0]) >= np.abs(differences[:, 1])
    rightward, downward = (
        differences[flat & (differences[:, 0] > 0)],
        differences[~flat & (differences[:, 1] > 0)],
    )
    pairs = product(_distinct(rightward), _distinct(downward))
    for v1, v2 in sorted(pairs, key=lambda pair: float(np.linalg.norm(pair[0]) + np.linalg.norm(pair[1]))):
        places = _lattice_places(points, v1, v2)
        if places is not None:
            return places
    return None


def _neighbour_units(points: Floats) -> Floats:
    """Return points of a plane about the middle one, in median distances of nearest neighbours."""
    points = points - points[_middle(points)]
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.diag(np.full(len(points), np.inf))
    nearest = np.median(apart.min(axis=1))
    if not nearest > 0.0:
        raise ConfigError("cameras stand one behind the other: such views cannot be rectified")
    return np.asarray(points / nearest)


def _distinct(vectors: Floats) -> list[Floats]:
    """Return the first of vectors that are sorted by length, no two nearly the same."""
    kept: list[Floats] = []
    for vector in vectors:
        if len(kept) == _NUM_CANDIDATES:
            break
        if all(np.linalg.norm(vector - other) > _NEAR_LATTICE * np.linalg.norm(vector) for other in kept):
            kept.append(vector)
    return kept


def _lattice_places(points: Floats, v1: Floats, v2: Floats) -> Floats | None:
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


def _square_lattice(centres: Floats, places: Floats, right: Floats, normal: Floats) -> tuple[Lattice, Floats]:
    """Return the lattice of square cells in which centres have real-valued places."""
    offset = centres - centres.mean(axis=0)
    along = right if np.ptp(places[:, 0]) >= np.ptp(places[:, 1]) else np.cross(normal, right)
    unit = float(np.ptp(offset @ along) / np.ptp(places, axis=0).max())
    middle = int(np.argmin(np.abs(places).sum(axis=1)))
    origin = centres[middle] - (offset[middle] @ normal) * normal
    return Lattice(origin, unit * right, unit * np.cross(normal, right)), places
