"""Aggregation of costs over regions of one colour along a base surface, and combination of several views.

A window of one disparity is wrong on slanted surfaces. Here labels of neighbours are counted from a *base
surface*, an estimate of the disparities, so that a window follows it; arms end at its jumps. Costs without
weight take the values of their neighbours.

[Zhang2009] K. Zhang et al., "Cross-based local stereo matching using orthogonal integral images", CSVT 19(7);
[Scharstein2017] "Semi-global stereo matching with surface orientation priors": labels counted from a surface.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Integers, Mask, Singles
from dvc.geometry.matching_costs import WeightedCosts

Labels = Integers
Arms = NDArray[np.int16]

DARK_LEVEL = 40
"""Level below which a step counts more: noise and contrast fall with the square root of the level."""
BEFORE_Y, AFTER_Y, BEFORE_X, AFTER_X = 0, 1, 2, 3
"""Indices of the arms of a pixel: its numbers of pixels up, down, to the left and to the right."""


class Window(NamedTuple):
    """Reach of the windows."""

    reach_px: int  # longest arm, and the longest across colours that differ by more than `far_limit`
    near_reach_px: int
    iterations: int  # number of sums along the arms of rows and columns
    limit: int = 20  # colour differences that end an arm, in levels; smaller ones do below `DARK_LEVEL`
    far_limit: int = 6


def cross_arms(image: Bytes, window: Window) -> Arms:
    """Find the arms of each pixel [Zhang2009]."""
    levels = evened_levels()[image]
    down, right = (np.abs(np.diff(levels, axis=axis)).max(axis=2) < window.limit for axis in (0, 1))
    arms = _even_steps(down, right)
    _shorten_arms(levels, window.reach_px, window.near_reach_px, window.limit, window.far_limit, arms)
    return arms


@kernel
def _even_steps(even_down: Mask, even_right: Mask) -> Arms:
    """Count the even steps from each pixel to the next ones in all four directions."""
    height, width = even_right.shape[0], even_down.shape[1]
    runs = np.empty((height, width, 4), np.int16)
    for y in range(height):
        for x in range(width):
            runs[y, x, BEFORE_Y] = runs[y - 1, x, BEFORE_Y] + 1 if y > 0 and even_down[y - 1, x] else 0
            runs[y, x, BEFORE_X] = runs[y, x - 1, BEFORE_X] + 1 if x > 0 and even_right[y, x - 1] else 0
    for y in range(height - 1, -1, -1):
        for x in range(width - 1, -1, -1):
            below, right = y + 1 < height and even_down[y, x], x + 1 < width and even_right[y, x]
            runs[y, x, AFTER_Y] = runs[y + 1, x, AFTER_Y] + 1 if below else 0
            runs[y, x, AFTER_X] = runs[y, x + 1, AFTER_X] + 1 if right else 0
    return runs


@kernel
def _shorten_arms(image, reach, near_reach, limit, far_limit, arms):
    """Shorten arms to their reach or a change from the colour of their pixel, smaller beyond `near_reach`."""
    for y in range(arms.shape[0]):
        for x in range(arms.shape[1]):
            for side in range(4):
                dy = (-1, 1, 0, 0)[side]
                dx = (0, 0, -1, 1)[side]
                length, most = 0, min(arms[y, x, side], reach - 1)
                while length < most:
                    distance = np.int64(0)
                    i, j = y + dy * (length + 1), x + dx * (length + 1)
                    for channel in range(3):
                        step = abs(np.int64(image[y, x, channel]) - np.int64(image[i, j, channel]))
                        distance = max(distance, step)
                    if distance >= limit or (length >= near_reach and distance >= far_limit):
                        break
                    length += 1
                arms[y, x, side] = length


def evened_levels() -> NDArray[np.int16]:
    """Return a table of levels that makes the noise of their differences even."""
    steps = np.sqrt(np.maximum(DARK_LEVEL / np.arange(1.0, 256.0), 1.0))
    return np.floor(np.concatenate([[0.0], np.cumsum(steps)]) + 0.5).astype(np.int16)


def aggregate(
    costs: WeightedCosts, arms: Arms, base: Labels, origin: Labels, max_jump: int, iterations: int
) -> None:
    """Replace costs by the weighted mean over the cross-shaped regions of pixels."""
    down, right = (np.abs(np.diff(base, axis=axis)) <= max_jump for axis in (0, 1))
    cut = np.minimum(_even_steps(down, right), arms)
    first = base - origin
    cost, weight = costs
    work = np.empty_like(cost)
    for iteration in range(iterations):
        cost *= weight
        support = np.ones((*base.shape, 1), np.float32)
        single = np.empty_like(support)
        flat = np.zeros_like(base)
        sums = (_sum_rows, _sum_columns) if iteration % 2 == 0 else (_sum_columns, _sum_rows)
        for volume, surface, other in ((cost, first, work), (weight, first, work), (support, flat, single)):
            sums[0](volume, surface, cut, other)
            sums[1](other, surface, cut, volume)
        _normalise(cost, weight, support[:, :, 0])


@kernel
def _sum_rows(volume, base, arms, total):
    """Sum along each row."""
    sums = np.empty((volume.shape[1] + 1, volume.shape[2] + base.max() - base.min()), np.float32)
    for y in range(volume.shape[0]):
        _sum_line(volume[y], base[y], arms[y, :, BEFORE_X], arms[y, :, AFTER_X], sums, total[y])


@kernel
def _sum_columns(volume, base, arms, total):
    """Sum along each column."""
    height, width, count = volume.shape
    sums = np.empty((height + 1, count + base.max() - base.min()), np.float32)
    column, summed = np.empty((height, count), np.float32), np.empty((height, count), np.float32)
    for x in range(width):
        for y in range(height):
            for k in range(count):
                column[y, k] = volume[y, x, k]
        _sum_line(column, base[:, x], arms[:, x, BEFORE_Y], arms[:, x, AFTER_Y], sums, summed)
        for y in range(height):
            for k in range(count):
                total[y, x, k] = summed[y, k]


@kernel
def _sum_line(values, base, before, after, sums, total):
    """Sum (n, labels) over the segment of each pixel; labels are counted from a base surface."""
    length, count = values.shape
    lowest, highest = base[0], base[0]
    for n in range(length):
        lowest, highest = min(lowest, base[n]), max(highest, base[n])
    width = count + highest - lowest
    for j in range(width):
        sums[0, j] = 0.0
    for n in range(length):
        start = highest - base[n]
        for j in range(width):
            sums[n + 1, j] = sums[n, j]
        added = sums[n + 1, start : start + count]
        for k in range(count):
            added[k] += values[n, k]
    for n in range(length):
        start = highest - base[n]
        end = sums[n + after[n] + 1, start : start + count]
        first = sums[n - before[n], start : start + count]
        for k in range(count):
            total[n, k] = end[k] - first[k]


@kernel
def _normalise(cost, weight, support):
    """Divide sums by the sum of weights, and that by the number of pixels."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                total = weight[y, x, k]
                cost[y, x, k] = cost[y, x, k] / total if total > 0.0 else np.float32(0.0)
                weight[y, x, k] = min(total / support[y, x], np.float32(1.0))


