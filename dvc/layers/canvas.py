"""Canvas of layers and sprites: the frame of the reference view and a margin, with depth from disparity."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats
from dvc.geometry.camera_array import DisparityLabels

DEPTH_RANGE = 20.0
"""Largest ratio of the farthest and the nearest depth without calibration."""


class Frame(NamedTuple):
    """Position and size of the reference view in a canvas."""

    left: int  # column and row of its first pixel
    top: int
    width: int  # its size
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


class DepthScale(NamedTuple):
    """Depth from disparity: ``scale / (disparity + shift)``."""

    scale: float  # the shift is in pixels per unit of m
    shift: float

    def depth(self, disparity: NDArray[np.floating]) -> Floats:
        """Return depths; infinite beyond infinity."""
        from_infinity = disparity.astype(np.float64) + self.shift
        is_before = from_infinity > 0.0
        return np.where(is_before, self.scale / np.where(is_before, from_infinity, 1.0), np.inf)


@dataclass(frozen=True, eq=False)
class Canvas:
    """Canvas in the rectified space for the reference view and the scene around it."""

    shape: tuple[int, int]  # height and width
    frame: Frame  # the reference view
    labels: DisparityLabels  # tried disparities
    resolution: float  # smallest difference of disparity between distinct surfaces
    reference: str  # name of the reference view
    num_cameras: int  # number of views that were merged
    # homography of space, inverse of (2.12), for ``(x, y, d, 1)`` with x and y in the reference view; None
    # without calibration
    world_from_rectified: Floats | None = None

    @property
    def depth_scale(self) -> DepthScale:
        """Depth in the unit of the world, or 1/d without calibration."""
        if self.world_from_rectified is not None:
            plane = np.linalg.inv(self.world_from_rectified)[3]
            row = self.world_from_rectified[3]
            return DepthScale(1.0 / float(np.linalg.norm(plane[:3]) * row[2]), float(row[3] / row[2]))
        lowest, highest = self.labels.lowest, self.labels.highest
        if lowest <= 0.0 or highest > DEPTH_RANGE * lowest:
            return DepthScale(
                1.0, max(highest - DEPTH_RANGE * lowest, self.labels.step) / (DEPTH_RANGE - 1.0)
            )
        return DepthScale(1.0, 0.0)

    def points(self, disparity: NDArray[np.floating]) -> Floats:
        """Return points in space of disparities with finite depth."""
        y, x = np.indices(self.shape, np.float64)
        x, y = x - self.frame.left, y - self.frame.top
        if self.world_from_rectified is not None:
            rectified = np.stack([x, y, disparity.astype(np.float64), np.ones(self.shape)], axis=-1)
            world = rectified @ self.world_from_rectified.T
            return np.asarray(world[..., :3] / world[..., 3:])
        width, height = self.frame.width, self.frame.height
        depth = self.depth_scale.depth(disparity)
        right, down = (x - (width - 1) / 2) / width, (y - (height - 1) / 2) / width
        return np.stack([right * depth, down * depth, depth], axis=-1)
