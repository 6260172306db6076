"""Photometric cost of a camera's voxels from its neighbours in the array (2.17 to 2.20), and exposures.

A point that one horizontal neighbour does not see is assumed to be seen by the opposite one: the smaller cost
of both counts (implicit occlusion). Once surfaces exist, costs of voxels that they hide from a neighbour have
no weight (explicit visibility), and undefined costs take those of their region, or a constant.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Floats, Integers, Singles
from dvc.geometry.aggregation import Arms, Window, aggregate, defined_costs, mean_costs, smaller_costs
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels
from dvc.geometry.matching_costs import Band, MatchingCost, WeightedCosts
from dvc.stereo.surfaces.occupancy import Neighbours, Occupancy, fineness, shifts
from dvc.stereo.surfaces.stereo_settings import UNDEFINED_COST, max_jump, tolerance

Volume = Singles
Labels = Integers

UNDEFINED_SHARE = 0.1
"""Share of a region with defined costs below which the constant counts more."""
EXPOSURE_RATIO = 1.02
"""Largest ratio of levels between equal exposures: costs cannot resolve it."""
MIN_POINTS = 500
"""Smallest number of common points for a comparison of exposures."""


@dataclass(frozen=True)
class Comparison:
    """Views and their matching cost."""

    array: CameraArray  # the cameras
    labels: DisparityLabels  # disparities to try
    cost: MatchingCost  # matching cost of two views
    # whether the smaller cost of opposite neighbours counts (2.18), or their mean
    smaller_of_opposite: bool = True
    undefined: float = UNDEFINED_COST  # cost of an undefined voxel, as a share of the highest

    @cached_property
    def fineness(self) -> float:
        """Labels per pixel of parallax between neighbours."""
        return fineness(self.array, self.labels)


@dataclass(frozen=True, eq=False)
class Regions:
    """Regions of aggregation of a camera."""

    arms: Sequence[Arms]  # arms of each window; none for single pixels
    windows: Sequence[Window]  # windows with equal weights
    base: Labels  # labels of the base surface
    band: Band  # labels to try


def photometric_cost(
    comparison: Comparison,
    index: int,
    near: Neighbours,
    regions: Regions,
    occupancy: Sequence[Occupancy] | None,
    rows: slice,
) -> Volume:
    """Compute some rows of the photometric cost volume of a camera (2.20)."""
    join = smaller_costs if comparison.smaller_of_opposite else mean_costs

    def _costs(other: int) -> WeightedCosts:
        return _compared(comparison, (index, other), regions, occupancy, rows)

    total = reduce(mean_costs, (reduce(join, map(_costs, direction)) for direction in near if direction))
    constant = comparison.undefined * comparison.cost.highest
    return defined_costs(total, constant, UNDEFINED_SHARE)


def _compared(
    comparison: Comparison,
    pair: tuple[int, int],
    regions: Regions,
    occupancy: Sequence[Occupancy] | None,
    rows: slice,
) -> WeightedCosts:
    """Return aggregated costs of a neighbour, without the voxels that it does not see."""
    view, other = (comparison.array[index] for index in pair)
    costs = comparison.cost(view, other, comparison.labels, regions.band, rows)
    if occupancy is not None:
        moved = shifts(comparison.labels, view.position, other.position)
        surfaces = *occupancy[pair[0]], *occupancy[pair[1]]
        origin, slack = regions.band.origin, tolerance(comparison.fineness)
        _clear_invisible(*surfaces, moved, origin, slack, rows.start, costs.weight)
    if not regions.windows:
        return costs
    surface = regions.base[rows], regions.band.origin[rows]
    copies = [costs, *(WeightedCosts(*map(np.copy, costs)) for _ in regions.windows[1:])]
    for copy, arms, window in zip(copies, regions.arms, regions.windows, strict=True):
        aggregate(copy, arms[rows], *surface, max_jump(comparison.fineness), window.iterations)
    for copy in copies[1:]:
        costs = mean_costs(costs, copy)
    return costs


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


def add_distance(
    cost: Volume, occupancy: Occupancy, origin: Labels, rows: slice, strength: float, limit: float
) -> None:
    """Add the truncated distance from supported labels to costs: lambda_g G of (2.13) and (2.16)."""
    labels, supported = (plane[rows] for plane in occupancy)
    _add_distance(labels, supported, origin[rows], np.float32(strength), limit, cost)


@kernel
def _add_distance(labels, supported, origin, strength, limit, cost):
    """Add the truncated distance from the label of supported pixels."""
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
    return CameraArray(tuple(_scaled(view, factor) for view, factor in zip(array, factors, strict=True)))


def _scaled(view: ArrayView, factor: Floats) -> ArrayView:
    if (factor == 1.0).all():
        return view
    levels = np.clip(np.floor(view.image * factor + 0.5), 0, 255).astype(np.uint8)
    return ArrayView(view.name, levels, view.position, view.valid)
