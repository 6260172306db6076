"""Follow the points of a key frame from frame to frame, by sums of absolute differences of blocks.

A search starts where the point would be at rest, under its last motion, or under the motion of the nearest
point that has been found already; it goes on along a spiral until a small SAD is found, then down the path
of least SAD to a local minimum. A point without small SAD is lost.
"""

from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_BIRTHS
from dvc.video.frames import Plane
from encoder import _kernels
from encoder.corners import TRACKED_CORNERS, CornerSettings, find_corners

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PointTrackerSettings:
    """How points are found and followed."""

    corners: CornerSettings = TRACKED_CORNERS
    half_block_px: int = 5  # of the blocks that are compared: 11 x 11 samples
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
    max_births: int = MAX_BIRTHS
    birth_distance_px: float = 14.0
    min_birth_frames: int = 2


@cache
def spiral(reach_px: int) -> Integers:
    """Return all displacements up to a reach, from the smallest to the largest.

    Parameters
    ----------
    reach_px : int
        Largest component.

    Returns
    -------
    ndarray of shape (P, 2), int64
        Displacements (x, y), the null motion first; to be left as they are.
    """
    side = np.arange(-reach_px, reach_px + 1)
    x, y = (component.ravel() for component in np.meshgrid(side, side))
    order = np.lexsort((np.arctan2(y, x), x**2 + y**2))
    return np.stack([x[order], y[order]], axis=-1)


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """Points of a key frame, and what they look like there.

    Attributes
    ----------
    luma : ndarray of shape (H, W), uint8
        The key frame.
    positions : ndarray of shape (N, 2), int64
        Points (x, y), strongest corners first.
    blocks : ndarray of shape (N, B, B), uint8
        The block around each.
    small : ndarray of shape (N,), int64
        The largest SAD of a point that is found.
    """

    luma: Plane
    positions: Integers
    blocks: NDArray[np.uint8]
    small: Integers

    @classmethod
    def find(cls, luma: Plane, num_points: int, settings: PointTrackerSettings, operations: Integers) -> Self:
        """Find the corners of a key frame.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The key frame.
        num_points : int
            Most corners wanted.
        settings : PointTrackerSettings
            How they are chosen and compared.
        operations : ndarray of shape (2,), int64
            Blocks whose SAD was begun, and samples compared in them: added to.

        Returns
        -------
        KeyPoints
            None of them at the border.
        """
        half = settings.half_block_px
        positions = find_corners(luma, num_points, half + 1, settings.corners)
        blocks = np.empty((len(positions), 2 * half + 1, 2 * half + 1), np.uint8)
        _kernels.cut_blocks(luma, positions, blocks)
        min_sads = np.empty(len(positions), np.int64)
        _kernels.min_shift_sads(luma, positions, blocks, settings.shift_px, min_sads, operations)
        num_samples = (2 * half + 1) ** 2
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
    """Follows the points of one key frame from frame to frame, forward or back in time.

    Parameters
    ----------
    points : KeyPoints
        What to follow.
    velocity : ndarray of shape (N, 2), int64
        Motion into the next frame that is to be tried.
    subpixel_bits : int
        Binary digits of the positions after the point.
    settings : PointTrackerSettings
        How they are followed.
    """

    def __init__(
        self, points: KeyPoints, velocity: Integers, subpixel_bits: int, settings: PointTrackerSettings
    ) -> None:
        self.points = points
        self.last = points.positions.copy()
        self.velocity = velocity
        self.alive = np.ones(len(self.last), np.bool_)
        self.path: list[Floats] = [self.last.astype(np.float64)]
        self._sads = np.zeros(len(self.last), np.int64)
        self._quarter_blocks = np.empty((0, 9, 9), np.uint8)
        self._subpixel_bits = subpixel_bits
        self._settings = settings

    def step(self, luma: Plane, max_coarse_searches: int) -> Integers:
        """Follow the points into the next frame.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The frame.
        max_coarse_searches : int
            Most searches for points whose motion nothing tells.

        Returns
        -------
        ndarray of shape (2,), int64
            Blocks whose SAD was begun, and samples compared in them.
        """
        count = len(self.last)
        position = np.zeros((count, 2), np.int64)
        sads = np.zeros(count, np.int64)
        operations = np.zeros(2, np.int64)
        found = np.zeros(count, np.bool_)
        self._search(luma, 0, position, sads, found, operations)
        enough = (1.0 - self._settings.coarse_search_share) * self.alive.sum()
        if max_coarse_searches and found.sum() < enough:
            self._search(luma, max_coarse_searches, position, sads, found, operations)
        self.alive = found
        offsets = np.zeros((count, 2))
        if self._subpixel_bits:
            _kernels.subpixel_offsets(luma, self.points.blocks, position, found, sads, operations, offsets)
        self.velocity = position - self.last
        self.last = position
        self._sads = sads
        self.path.append(self._rounded(position + offsets))
        return operations

    @property
    def change(self) -> float:
        """Mean difference of the blocks from those of the key frame, in grey levels a sample.

        A point that is lost counts as the largest difference that it could have been found with; 0 without
        points.
        """
        if not len(self.alive):
            return 0.0
        differences = np.where(self.alive, self._sads, self.points.small)
        return float(differences.mean()) / (2 * self._settings.half_block_px + 1) ** 2

    def _rounded(self, position: Floats) -> Floats:
        scale = 2**self._subpixel_bits
        rounded: Floats = np.round(position * scale) / scale
        rounded[~self.alive] = np.nan
        return rounded

    def _search(
        self,
        luma: Plane,
        max_coarse_searches: int,
        position: Integers,
        sads: Integers,
        found: NDArray[np.bool_],
        operations: Integers,
    ) -> None:
        points, settings = self.points, self._settings
        if max_coarse_searches and len(self._quarter_blocks) == 0:
            self._quarter_blocks = np.empty((len(self.last), 9, 9), np.uint8)
            _kernels.cut_blocks(_quarter(points.luma), points.positions // 4, self._quarter_blocks)
        _kernels.track_frame(
            luma,
            points.blocks,
            points.small,
            points.positions,
            self.last,
            self.velocity,
            self.alive,
            spiral(settings.spiral_px),
            _quarter(luma) if max_coarse_searches else luma,
            self._quarter_blocks,
            spiral(settings.coarse_reach_px // 4),
            max_coarse_searches,
            position,
            sads,
            found,
            operations,
        )


def _quarter(luma: Plane) -> Plane:
    import cv2

    height, width = luma.shape
    size = (-(-width // 4), -(-height // 4))
    return np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
