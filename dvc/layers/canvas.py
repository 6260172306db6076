"""The frame of layers and sprites: a canvas around the reference view, and depth from disparity in it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import DisparityLabels

Floats = NDArray[np.float64]

DEPTH_RANGE = 20.0
"""Where nothing is calibrated, the farthest depth is at most this many times the nearest."""


class Frame(NamedTuple):
    """Where the reference view lies in a canvas."""

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

    scale: float  # of the formula; the shift is in pixels per unit of m
    shift: float

    def depth(self, disparity: NDArray[np.floating]) -> Floats:
        """Return depths; infinite beyond infinity."""
        from_infinity = disparity.astype(np.float64) + self.shift
        is_before = from_infinity > 0.0
        return np.where(is_before, self.scale / np.where(is_before, from_infinity, 1.0), np.inf)


@dataclass(frozen=True, eq=False)
class Canvas:
    """A canvas in the rectified space, that holds the reference view and what other cameras see around it."""

    shape: tuple[int, int]  # height and width
    frame: Frame  # the reference view
    labels: DisparityLabels  # disparities that were tried
    resolution: float  # surfaces whose disparities differ by less are not told apart
    reference: str  # name of the reference view
    num_cameras: int  # number of views that were merged
    # homography of space, inverse of (2.12), for ``(x, y, d, 1)`` with x and y in the reference view; None
    # where nothing is calibrated
    world_from_rectified: Floats | None = None

    @property
    def depth_scale(self) -> DepthScale:
        """Depth in the unit of the world; where nothing is calibrated, 1/d."""
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
        """Return points in space, of disparities whose depth is finite."""
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