@kernel
def smaller_costs(first: WeightedCosts, second: WeightedCosts) -> WeightedCosts:
    """Replace costs by the smaller of two views on opposite sides, or the better defined one (2.18)."""
    (cost, weight), (other_cost, other_weight) = first, second
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                mine, theirs = weight[y, x, k], other_weight[y, x, k]
                # half of a window is enough: windows at borders and occlusions
                needed = np.float32(0.5) * max(mine, theirs)
                if mine < needed or (theirs >= needed and other_cost[y, x, k] < cost[y, x, k]):
                    cost[y, x, k] = other_cost[y, x, k]
                    weight[y, x, k] = theirs
    return first


@kernel
def mean_costs(first: WeightedCosts, second: WeightedCosts) -> WeightedCosts:
    """Replace costs by the weighted mean of two (2.20), and weights by the larger one."""
    (cost, weight), (other_cost, other_weight) = first, second
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                mine, theirs = weight[y, x, k], other_weight[y, x, k]
                if theirs > 0.0:
                    total = mine * cost[y, x, k] + theirs * other_cost[y, x, k]
                    cost[y, x, k] = total / (mine + theirs)
                    weight[y, x, k] = max(mine, theirs)
    return first


def defined_costs(costs: WeightedCosts, constant: float, share: float) -> Singles:
    """Mix a constant into costs, as if a share of the support had it; overwrite the weights."""
    cost, weight = costs
    cost *= weight
    cost += np.float32(share) * np.float32(constant)
    weight += np.float32(share)
    cost /= weight
    return cost
