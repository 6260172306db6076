"""Photometric cost of a camera's voxels, from its neighbours in the array (2.17 to 2.20).

A point that one horizontal neighbour does not see is assumed to be seen by the opposite one: the smaller cost
of both counts (implicit occlusion). Once there are surfaces, costs of voxels that they hide from a neighbour
count nothing (explicit visibility), and what is undefined then takes the costs of its region, or a constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.geometry.volumes.aggregation import Arms, Window, aggregate
from dvc.geometry.volumes.combination import defined_costs, mean_costs, smaller_costs
from dvc.geometry.volumes.matching_costs import Band, MatchingCost, WeightedCosts
from dvc.stereo.surfaces import _kernels
from dvc.stereo.surfaces.occupancy import Neighbours, Occupancy, fineness, shifts
from dvc.stereo.surfaces.settings import UNDEFINED_COST, max_jump, tolerance

Volume = NDArray[np.float32]
Labels = NDArray[np.int64]

UNDEFINED_SHARE = 0.1
"""Share of a region below which what is known of it counts less than this."""


@dataclass(frozen=True)
class Comparison:
    """How views are compared."""

    array: CameraArray  # the cameras
    labels: DisparityLabels  # disparities to try
    cost: MatchingCost  # of two views
    # whether the smaller cost of opposite neighbours counts (2.18), or their mean
    smaller_of_opposite: bool = True
    # cost of a voxel of which nothing is known, as a share of the highest
    undefined: float = UNDEFINED_COST

    @cached_property
    def fineness(self) -> float:
        """Labels per pixel of parallax between neighbours."""
        return fineness(self.array, self.labels)


@dataclass(frozen=True, eq=False)
class Regions:
    """What costs are summed over."""

    arms: Sequence[Arms]  # arms of each window; none: every pixel by itself
    windows: Sequence[Window]  # the windows; their means count alike
    base: Labels  # labels of the surface that they follow
    band: Band  # labels that are tried


def photometric_cost(
    comparison: Comparison,
    index: int,
    near: Neighbours,
    regions: Regions,
    occupancy: Sequence[Occupancy] | None,
    rows: slice,
) -> Volume:
    """Compute the photometric cost volume of a camera (2.20), some rows of it."""
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
    """Costs of one neighbour, without those that it does not see, over the regions of pixels."""
    view, other = (comparison.array[index] for index in pair)
    costs = comparison.cost(view, other, comparison.labels, regions.band, rows)
    if occupancy is not None:
        moved = shifts(comparison.labels, view.position, other.position)
        own, theirs = (_kernels.Surface(*occupancy[index]) for index in pair)
        origin, slack = regions.band.origin, tolerance(comparison.fineness)
        _kernels.clear_invisible(own, theirs, moved, origin, slack, rows.start, costs.weight)
    if not regions.windows:
        return costs
    surface = regions.base[rows], regions.band.origin[rows]
    copies = [costs, *(WeightedCosts(*map(np.copy, costs)) for _ in regions.windows[1:])]
    for copy, arms, window in zip(copies, regions.arms, regions.windows, strict=True):
        aggregate(copy, arms[rows], *surface, max_jump(comparison.fineness), window.iterations)
    for copy in copies[1:]:
        costs = mean_costs(costs, copy)
    return costs
