"""Aggregation of costs over the pixels around that are of one colour, along a base surface.

A window with one disparity is wrong on slanted surfaces. Here labels of neighbours are counted from a *base
surface*, an estimate of the disparities, so that a window follows it; and arms end where it jumps. Costs
without weight take what their neighbours say.

References
----------
[Zhang2009] K. Zhang, J. Lu, G. Lafruit, "Cross-based local stereo matching using orthogonal integral images",
IEEE Trans. Circuits Syst. Video Technol. 19(7), 2009.
[Scharstein2017] D. Scharstein, T. Taniai, S. Sinha, "Semi-global stereo matching with surface orientation
priors", 3DV, 2017: labels counted from a surface.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.volumes import _kernels
from dvc.geometry.volumes.matching_costs import WeightedCosts

Labels = NDArray[np.int64]
Arms = NDArray[np.int16]


DARK_LEVEL = 40
"""Below it a step counts more: noise falls with the square root of the level, and so does contrast."""


class Window(NamedTuple):
    """How far the windows reach."""

    reach_px: int  # longest arm, and the longest across colours that differ by more than `far_limit`
    near_reach_px: int
    iterations: int  # times that costs are summed along the arms of rows and columns
    limit: int = 20  # colour differences that end an arm, in levels; smaller ones do below `DARK_LEVEL`
    far_limit: int = 6


def cross_arms(image: NDArray[np.uint8], window: Window) -> Arms:
    """Find the arms of each pixel [Zhang2009]."""
    arms = np.empty((*image.shape[:2], 4), np.int16)
    limits = window.reach_px, window.near_reach_px, window.limit, window.far_limit
    _kernels.grow_arms(evened_levels()[image], *limits, arms)
    return arms


def evened_levels() -> NDArray[np.int16]:
    """Return levels in whose differences noise is alike."""
    steps = np.sqrt(np.maximum(DARK_LEVEL / np.arange(1.0, 256.0), 1.0))
    return np.floor(np.concatenate([[0.0], np.cumsum(steps)]) + 0.5).astype(np.int16)


def aggregate(
    costs: WeightedCosts, arms: Arms, base: Labels, origin: Labels, max_jump: int, iterations: int
) -> None:
    """Replace costs by the weighted mean over the cross-shaped regions of pixels."""
    cut = np.empty_like(arms)
    _kernels.cut_arms(arms, base, max_jump, cut)
    first = base - origin
    cost, weight = costs
    work = np.empty_like(cost)
    for iteration in range(iterations):
        _kernels.apply_weights(cost, weight)
        support = np.ones((*base.shape, 1), np.float32)
        single = np.empty_like(support)
        flat = np.zeros_like(base)
        for volume, surface, other in ((cost, first, work), (weight, first, work), (support, flat, single)):
            if iteration % 2 == 0:
                _kernels.sum_rows(volume, surface, cut, other)
                _kernels.sum_columns(other, surface, cut, volume)
            else:
                _kernels.sum_columns(volume, surface, cut, other)
                _kernels.sum_rows(other, surface, cut, volume)
        _kernels.normalise(cost, weight, support[:, :, 0])
