"""Occupancy and visibility: which surfaces several cameras agree on, and what these hide (2.14 to 2.17).

A camera's occupancy volume has at most one voxel a column, so it is kept as a map of labels and a mask of
those that are supported. Volumes are sheared (2.14) by looking a point up where the other camera sees it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.volumes.matching_costs import offsets
from dvc.stereo.surfaces import _kernels
from dvc.stereo.surfaces.settings import tolerance

Labels = NDArray[np.int64]
Mask = NDArray[np.bool_]

MIN_REGION_PX = 40
"""Supported regions with fewer pixels are speckles: accidental matches."""


class Occupancy(NamedTuple):
    """Surface of a camera as labels."""

    label: Labels  # of every pixel
    supported: Mask  # where its voxel is occupied: other cameras agree (2.15)


class Neighbours(NamedTuple):
    """Cameras next to one, in the same row and in the same column of the array."""

    horizontal: tuple[int, ...]  # indices of the nearest on each side, if there are any
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
        # off the row or column counts double: parallax should be along it
        distance = abs(dm) + 2.0 * abs(dn) if is_horizontal else abs(dn) + 2.0 * abs(dm)
        nearest[side] = min(nearest.get(side, (distance, other)), (distance, other))
    chosen = [
        tuple(nearest[kind, side][1] for side in (False, True) if (kind, side) in nearest)
        for kind in (True, False)
    ]
    return Neighbours(*chosen)


def fineness(array: CameraArray, labels: DisparityLabels) -> float:
    """Return how many labels there are to a pixel of parallax between neighbours."""
    places = np.array([view.position for view in array])
    apart = np.abs(places[:, None] - places[None]).max(axis=2)
    nearest = np.where(apart > 0.0, apart, np.inf).min(axis=1)
    return max(1.0, 1.0 / max(labels.step * float(np.median(nearest)), 1.0 / MAX_LABELS))


def shifts(labels: DisparityLabels, view: LatticePosition, other: LatticePosition) -> Labels:
    """Return by how many whole pixels each label moves a point from one view to another (2.5)."""
    return np.floor(offsets(labels, view, other) + 0.5).astype(np.int64)


class Agreement(NamedTuple):
    """What another camera says of a camera's surface."""

    agreeing: Mask  # where its label at the same point is the own one, within `tolerance`
    # where it sees anything at that point: this lies inside its view, and that is not empty there
    looking: Mask


def agreement(
    array: CameraArray,
    labels: DisparityLabels,
    maps: Sequence[Labels],
    pair: tuple[int, int],
    slack: int | None = None,
) -> Agreement:
    """Tell where two cameras see one surface, up to some labels; by default up to `tolerance`."""
    own, other = pair
    found = Agreement(np.empty(array.shape, np.bool_), np.empty(array.shape, np.bool_))
    moved = shifts(labels, array[own].position, array[other].position)
    near = tolerance(fineness(array, labels)) if slack is None else slack
    _kernels.agree(maps[own], maps[other], array[other].seen, moved, near, *found)
    return found


def supported(array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int) -> Mask:
    """Keep the voxels of a camera that a horizontal and a vertical neighbour have, too (2.15)."""
    kept, found = array[index].seen, np.zeros(array.shape, np.bool_)
    for agreeing, looking in _by_direction(array, labels, maps, index):
        kept, found = kept & (agreeing | ~looking), found | agreeing
    kept = kept & found
    speckles = np.where(kept, maps[index], -2).astype(np.int16)
    cv2.filterSpeckles(speckles, -2, MIN_REGION_PX, tolerance(fineness(array, labels)))
    large: Mask = speckles != -2
    return kept & large


def exactly_supported(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int
) -> Mask:
    """Do the same to the letter: labels are equal, and voxels outside a view are not occupied."""
    agreeing = [pair.agreeing for pair in _by_direction(array, labels, maps, index, 0)]
    kept: Mask = np.logical_and.reduce([array[index].seen, *agreeing])
    return kept


def _by_direction(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int, slack: int | None = None
) -> list[Agreement]:
    """Return what the horizontal neighbours of a camera say, and the vertical ones, where there are any."""
    found = []
    for direction in filter(None, neighbours(array, index)):
        others = [agreement(array, labels, maps, (index, k), slack) for k in direction]
        found.append(Agreement(*(np.logical_or.reduce(masks) for masks in zip(*others, strict=True))))
    return found


def seen_elsewhere(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int, slack: int | None = None
) -> Mask:
    """Tell which points of a camera's surface any other camera sees; up to `tolerance`, or so many labels."""
    found = np.zeros(array.shape, np.bool_)
    for other in range(len(array)):
        if other != index:
            found |= agreement(array, labels, maps, (index, other), slack).agreeing
    return found
