"""Matching costs of two rectified views: the cost of each disparity at each pixel.

The other view is moved as a whole for each label; positions between pixels are interpolated once for each of
a few phases. A cost has no weight if the point lies outside the other view, or in an empty part of it.

[Mei2011] "On building an accurate stereo matching system on graphics hardware": ``1 - exp(-x / scale)``;
[ZabihWoodfill1994] "Non-parametric local transforms for computing visual correspondence": census.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Floats, Integers, Singles
from dvc.geometry.camera_array import ArrayView, DisparityLabels, LatticePosition

Volume = Singles

CENSUS_RADIUS_PX = 2
DEAD_ZONE = 0.5
"""Levels by which a neighbour must be darker to set its bit: rounding in flat regions sets none."""
PHASES_PER_PX = 16
"""Fractions of a pixel to which positions are rounded."""
CENSUS_SCALE, LEVEL_SCALE = 12.0, 10.0
"""Numbers of differing bits and of levels at which a cost reaches 1 - 1/e of its limit."""
SQUARED_LIMIT = 400.0
"""Truncation of squared differences, tau_2 of (2.18), in squared levels: twice the noise of a good match."""
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
        pixels, others = (image[rows], bits), (pictures, other_bits, seen)
        _compare(*pixels, *others, shifts, origin, tables[0], tables[1], limit, *costs)
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


class Phases(NamedTuple):
    """Some rows of a view, interpolated at a few fractions of a pixel."""

    pictures: Singles
    shifts: Integers  # for each label: index of the picture, columns and rows from the compared rows to it
    rows: slice  # rows of the view in the pictures


def phases(other: ArrayView, position: LatticePosition, labels: DisparityLabels, rows: slice) -> Phases:
    """Interpolate the rows of another view that are compared with some rows of a view at a position."""
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
    return Phases(pictures, shifts, slice(start, stop))


def _moved(image: Singles, dx: float, dy: float) -> Singles:
    """Sample at (x + dx, y + dy) by cubic convolution, with a repeated border."""
    if dx == 0.0 and dy == 0.0:
        return image
    for axis, fraction in ((1, dx), (0, dy)):
        if fraction == 0.0:
            continue
        taps = _cubic_taps(fraction)
        pad = [(0, 0)] * 3
        pad[axis] = (1, 2)
        padded, length = np.pad(image, pad, mode="edge"), image.shape[axis]
        parts = [np.take(padded, range(k, k + length), axis) * taps[k] for k in range(4)]
        image = parts[0] + parts[1] + parts[2] + parts[3]
    moved: Singles = np.clip(image, 0.0, 255.0)
    return moved


def _cubic_taps(fraction: float) -> Singles:
    """Return Keys's kernel with a = -1/2 at positions -1, 0, 1 and 2."""
    t = fraction
    before, at = ((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0
    after, beyond = ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t
    return np.array((before, at, after, beyond), np.float32)


COSTS = {name: MatchingCost(name) for name in ("census", "squared")}
"""Matching costs by the name of the option."""
