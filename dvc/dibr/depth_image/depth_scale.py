"""Depth maps as files, and the meaning of their numbers: levels of the coder, and disparities."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.dibr.dibr_streams import MAX_NUMBER
from dvc.errors import ConfigError, DvcError
from dvc.picture_files import largest_level, read_levels, read_pfm

Plane = NDArray[np.float64]

NUM_LEVELS = 1020.0
"""Levels of the coder over the range of a map; finer than 8 bits, so that these are exact."""
_MIDDLE = 128.0
_HALF_BITS = 16
INPAINT_RADIUS = 3.0
"""Radius in pixels of the neighbourhood that fills holes."""


@dataclass(frozen=True)
class DepthScale:
    """Meaning of the numbers of a map."""

    lowest: float  # least number, of single precision
    # range of numbers, rounded up to the upper half of single precision; 0: all are the lowest
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
        extent = 0.0
        if largest > least:  # the least number of half of single precision that is not below
            single = np.float32(largest - float(lowest))
            if float(single) < largest - float(lowest):
                single = np.nextafter(single, np.float32(np.inf))
            extent = decode_extent(-(-int(single.view(np.uint32)) >> _HALF_BITS))
        return cls(float(lowest), extent, float(np.float32(factor)), float(np.float32(offset)))

    @property
    def unit(self) -> float:
        """Size of a level of the coder in numbers of the map."""
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


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A depth map that was read."""

    depth: Plane  # numbers of the file; holes are filled
    known: NDArray[np.bool_]  # False in holes
    largest: float  # largest number of the file format: 255, 65535, or infinite

    def scale(self, factor: float = 1.0, near_far: tuple[float, float] | None = None) -> DepthScale:
        """Return the meaning of the numbers; `near_far` are the depths of the largest number and of 0."""
        if near_far is None:
            return DepthScale.of(self.depth, factor)
        if not np.isfinite(self.largest):
            raise ConfigError("--near-far requires a map of 8 or 16 bits")
        near, far = 1.0 / near_far[0], 1.0 / near_far[1]
        return DepthScale.of(self.depth, factor * (near - far) / self.largest, factor * far)


def read_depth_map(path: str | Path, hole: float | None = None) -> DepthMap:
    """Read a depth map."""
    if Path(path).suffix.lower() == ".pfm":
        depth, largest = read_pfm(path).astype(np.float64), np.inf
    else:
        depth, largest = read_levels(path), float(largest_level(path))
    known = np.isfinite(depth)
    if hole is not None:
        known &= depth != hole
    if not known.any():
        raise DvcError(f"{path}: the depth map is empty")
    return DepthMap(filled(np.where(known, depth, np.nan)), known, largest)


def default_hole(path: str | Path) -> float | None:
    """Return the number of holes in maps of disparities: 0 in pictures."""
    return None if Path(path).suffix.lower() == ".pfm" else 0.0


def filled(depth: Plane) -> Plane:
    """Continue a map into its holes."""
    known = np.isfinite(depth)
    if known.all():
        return depth
    middle = float(np.median(depth[known]))
    plane = np.where(known, depth, middle).astype(np.float32)
    inpainted = cv2.inpaint(plane, (~known).astype(np.uint8), INPAINT_RADIUS, cv2.INPAINT_TELEA)
    low, high = float(depth[known].min()), float(depth[known].max())
    # inpainting near the largest number of single precision may overflow
    finite = np.nan_to_num(inpainted.astype(np.float64), nan=middle)
    return np.where(known, depth, np.clip(finite, low, high))
