"""Surfaces on which cameras agree, points that they hide (2.14 to 2.17), and costs of voxels (2.17 to 2.20).

A camera's occupancy volume has at most one voxel a column, so it is stored as a map of labels and a mask of
the supported ones. Volumes are sheared (2.14) by looking a point up at its position in the other camera.

A point that one horizontal neighbour does not see is assumed to be seen by the opposite one: the smaller cost
of both counts (implicit occlusion). Once surfaces exist, costs of voxels that they hide from a neighbour have
no weight (explicit visibility), and undefined costs take those of their region, or a constant.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import cv2
import numpy as np

from dvc._jit import kernel
from dvc.array_files import MAX_LABELS
from dvc.arrays import Floats, Integers, Mask, Singles
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.matching_costs import (
    Arms,
    Band,
    MatchingCost,
    WeightedCosts,
    Window,
    aggregate,
    defined_costs,
    mean_costs,
    offsets,
    smaller_costs,
)
from dvc.stereo.surfaces.stereo_settings import UNDEFINED_COST, max_jump, tolerance

Labels = Integers

UNDEFINED_SHARE = 0.1
"""Share of a region with defined costs below which the constant counts more."""
EXPOSURE_RATIO = 1.02
"""Largest ratio of levels between equal exposures: costs cannot resolve it."""
MIN_POINTS = 500
"""Smallest number of common points for a comparison of exposures."""
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


def supported(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int, *, exact: bool = False
) -> Mask:
    """Return the voxels of a camera that a horizontal and a vertical neighbour share (2.15).

    By default labels are nearly equal, one neighbour must see the voxel, and supported regions are large.
    By the letter, if `exact`, labels are equal, and voxels outside a view are empty.
    """
    mask, confirmed = array[index].seen, np.zeros(array.shape, np.bool_)
    for direction in filter(None, neighbours(array, index)):
        pairs = [agreement(array, labels, maps, (index, k), 0 if exact else None) for k in direction]
        agreeing, looking = (np.logical_or.reduce(masks) for masks in zip(*pairs, strict=True))
        mask, confirmed = mask & (agreeing if exact else agreeing | ~looking), confirmed | agreeing
    if exact:
        return mask
    mask = mask & confirmed
    speckles = np.where(mask, maps[index], -2).astype(np.int16)
    cv2.filterSpeckles(speckles, -2, MIN_REGION_PX, tolerance(fineness(array, labels)))
    return np.asarray(mask & (speckles != -2))


def seen_elsewhere(
    array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int, slack: int | None = None
) -> Mask:
    """Return the mask of points of a surface that any other camera sees, up to `slack` or `tolerance`."""
    visible = np.zeros(array.shape, np.bool_)
    for other in range(len(array)):
        if other != index:
            visible |= agreement(array, labels, maps, (index, other), slack).agreeing
    return visible


@dataclass(frozen=True)
class Comparison:
    """Views and their matching cost."""

    array: CameraArray  # the cameras
    labels: DisparityLabels  # disparities to try
    cost: MatchingCost  # matching cost of two views
    # whether the smaller cost of opposite neighbours counts (2.18), or their mean
    smaller_of_opposite: bool = True
    undefined: float = UNDEFINED_COST  # cost of an undefined voxel, as a share of the highest


def photometric_cost(
    comparison: Comparison,
    index: int,
    near: Neighbours,
    arms: Sequence[Arms],  # arms of each window; none for single pixels
    windows: Sequence[Window],  # windows of aggregation, with equal weights
    base: Labels,  # labels of the base surface
    band: Band,  # labels to try
    occupancy: Sequence[Occupancy] | None,
    rows: slice,
) -> Singles:
    """Compute some rows of the photometric cost volume of a camera (2.20)."""
    array, labels = comparison.array, comparison.labels
    fine = fineness(array, labels)

    def _costs(other: int) -> WeightedCosts:
        """Return aggregated costs of a neighbour, without the voxels that it does not see."""
        costs = comparison.cost(array[index], array[other], labels, band, rows)
        if occupancy is not None:
            moved = shifts(labels, array[index].position, array[other].position)
            surfaces = *occupancy[index], *occupancy[other]
            _clear_invisible(*surfaces, moved, band.origin, tolerance(fine), rows.start, costs.weight)
        if not windows:
            return costs
        surface = base[rows], band.origin[rows]
        copies = [costs, *(WeightedCosts(*map(np.copy, costs)) for _ in windows[1:])]
        for copy, reach, window in zip(copies, arms, windows, strict=True):
            aggregate(copy, reach[rows], *surface, max_jump(fine), window.iterations)
        return reduce(mean_costs, copies)

    join = smaller_costs if comparison.smaller_of_opposite else mean_costs
    total = reduce(mean_costs, (reduce(join, map(_costs, direction)) for direction in near if direction))
    return defined_costs(total, comparison.undefined * comparison.cost.highest, UNDEFINED_SHARE)


@kernel
def _clear_invisible(labels, supported, other_labels, other_supported, shifts, origin, slack, top, weight):
    """Clear the weight of voxels that a camera sees, but that are hidden in another one (2.17, 2.19)."""
    height, width = labels.shape
    for i in range(weight.shape[0]):
        y = top + i
        for x in range(width):
            first = labels[y, x] - slack if supported[y, x] else 0
            for k in range(weight.shape[2]):
                label = origin[y, x] + k
                if label < max(first, 0) or label >= shifts.shape[0]:
                    continue
                u, v = x + shifts[label, 0], y + shifts[label, 1]
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                if other_supported[v, u] and other_labels[v, u] > label + slack:
                    weight[i, x, k] = 0.0


@kernel
def add_distance(labels, supported, origin, strength, limit, cost):
    """Add the truncated distance from supported labels to costs: lambda_g G of (2.13) and (2.16)."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            if supported[y, x]:
                for k in range(cost.shape[2]):
                    distance = abs(origin[y, x] + k - labels[y, x])
                    cost[y, x, k] += strength * np.float32(min(distance, limit))


def gains(array: CameraArray, labels: DisparityLabels, surface: Occupancy) -> Floats:
    """Return the factors (views, 3) from levels of all views to the reference: median ratios by channel."""
    reference, factors = array[array.reference], np.ones((len(array), 3))
    y, x = np.nonzero(surface.supported & reference.seen)
    label = surface.label[y, x]
    for index, view in enumerate(array):
        moved = shifts(labels, reference.position, view.position)[label]
        u, v = x + moved[:, 0], y + moved[:, 1]
        inside = (u >= 0) & (v >= 0) & (u < view.shape[1]) & (v < view.shape[0])
        inside[inside] = view.seen[v[inside], u[inside]]
        if index != array.reference and np.count_nonzero(inside) >= MIN_POINTS:
            levels = reference.image[y[inside], x[inside]], view.image[v[inside], u[inside]]
            factors[index] = np.median((levels[0] + 1.0) / (levels[1] + 1.0), axis=0)
    return factors


def with_gains(array: CameraArray, factors: Floats) -> CameraArray:
    """Multiply the levels of views."""
    views = []
    for view, factor in zip(array, factors, strict=True):
        levels = np.clip(np.floor(view.image * factor + 0.5), 0, 255).astype(np.uint8)
        views.append(view if (factor == 1.0).all() else replace(view, image=levels))
    return CameraArray(tuple(views))
