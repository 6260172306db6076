"""Occupancy and visibility: surfaces on which cameras agree, and points that they hide (2.14 to 2.17).

A camera's occupancy volume has at most one voxel a column, so it is stored as a map of labels and a mask of
the supported ones. Volumes are sheared (2.14) by looking a point up at its position in the other camera.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from dvc._jit import kernel
from dvc.array_files import MAX_LABELS
from dvc.arrays import Integers, Mask
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.matching_costs import offsets
from dvc.stereo.surfaces.stereo_settings import tolerance

Labels = Integers

MIN_REGION_PX = 40
"""Smallest supported region; smaller ones are speckles, accidental matches."""


class Occupancy(NamedTuple):
    """Surface of a camera as labels."""

    label: Labels  # of every pixel
    supported: Mask  # mask of occupied voxels, on which other cameras agree (2.15)


class Neighbours(NamedTuple):
    """Cameras next to a camera in its row and in its column of the array."""

    horizontal: tuple[int, ...]  # indices of the nearest cameras on each side, if any
    vertical: tuple[int, ...]

    @property
    def all(self) -> tuple[int, ...]:
        """Both kinds."""
        return self.horizontal + self.vertical


def neighbours(array: CameraArray, index: int) -> Neighbours:
    """Find the neighbours of a camera."""
    here = array[index].position
    nearest: dict[tuple[bool, bool], tuple[float, int]] = {}
    for other, view in enumerate(array):
        dm, dn = view.position.m - here.m, view.position.n - here.n
        if other == index:
            continue
        is_horizontal = abs(dm) >= abs(dn)
        side = is_horizontal, (dm if is_horizontal else dn) > 0
        # distance from the row or column counts double: parallax should be along it
        distance = abs(dm) + 2.0 * abs(dn) if is_horizontal else abs(dn) + 2.0 * abs(dm)
        nearest[side] = min(nearest.get(side, (distance, other)), (distance, other))
    chosen = [
        tuple(nearest[kind, side][1] for side in (False, True) if (kind, side) in nearest)
        for kind in (True, False)
    ]
    return Neighbours(*chosen)


def fineness(array: CameraArray, labels: DisparityLabels) -> float:
    """Return the number of labels per pixel of parallax between neighbours."""
    positions = np.array([view.position for view in array])
    apart = np.abs(positions[:, None] - positions[None]).max(axis=2)
    nearest = np.where(apart > 0.0, apart, np.inf).min(axis=1)
    return max(1.0, 1.0 / max(labels.step * float(np.median(nearest)), 1.0 / MAX_LABELS))


def shifts(labels: DisparityLabels, view: LatticePosition, other: LatticePosition) -> Labels:
    """Return the displacement of a point between two views for each label, in whole pixels (2.5)."""
    return np.floor(offsets(labels, view, other) + 0.5).astype(np.int64)


class Agreement(NamedTuple):
    """Agreement of another camera with a camera's surface."""

    agreeing: Mask  # pixels with the same label at the same point, within `tolerance`
    looking: Mask  # pixels with points inside the other view, which has content there


def agreement(
    array: CameraArray,
    labels: DisparityLabels,
    maps: Sequence[Labels],
    pair: tuple[int, int],
    slack: int | None = None,
) -> Agreement:
    """Find pixels of a camera on one surface with another; labels differ by `slack`, else `tolerance`."""
    index, other = pair
    agreed = Agreement(np.empty(array.shape, np.bool_), np.empty(array.shape, np.bool_))
    moved = shifts(labels, array[index].position, array[other].position)
    near = tolerance(fineness(array, labels)) if slack is None else slack
    _agree(maps[index], maps[other], array[other].seen, moved, near, *agreed)
    return agreed


@kernel
def _agree(labels, other, other_seen, shifts, tolerance, agreeing, looking):
    """Compare labels with those of another camera at the same points (2.15)."""
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            k = labels[y, x]
            u, v = x + shifts[k, 0], y + shifts[k, 1]
            looking[y, x] = 0 <= u < width and 0 <= v < height and other_seen[v, u]
            agreeing[y, x] = looking[y, x] and abs(other[v, u] - k) <= tolerance


def supported(array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int) -> Mask:
    """Return the voxels of a camera that a horizontal and a vertical neighbour share (2.15)."""
    mask, confirmed = array[index].seen, np.zeros(array.shape, np.bool_)
    for agreeing, looking in _by_direction(array, labels, maps, index):
        mask, confirmed = mask & (agreeing | ~looking), confirmed | agreeing
    mask = mask & confirmed
    speckles = np.where(mask, maps[index], -2).astype(np.int16)
    cv2.filterSpeckles(speckles, -2, MIN_REGION_PX, tolerance(fineness(array, labels)))
    large: Mask = speckles != -2
    return mask & large


def exactly_supported(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int
) -> Mask:
    """Return the same by the letter of (2.15): labels are equal, and voxels outside a view are empty."""
    agreeing = [pair.agreeing for pair in _by_direction(array, labels, maps, index, 0)]
    mask: Mask = np.logical_and.reduce([array[index].seen, *agreeing])
    return mask


def _by_direction(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int, slack: int | None = None
) -> list[Agreement]:
    """Return the agreement of the horizontal and of the vertical neighbours of a camera, if any."""
    directions = []
    for direction in filter(None, neighbours(array, index)):
        neighbouring = [agreement(array, labels, maps, (index, k), slack) for k in direction]
        merged = (np.logical_or.reduce(masks) for masks in zip(*neighbouring, strict=True))
        directions.append(Agreement(*merged))
    return directions


def seen_elsewhere(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int, slack: int | None = None
) -> Mask:
    """Return the mask of points of a surface that any other camera sees, up to `slack` or `tolerance`."""
    visible = np.zeros(array.shape, np.bool_)
    for other in range(len(array)):
        if other != index:
            visible |= agreement(array, labels, maps, (index, other), slack).agreeing
    return visible
