"""Depth maps as files, and what their numbers mean."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.depth_scale import DepthScale, Plane
from dvc.errors import ConfigError, DvcError
from dvc.picture_files import largest_level, read_levels, read_pfm

INPAINT_RADIUS = 3.0
"""Of the neighbourhood from which holes are filled, in pixels."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A depth map that was read."""

    depth: Plane  # numbers of the file; holes are filled
    known: NDArray[np.bool_]  # where there is no hole
    largest: float  # largest number that files of this kind can have: 255, 65535, or infinite


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


def read_truth(path: str | Path) -> DepthMap:
    """Read a depth map to compare with; in pictures, 0 is taken for a hole."""
    return read_depth_map(path, default_hole(path))


def default_hole(path: str | Path) -> float | None:
    """Return the number of holes in maps of disparities."""
    return None if Path(path).suffix.lower() == ".pfm" else 0.0


def scale_of(found: DepthMap, factor: float = 1.0, near_far: tuple[float, float] | None = None) -> DepthScale:
    """Return what the numbers of a map are."""
    if near_far is None:
        return DepthScale.of(found.depth, factor)
    if not np.isfinite(found.largest):
        raise ConfigError("--near-far is for maps of 8 or 16 bits")
    near, far = 1.0 / near_far[0], 1.0 / near_far[1]
    return DepthScale.of(found.depth, factor * (near - far) / found.largest, factor * far)


def filled(depth: Plane) -> Plane:
    """Continue a map into its holes."""
    known = np.isfinite(depth)
    if known.all():
        return depth
    middle = float(np.median(depth[known]))
    plane = np.where(known, depth, middle).astype(np.float32)
    found = cv2.inpaint(plane, (~known).astype(np.uint8), INPAINT_RADIUS, cv2.INPAINT_TELEA)
    low, high = float(depth[known].min()), float(depth[known].max())
    # Where numbers are near the largest of single precision, what is between them is none.
    return np.where(known, depth, np.clip(np.nan_to_num(found.astype(np.float64), nan=middle), low, high))
