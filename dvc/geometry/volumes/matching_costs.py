"""Matching costs of two rectified views: what each disparity costs at each pixel.

The other view is moved as a whole for each label; positions between pixels are interpolated once for each of
a few phases. Where the point lies outside the other view, or that has seen nothing there, a cost has no
weight.

References
----------
[Mei2011] X. Mei et al., "On building an accurate stereo matching system on graphics hardware", ICCV
Workshops, 2011: census and levels, each through ``1 - exp(-x / scale)``.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import ArrayView, DisparityLabels, LatticePosition
from dvc.geometry.census import CENSUS_RADIUS_PX, census_bits
from dvc.geometry.volumes import _kernels

Volume = NDArray[np.float32]

PHASES_PER_PX = 16
"""Positions between pixels are rounded to this."""
CENSUS_SCALE, LEVEL_SCALE = 12.0, 10.0
"""Bits that differ, and mean difference of levels, at which a cost is at 1 - 1/e of its limit."""
SQUARED_LIMIT = 400.0
"""Truncation of squared differences, tau_2 of (2.18), in squared levels: twice the noise of a good match."""
_BESIDE_ROWS = CENSUS_RADIUS_PX + 2  # that census and interpolation need above and below


class Band(NamedTuple):
    """Labels that are tried at each pixel: all, or a few around an estimate."""

    # first label; it may lie before or after all that there are, where nothing is then known
    origin: NDArray[np.int64]
    num_labels: int  # how many follow each other


class WeightedCosts(NamedTuple):
    """Costs of labels, and how much is known of them."""

    cost: Volume  # from 0 to `highest`; 0 where nothing is known
    weight: Volume  # 1 where both views show something, 0 elsewhere


class MatchingCost(Protocol):
    """Compares two views."""

    @property
    def highest(self) -> float:
        """No cost is above it."""

    def __call__(
        self, view: ArrayView, other: ArrayView, labels: DisparityLabels, band: Band, rows: slice
    ) -> WeightedCosts:
        """Compare some rows of a view with another."""


@dataclass(frozen=True)
class CensusCost:
    """Robust distance of census bits and of levels [Mei2011], or of bits alone, for differing exposures."""

    has_levels: bool = True

    @property
    def highest(self) -> float:
        """No cost is above it."""
        return 2.0 if self.has_levels else 1.0

    def __call__(
        self, view: ArrayView, other: ArrayView, labels: DisparityLabels, band: Band, rows: slice
    ) -> WeightedCosts:
        """Compare; see `MatchingCost`."""
        others, shifts, needed = phases(other, view.position, labels, rows)
        bits = np.stack([census(picture) for picture in others])
        count = (2 * CENSUS_RADIUS_PX + 1) ** 2
        census_table = _robust(np.arange(count), CENSUS_SCALE)
        level_table = _robust(np.arange(3 * 256) / 3.0, LEVEL_SCALE if self.has_levels else np.inf)
        costs = _empty(view, band, rows)
        image = view.image.astype(np.float32)
        pictures = (image, census(image)), (others, bits, other.seen[needed])
        tables = census_table, level_table
        region = _kernels.Region(shifts, band.origin, rows.start)
        _kernels.census_cost(*pictures, region, *tables, *costs)
        return costs


class SquaredCost:
    """Truncated squared difference of levels (2.18), as a share of the limit: pixels by themselves."""

    highest = 1.0

    def __call__(
        self, view: ArrayView, other: ArrayView, labels: DisparityLabels, band: Band, rows: slice
    ) -> WeightedCosts:
        """Compare; see `MatchingCost`."""
        others, shifts, needed = phases(other, view.position, labels, rows)
        costs = _empty(view, band, rows)
        limit = np.float32(SQUARED_LIMIT)
        pictures = view.image.astype(np.float32), others, other.seen[needed]
        region = _kernels.Region(shifts, band.origin, rows.start)
        _kernels.squared_cost(*pictures, region, limit, *costs)
        return costs


def census(image: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Compare each pixel with those around it."""
    grey = image[:, :, 0] * np.float32(0.299) + image[:, :, 1] * np.float32(0.587)
    grey += image[:, :, 2] * np.float32(0.114)
    return census_bits(grey)


def offsets(labels: DisparityLabels, view: LatticePosition, other: LatticePosition) -> NDArray[np.float64]:
    """Return how far points of a view are moved in another (2.5)."""
    disparity = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
    return np.column_stack([(view.m - other.m) * disparity, (view.n - other.n) * disparity])


class Phases(NamedTuple):
    """Some rows of a view, interpolated at a few fractions of a pixel."""

    pictures: NDArray[np.float32]
    # of each label the picture, and by how many columns and rows, in the pictures, a point is moved
    shifts: NDArray[np.int64]
    rows: slice  # rows of the view that the pictures have


def phases(other: ArrayView, position: LatticePosition, labels: DisparityLabels, rows: slice) -> Phases:
    """Interpolate what rows of a view at a position need of another one."""
    steps = np.floor(offsets(labels, position, other.position) * PHASES_PER_PX + 0.5).astype(np.int64)
    whole, fraction = np.divmod(steps, PHASES_PER_PX)
    distinct, number = np.unique(fraction, axis=0, return_inverse=True)
    height, down = other.shape[0], whole[:, 1]
    start = min(max(rows.start + int(down.min()) - _BESIDE_ROWS, 0), height - 1)
    stop = min(max(rows.stop + int(down.max()) + _BESIDE_ROWS, start + 1), height)
    image = other.image[start:stop].astype(np.float32)
    pictures = np.empty((len(distinct), *image.shape), np.float32)
    for picture, step in zip(pictures, distinct, strict=True):
        picture[:] = _moved(image, *(step / PHASES_PER_PX))
    shifts = np.ascontiguousarray(np.column_stack([number.ravel(), whole[:, 0], down - start]))
    return Phases(pictures, shifts, slice(start, stop))


def _moved(image: NDArray[np.float32], dx: float, dy: float) -> NDArray[np.float32]:
    """Sample at (x + dx, y + dy), by cubic convolution; the border repeats."""
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
    moved: NDArray[np.float32] = np.clip(image, 0.0, 255.0)
    return moved


def _cubic_taps(fraction: float) -> NDArray[np.float32]:
    """Keys's kernel with a = -1/2 at positions -1, 0, 1 and 2."""
    t = fraction
    taps = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    return np.array(taps, np.float32)


def _robust(distance: NDArray[np.float64] | NDArray[np.int64], scale: float) -> NDArray[np.float32]:
    robust: NDArray[np.float32] = (1.0 - np.exp(-distance / scale)).astype(np.float32)
    return robust


def _empty(view: ArrayView, band: Band, rows: slice) -> WeightedCosts:
    shape = rows.stop - rows.start, view.shape[1], band.num_labels
    return WeightedCosts(np.empty(shape, np.float32), np.empty(shape, np.float32))


COSTS: dict[str, MatchingCost] = {"census": CensusCost(), "squared": SquaredCost()}
"""By the name of the option."""
