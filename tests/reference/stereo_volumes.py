"""Volumes of voxels (rows, columns, disparities) as equations (2.14) to (2.20) have them; slow.

The disparity of a voxel is its index. The code keeps maps of labels instead.
"""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)
Floats = NDArray[np.float64]
Volume = NDArray[np.bool_]


def occupancy(label: NDArray[np.int64], supported: NDArray[np.bool_], num_labels: int) -> Volume:
    """Return the voxels of a surface: at most one a column."""
    return (np.arange(num_labels) == label[:, :, None]) & supported[:, :, None]


def sheared(volume: NDArray[Scalar], m: int, n: int, outside: Any) -> NDArray[Scalar]:
    """Take a volume of camera (0, 0) to the frame of camera (m, n), (2.14)."""
    height, width, count = volume.shape[:3]
    found = np.full_like(volume, outside)
    for y, x, d in np.ndindex(height, width, count):
        v, u = y + n * d, x + m * d
        if 0 <= v < height and 0 <= u < width:
            found[y, x, d] = volume[v, u, d]
    return found


def thickened(volume: Volume, reach: int) -> Volume:
    """Occupy what lies within some labels of an occupied voxel."""
    count = volume.shape[2]
    padded = np.pad(volume, ((0, 0), (0, 0), (reach, reach)))
    return np.logical_or.reduce([padded[:, :, k : k + count] for k in range(2 * reach + 1)])


def with_support(own: Volume, horizontal: list[Volume], vertical: list[Volume]) -> Volume:
    """Keep voxels that a horizontal and a vertical neighbour have, in one frame, (2.15)."""
    kept = own.copy()
    for direction in (horizontal, vertical):
        if direction:
            kept &= np.logical_or.reduce(direction)
    return kept


def with_support_in_frames(
    own: Volume, horizontal: list[tuple[Volume, Volume]], vertical: list[tuple[Volume, Volume]]
) -> Volume:
    """Do so where a neighbour looks: a direction whose frames all end before a voxel asks for nothing."""
    kept, found = own.copy(), np.zeros_like(own)
    for direction in filter(None, (horizontal, vertical)):
        occupied, inside = (np.logical_or.reduce(volumes) for volumes in zip(*direction, strict=True))
        kept, found = kept & (occupied | ~inside), found | occupied
    return kept & found


def geometric_cost(volume: Volume, limit: float) -> Floats:
    """Return the truncated distance to the nearest occupied voxel of a column, (2.16)."""
    cost = np.zeros(volume.shape)
    for y, x in np.argwhere(volume.any(axis=2)):
        for d in range(volume.shape[2]):
            cost[y, x, d] = min(min(abs(d - k), limit) for k in np.flatnonzero(volume[y, x]))
    return cost


def visibility(volume: Volume, slack: int = 0) -> Volume:
    """Return which voxels have nothing nearer in their column than `slack` labels before them, (2.17)."""
    seen = np.ones_like(volume)
    for d in range(volume.shape[2] - 2 - slack, -1, -1):
        seen[:, :, d] = seen[:, :, d + 1] & ~volume[:, :, d + 1 + slack]
    return seen


def truncated_error(own: Floats, neighbours: list[Floats], limit: float) -> Floats:
    """Return the smallest squared difference, or the limit (2.18); NaN where a neighbour has no voxel."""
    error = np.full(neighbours[0].shape[:3], limit)
    for other in neighbours:
        squared = ((own[:, :, None] - other) ** 2).mean(axis=3)
        error = np.fmin(error, squared)
    return error


def validity(own: Volume, neighbours: list[Volume]) -> Volume:
    """Tell where what is visible to the own camera is so to one of the neighbours, (2.19)."""
    return np.logical_or.reduce([~own, *neighbours])


def photometric_cost(errors: list[Floats], valid: list[Volume]) -> Floats:
    """Return the mean of the valid errors of both directions (2.20); NaN where none is."""
    total = sum(np.where(known, error, 0.0) for error, known in zip(errors, valid, strict=True))
    count = sum(known.astype(np.float64) for known in valid)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def banded(
    volume: NDArray[Scalar], origin: NDArray[np.int64], num_labels: int, outside: Any
) -> NDArray[Scalar]:
    """Return of each column the labels from an origin on."""
    found = np.full((*origin.shape, num_labels), outside, volume.dtype)
    for y, x, k in np.ndindex(found.shape):
        if 0 <= origin[y, x] + k < volume.shape[2]:
            found[y, x, k] = volume[y, x, origin[y, x] + k]
    return found


def fused(index: int, maps: Floats, seen: Volume, shifts: Any, tolerance: float) -> Floats:
    """Return the labels of a camera that those of the others confirm, camera by camera and pixel by pixel."""
    found = maps[index].copy()
    others = [k for k in range(len(maps)) if k != index]

    def _labels(y: int, x: int, label: int) -> list[float]:
        places = [(k, y + shifts[k, label, 1], x + shifts[k, label, 0]) for k in others]
        inside = [p for p in places if 0 <= p[1] < maps.shape[1] and 0 <= p[2] < maps.shape[2]]
        return [float(maps[place]) for place in inside if seen[place]]

    for y, x in np.ndindex(found.shape):
        own, label = float(maps[index, y, x]), round(float(maps[index, y, x]))
        looking = _labels(y, x, label)
        agreeing = sorted([own, *(value for value in looking if abs(value - own) <= tolerance)])
        beyond = [value for value in looking if value < own - tolerance]
        if len(beyond) <= len(agreeing):
            middle = agreeing[(len(agreeing) - 1) // 2], agreeing[len(agreeing) // 2]
            found[y, x] = np.clip(own, *middle)
            continue
        behind = range(label - int(tolerance) - 1, -1, -1)
        votes = {other: sum(abs(v - other) <= 1.0 for v in _labels(y, x, other)) for other in behind}
        most = max(votes.values(), default=0)
        if most > len(agreeing):
            found[y, x] = max(other for other, count in votes.items() if count == most)
    return found
