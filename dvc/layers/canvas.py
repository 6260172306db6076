"""Canvas of layers and sprites: the frame of the reference view and a margin, depth, and points in cells."""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Floats
from dvc.errors import DvcError
from dvc.geometry.camera_array import DisparityLabels, Reconstruction

DEPTH_RANGE = 20.0
"""Largest ratio of the farthest and the nearest depth without calibration."""


class Frame(NamedTuple):
    """Rectangle in a canvas: the reference view, or a piece."""

    left: int  # column and row of its first pixel
    top: int
    width: int
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


def world_from_reference(reconstruction: Reconstruction) -> Floats | None:
    """Return the inverse of (2.12) in the frame of the reference camera, after a rectification."""
    rectification = reconstruction.figures.get("rectification")
    if rectification is None:
        return None
    try:
        rectified_from_world = np.array(rectification["rectified_from_world"], np.float64).reshape(4, 4)
        shear = np.eye(4)
        shear[:2, 2] = -np.array(reconstruction.array[reconstruction.array.reference].position)
        matrix = np.linalg.inv(shear @ rectified_from_world)
    except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as err:
        raise DvcError("the reconstruction has a rectification without its homography of space") from err
    if not np.isfinite(matrix).all() or matrix[3, 2] == 0.0:
        raise DvcError("the homography of space of the reconstruction gives no depth")
    return np.asarray(matrix / np.abs(matrix).max())


@kernel
def splat(disparity, votes, m, n, corner, shape, jump, camera, next_free, points, cameras):
    """Enter the voting pixels of a camera at (m, n) into cells of a canvas; count them without `points`."""
    height, width = disparity.shape
    x4, y4, d4 = np.empty(4), np.empty(4), np.empty(4)
    for y in range(height):
        for x in range(width):
            if not votes[y, x]:
                continue
            d = disparity[y, x]
            column = int(np.floor(x + m * d - corner[0] + 0.5))
            row = int(np.floor(y + n * d - corner[1] + 0.5))
            _enter(row, column, d, shape, camera, next_free, points, cameras)
            if y + 1 == height or x + 1 == width:
                continue
            low, high, whole = np.inf, -np.inf, True
            for k in range(4):
                v, u = y + k // 2, x + k % 2
                d4[k] = disparity[v, u]
                x4[k], y4[k] = u + m * d4[k] - corner[0], v + n * d4[k] - corner[1]
                low, high, whole = min(low, d4[k]), max(high, d4[k]), whole and votes[v, u]
            if whole and 0.0 < high - low <= jump:
                _fill(x4, y4, d4, shape, camera, next_free, points, cameras)


@kernel
def _enter(row, column, d, shape, camera, next_free, points, cameras):
    """Enter a point at `next_free` of its cell."""
    if 0 <= row < shape[0] and 0 <= column < shape[1]:
        cell = row * shape[1] + column
        if points.size:
            points[next_free[cell]] = d
            cameras[next_free[cell]] = camera
        next_free[cell] += 1


@kernel
def _fill(x4, y4, d4, shape, camera, next_free, points, cameras):
    """Enter points into the cells between four neighbours."""
    for row in range(int(np.ceil(y4.min() - 1e-6)), int(np.floor(y4.max() + 1e-6)) + 1):
        for column in range(int(np.ceil(x4.min() - 1e-6)), int(np.floor(x4.max() + 1e-6)) + 1):
            taken = False
            for k in range(4):
                taken = taken or (np.floor(x4[k] + 0.5) == column and np.floor(y4[k] + 0.5) == row)
            if not taken:
                d = _inside(x4, y4, d4, 0, 1, 2, column, row)
                d = _inside(x4, y4, d4, 3, 2, 1, column, row) if np.isnan(d) else d
                if not np.isnan(d):
                    _enter(row, column, d, shape, camera, next_free, points, cameras)


@kernel
def _inside(x4, y4, d4, a, b, c, x, y):
    """Return the disparity at a point of a triangle; NaN outside it, or if it is seen from behind."""
    ux, uy, vx, vy = x4[b] - x4[a], y4[b] - y4[a], x4[c] - x4[a], y4[c] - y4[a]
    area = ux * vy - uy * vx
    if area <= 1e-9:
        return np.nan
    s = ((x - x4[a]) * vy - (y - y4[a]) * vx) / area
    t = ((y - y4[a]) * ux - (x - x4[a]) * uy) / area
    if s < -1e-6 or t < -1e-6 or s + t > 1.0 + 1e-6:
        return np.nan
    return d4[a] + s * (d4[b] - d4[a]) + t * (d4[c] - d4[a])


@kernel
def sort_points(starts, points, cameras):
    """Sort the points of each cell from near to far, those of equal disparity by camera."""
    for cell in range(starts.size - 1):
        for i in range(starts[cell] + 1, starts[cell + 1]):
            d, camera, j = points[i], cameras[i], i - 1
            while j >= starts[cell] and (points[j] < d or (points[j] == d and cameras[j] > camera)):
                points[j + 1], cameras[j + 1] = points[j], cameras[j]
                j -= 1
            points[j + 1], cameras[j + 1] = d, camera
