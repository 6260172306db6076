"""Matching costs of two rectified views at each disparity, their aggregation over regions, and combination.

The other view is moved as a whole for each label; positions between pixels are interpolated once for each of
a few phases. A cost has no weight if the point lies outside the other view, or in an empty part of it.
Costs are aggregated over cross-shaped regions of one colour; labels are counted from a *base surface*, an
estimate of the disparities, so that a window follows slanted surfaces. Arms end at its jumps.

[Mei2011] "On building an accurate stereo matching system on graphics hardware": ``1 - exp(-x / scale)``;
[ZabihWoodfill1994] "Non-parametric local transforms for computing visual correspondence": census;
[Zhang2009] "Cross-based local stereo matching using orthogonal integral images": arms;
[Scharstein2017] "Semi-global stereo matching with surface orientation priors": labels counted from a surface.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.geometry.camera_array import ArrayView, DisparityLabels, LatticePosition

Volume = Singles
Labels = Integers
Arms = NDArray[np.int16]

CENSUS_RADIUS_PX = 2
DEAD_ZONE = 0.5
"""Levels by which a neighbour must be darker to set its bit: rounding in flat regions sets none."""
PHASES_PER_PX = 16
"""Fractions of a pixel to which positions are rounded."""
CENSUS_SCALE, LEVEL_SCALE = 12.0, 10.0
"""Numbers of differing bits and of levels at which a cost reaches 1 - 1/e of its limit."""
SQUARED_LIMIT = 400.0
"""Truncation of squared differences, tau_2 of (2.18), in squared levels: twice the noise of a good match."""
DARK_LEVEL = 40
"""Level below which a step counts more: noise and contrast fall with the square root of the level."""
BEFORE_Y, AFTER_Y, BEFORE_X, AFTER_X = 0, 1, 2, 3
"""Indices of the arms of a pixel: its numbers of pixels up, down, to the left and to the right."""
_MARGIN_ROWS = CENSUS_RADIUS_PX + 2  # needed above and below by census and interpolation


class Band(NamedTuple):
    """Labels to try at each pixel: all, or a few around an estimate."""

    origin: Integers  # first label; costs are undefined for labels outside the range of all
    num_labels: int  # number of consecutive labels


class WeightedCosts(NamedTuple):
    """Costs of labels and their weights."""

    cost: Volume  # from 0 to `highest`; 0 if undefined
    weight: Volume  # 1 if both views show the point, else 0


@dataclass(frozen=True)
class MatchingCost:
    """Robust distance of census bits and levels [Mei2011], or truncated squared difference (2.18)."""

    kind: str  # "census", "bits" if exposures differ, or "squared" for single pixels

    @property
    def highest(self) -> float:
        """Upper bound of all costs."""
        return 2.0 if self.kind == "census" else 1.0

    def __call__(
        self, view: ArrayView, other: ArrayView, labels: DisparityLabels, band: Band, rows: slice
    ) -> WeightedCosts:
        """Compare some rows of a view with another view."""
        pictures, shifts, needed = phases(other, view.position, labels, rows)
        image, seen, origin = view.image.astype(np.float32), other.seen[needed], band.origin[rows]
        shape, limit = (*origin.shape, band.num_labels), np.float32(0.0)
        costs = WeightedCosts(np.empty(shape, np.float32), np.empty(shape, np.float32))
        bits, other_bits = np.zeros(origin.shape, np.uint32), np.zeros((1, 1, 1), np.uint32)
        if self.kind == "squared":
            limit = np.float32(SQUARED_LIMIT)
        else:
            bits, other_bits = census(image)[rows], np.stack([census(picture) for picture in pictures])
        distances = np.arange((2 * CENSUS_RADIUS_PX + 1) ** 2), np.arange(3 * 256) / 3.0
        scales = CENSUS_SCALE, np.inf if self.kind == "bits" else LEVEL_SCALE
        tables = [(1.0 - np.exp(-distances[k] / scales[k])).astype(np.float32) for k in (0, 1)]
        compared = image[rows], bits, pictures, other_bits, seen
        _compare(*compared, shifts, origin, tables[0], tables[1], limit, *costs)
        return costs


@kernel
def _compare(
    image, bits, pictures, other_bits, seen, shifts, origin, bit_table, level_table, limit, cost, weight
):
    """Compare pixels by census bits and levels; with a limit, by the truncated squared difference (2.18)."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            word, first = bits[y, x], origin[y, x]
            for k in range(cost.shape[2]):
                label = first + k
                cost[y, x, k] = 0.0
                weight[y, x, k] = 0.0
                if label < 0 or label >= shifts.shape[0]:
                    continue
                phase, u, v = shifts[label, 0], x + shifts[label, 1], y + shifts[label, 2]
                if not (0 <= u < seen.shape[1] and 0 <= v < seen.shape[0] and seen[v, u]):
                    continue
                weight[y, x, k] = 1.0
                pixel = pictures[phase, v, u]
                if limit > 0.0:
                    total = (red - pixel[0]) ** 2 + (green - pixel[1]) ** 2 + (blue - pixel[2]) ** 2
                    cost[y, x, k] = min(total / np.float32(3.0), limit) / limit
                    continue
                difference = abs(red - pixel[0]) + abs(green - pixel[1]) + abs(blue - pixel[2])
                different = count_bits(np.uint64(word ^ other_bits[phase, v, u]))
                cost[y, x, k] = bit_table[different] + level_table[int(difference)]


