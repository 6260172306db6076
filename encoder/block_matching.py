"""Follow the points of a key frame from frame to frame, by sums of absolute differences of blocks.

A search starts where the point would be at rest, under its last motion, or under the motion of the nearest
point that has been found already; it goes on along a spiral until a small SAD is found, then down the path
of least SAD to a local minimum. A point without small SAD is lost.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_NEW_TRACKS
from dvc.video.frames import Plane
from encoder import _kernels
from encoder.corners import TRACKED_CORNERS, CornerSettings, find_corners

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SIDE_PX = 2 * _kernels.HALF_BLOCK_PX + 1
_QUARTER_SIDE_PX = 2 * _kernels.QUARTER_HALF_BLOCK_PX + 1


@dataclass(frozen=True)
class PointTrackerSettings:
    """How points are found and followed."""

    corners: CornerSettings = TRACKED_CORNERS
    spiral_px: int = 5  # reach of the spiral
    coarse_reach_px: int = 48  # reach of the search for points whose motion nothing tells
    max_coarse_searches: int = 4  # of these, in one frame
    coarse_search_share: float = 0.3  # they are made when more of the points are lost in one frame
    # A SAD is small below this share of what a shift of the block by `shift_px` makes, or below so many
    # grey levels a sample.
    small_share: float = 0.65
    shift_px: int = 3
    small_noise: float = 2.0
    large_noise: float = 16.0  # grey levels a sample that are never small
    # Points of the key frame that closes a group are followed back in time where they are so far from all
    # tracks, up to a number; those that are found in fewer frames between the key frames are left out.
    max_new_tracks: int = MAX_NEW_TRACKS
    new_track_distance_px: float = 14.0
    min_new_track_frames: int = 2


@cache
def spiral(reach_px: int) -> Integers:
    """Return all displacements up to a reach, from the smallest to the largest."""
    side = np.arange(-reach_px, reach_px + 1)
    x, y = (component.ravel() for component in np.meshgrid(side, side))
    order = np.lexsort((np.arctan2(y, x), x**2 + y**2))
    return np.stack([x[order], y[order]], axis=-1)


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """Points of a key frame, and what they look like there."""

    luma: Plane  # the key frame
    positions: Integers  # points (x, y), strongest corners first
    blocks: NDArray[np.uint8]  # the block around each
    small: Integers  # the largest SAD of a point that is found

    @classmethod
    def find(cls, luma: Plane, num_points: int, settings: PointTrackerSettings, operations: Integers) -> Self:
        """Find the corners of a key frame."""
        positions = find_corners(luma, num_points, _kernels.HALF_BLOCK_PX + 1, settings.corners)
        return cls.at(luma, positions, settings, operations)

    @classmethod
    def at(
        cls, luma: Plane, positions: Integers, settings: PointTrackerSettings, operations: Integers
    ) -> Self:
        """Take points of a frame whose blocks are inside it."""
        blocks = np.empty((len(positions), _SIDE_PX, _SIDE_PX), np.uint8)
        _kernels.cut_blocks(luma, positions, blocks)
        min_sads = np.empty(len(positions), np.int64)
        matching = _kernels.Matching(luma, blocks, operations)
        _kernels.min_shift_sads(matching, positions, settings.shift_px, min_sads)
        num_samples = _SIDE_PX**2
        small = np.clip(
            settings.small_share * np.minimum(min_sads, 255 * num_samples),
            settings.small_noise * num_samples,
            settings.large_noise * num_samples,
        )
        return cls(luma, positions, blocks, small.astype(np.int64))

    def __getitem__(self, chosen: NDArray[np.intp]) -> "KeyPoints":
        """Return some of the points."""
        return KeyPoints(self.luma, self.positions[chosen], self.blocks[chosen], self.small[chosen])


class BlockMatchingTracker:
    """Follows the points of one key frame from frame to frame, forward or back in time."""

    def __init__(
        self, points: KeyPoints, velocity: Integers, subpixel_bits: int, settings: PointTrackerSettings
    ) -> None:
        self.points = points
        self.velocity = velocity
        self.alive = np.ones(len(points.positions), np.bool_)
        self.num_alive = len(self.alive)
        self.path: list[Floats] = [points.positions.astype(np.float64)]
        self._last = points.positions
        self._longest_px2 = 0
        self._quarter_blocks = np.empty((0, _QUARTER_SIDE_PX, _QUARTER_SIDE_PX), np.uint8)
        self._scale = 2.0**subpixel_bits
        self._settings = settings
        self._known = _kernels.Points(points.positions, points.small)
        self._spirals = spiral(settings.spiral_px), spiral(settings.coarse_reach_px // 4)

    def step(self, luma: Plane, max_coarse_searches: int) -> Integers:
        """Follow the points into the next frame."""
        count = len(self.alive)
        operations = np.zeros(2, np.int64)
        search = _kernels.Found(
            np.zeros((count, 2), np.int64),
            np.empty(count, np.int64),
            np.empty((count, 4), np.int64),
            np.zeros(count, np.bool_),
        )
        ends = self._scale, np.empty((count, 2), np.int64), np.empty((count, 2))
        least = (1.0 - self._settings.coarse_search_share) * self.num_alive if max_coarse_searches else 0.0
        if not self._search(luma, 0, least, search, ends, operations):
            self._search(luma, max_coarse_searches, 0.0, search, ends, operations)
        (self._last, _, _, self.alive), (_, self.velocity, path) = search, ends
        self.path.append(path)
        return operations

    @property
    def longest_px(self) -> float:
        """Largest distance of a live point from where it started, in pixels; 0 if none is left."""
        return math.sqrt(self._longest_px2)

    def _search(
        self,
        luma: Plane,
        max_coarse_searches: int,
        least: float,
        search: _kernels.Found,
        ends: tuple[float, Integers, Floats],
        operations: Integers,
    ) -> bool:
        """Find points that are not found yet; tell whether there are enough, and the frame is finished."""
        points, quarter = self.points, luma
        if max_coarse_searches:
            quarter = _quarter(luma)
            if len(self._quarter_blocks) == 0:
                self._quarter_blocks = np.empty((len(self.alive), *self._quarter_blocks.shape[1:]), np.uint8)
                _kernels.cut_blocks(_quarter(points.luma), points.positions // 4, self._quarter_blocks)
        self.num_alive, self._longest_px2 = _kernels.follow(
            _kernels.Matching(luma, points.blocks, operations),
            _kernels.Matching(quarter, self._quarter_blocks, operations),
            self._known,
            _kernels.Movement(self._last, self.velocity, self.alive),
            self._spirals,
            (max_coarse_searches, least),
            search,
            ends,
        )
        return self.num_alive >= least


def _quarter(luma: Plane) -> Plane:
    """Halve the sides of a picture twice, which is a lot faster than to quarter them."""
    import cv2

    for _ in range(2):
        size = (-(-luma.shape[1] // 2), -(-luma.shape[0] // 2))
        luma = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
    return luma
