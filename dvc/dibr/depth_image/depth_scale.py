"""The numbers of a depth map, as levels of the coder and as disparities."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.dibr_streams import MAX_NUMBER
from dvc.errors import ConfigError

Plane = NDArray[np.float64]

NUM_LEVELS = 1020.0
"""Levels of the coder that the range of a map is stretched to; finer than 8 bits, so that these come back."""
_MIDDLE = 128.0
_HALF_BITS = 16


@dataclass(frozen=True)
class DepthScale:
    """What the numbers of a map are."""

    lowest: float  # the least one, of single precision
    # from it to the largest one, rounded up to the upper half of single precision; 0: all are the lowest
    extent: float
    # disparity, in pixels per unit of m, is `factor` times the number plus `offset`; single precision
    factor: float = 1.0
    offset: float = 0.0

    @classmethod
    def of(cls, depth: Plane, factor: float = 1.0, offset: float = 0.0) -> Self:
        """Return the scale of a map."""
        if not np.all(np.abs(depth) <= MAX_NUMBER):
            raise ConfigError(f"numbers of a depth map: at most {MAX_NUMBER:g} is accepted")
        if not (np.float32(factor) and max(abs(factor), abs(offset)) <= MAX_NUMBER):
            raise ConfigError(
                f"disparity of {factor:g} times a number plus {offset:g}: "
                f"neither may be more than {MAX_NUMBER:g}, nor the factor zero"
            )
        least, largest = float(depth.min()), float(depth.max())
        lowest = np.float32(least)
        if largest > least and lowest > least:
            lowest = np.nextafter(lowest, np.float32(-np.inf))
        extent = _rounded_up(largest - float(lowest)) if largest > least else 0.0
        return cls(float(lowest), extent, float(np.float32(factor)), float(np.float32(offset)))

    @property
    def unit(self) -> float:
        """What a level of the coder is in the map."""
        return self.extent / NUM_LEVELS

    def levels(self, depth: Plane) -> Plane:
        """Return the levels of a map; the inverse of `depth`."""
        if not self.extent:
            return np.full(depth.shape, _MIDDLE)
        return (depth - self.lowest) / self.unit - 0.5 * NUM_LEVELS + _MIDDLE

    def depth(self, levels: Plane) -> Plane:
        """Return the map of levels, within its range."""
        return self.lowest + np.clip(levels - _MIDDLE + 0.5 * NUM_LEVELS, 0.0, NUM_LEVELS) * self.unit

    def disparity(self, depth: Plane) -> Plane:
        """Return the disparities of a map."""
        return self.factor * depth + self.offset


def encode_extent(extent: float) -> int:
    """Return the upper half of the single-precision bits of an extent; the inverse of `decode_extent`."""
    return int(np.float32(extent).view(np.uint32)) >> _HALF_BITS


def decode_extent(bits: int) -> float:
    """Return the extent of 16 bits."""
    return float(np.uint32(bits << _HALF_BITS).view(np.float32))


def _rounded_up(extent: float) -> float:
    """The least number of half of single precision that is not below."""
    single = np.float32(extent)
    if float(single) < extent:
        single = np.nextafter(single, np.float32(np.inf))
    bits = int(single.view(np.uint32))
    return decode_extent(-(-bits >> _HALF_BITS))