def census(image: Singles) -> NDArray[np.uint32]:
    """Return the census bits of the luma of a picture."""
    grey = image[:, :, 0] * np.float32(0.299) + image[:, :, 1] * np.float32(0.587)
    grey += image[:, :, 2] * np.float32(0.114)
    return census_bits(grey)


def census_bits(grey: Singles) -> NDArray[np.uint32]:
    """Compare each pixel with its neighbours; changes of exposure alter no bit [ZabihWoodfill1994]."""
    bits = np.empty(grey.shape, np.uint32)
    padded = np.pad(grey, CENSUS_RADIUS_PX, mode="edge")
    _census(padded, CENSUS_RADIUS_PX, np.float32(DEAD_ZONE), bits)
    return bits


@kernel
def _census(padded, radius, dead_zone, bits):
    """Set one bit for each neighbour that is clearly darker; `padded` by the radius on all sides."""
    side = 2 * radius + 1
    for y in range(bits.shape[0]):
        for x in range(bits.shape[1]):
            word = np.uint64(0)
            level = padded[y + radius, x + radius] - dead_zone
            for i in range(side):
                for j in range(side):
                    if i != radius or j != radius:
                        word = (word << np.uint64(1)) | np.uint64(padded[y + i, x + j] < level)
            bits[y, x] = word


@kernel
def count_bits(word):
    """Return the number of ones of 64 bits."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


def offsets(labels: DisparityLabels, view: LatticePosition, other: LatticePosition) -> Floats:
    """Return the displacement of points from a view to another, for each label (2.5)."""
    disparity = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
    return np.column_stack([(view.m - other.m) * disparity, (view.n - other.n) * disparity])


def phases(
    other: ArrayView, position: LatticePosition, labels: DisparityLabels, rows: slice
) -> tuple[Singles, Integers, slice]:
    """Interpolate the rows of another view that are compared with some rows of a view at a position.

    Return pictures by fraction of a pixel; index of the picture, columns and rows to it by label; its rows.
    """
    steps = np.floor(offsets(labels, position, other.position) * PHASES_PER_PX + 0.5).astype(np.int64)
    whole, fraction = np.divmod(steps, PHASES_PER_PX)
    distinct, number = np.unique(fraction, axis=0, return_inverse=True)
    height, down = other.shape[0], whole[:, 1]
    start = min(max(rows.start + int(down.min()) - _MARGIN_ROWS, 0), height - 1)
    stop = min(max(rows.stop + int(down.max()) + _MARGIN_ROWS, start + 1), height)
    image = other.image[start:stop].astype(np.float32)
    pictures = np.empty((len(distinct), *image.shape), np.float32)
    for picture, step in zip(pictures, distinct, strict=True):
        picture[:] = _moved(image, *(step / PHASES_PER_PX))
    shifts = np.ascontiguousarray(np.column_stack([number.ravel(), whole[:, 0], down + rows.start - start]))
    return pictures, shifts, slice(start, stop)


def _moved(image: Singles, dx: float, dy: float) -> Singles:
    """Sample at (x + dx, y + dy) by cubic convolution, with a repeated border."""
    if dx == 0.0 and dy == 0.0:
        return image
    for axis, fraction in ((1, dx), (0, dy)):
        if fraction == 0.0:
            continue
        t = fraction  # Keys's kernel with a = -1/2 at positions -1, 0, 1 and 2
        before, at = ((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0
        after, beyond = ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t
        taps = np.array((before, at, after, beyond), np.float32)
        pad = [(0, 0)] * 3
        pad[axis] = (1, 2)
        padded, length = np.pad(image, pad, mode="edge"), image.shape[axis]
        parts = [np.take(padded, range(k, k + length), axis) * taps[k] for k in range(4)]
        image = parts[0] + parts[1] + parts[2] + parts[3]
    return np.asarray(np.clip(image, 0.0, 255.0))


COSTS = {name: MatchingCost(name) for name in ("census", "squared")}
"""Matching costs by the name of the option."""


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
