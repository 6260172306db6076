"""Follow the corners of a key frame through the frames after it, by sums of absolute differences of blocks.

A search starts where the point would be at rest, under its last motion, or under the motion of the nearest
point that has been found already; it goes on along a spiral until a small SAD is found, then down the path
of least SAD to a local minimum. A point without small SAD is lost.
"""

import time
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dvc.tracks import PointTracks
from dvc.video.frames import Plane
from encoder import _kernels
from encoder.corners import TRACKED_CORNERS, CornerSettings, find_corners

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class TrackingSettings:
    """How points are found and followed."""

    corners: CornerSettings = TRACKED_CORNERS
    half_block_px: int = 5  # of the blocks that are compared: 11 x 11 samples
    spiral_px: int = 5  # reach of the spiral
    far_px: int = 48  # reach of the search for points whose motion nothing tells
    max_far_searches: int = 4  # of these, in one frame
    far_share: float = 0.3  # they are made when more of the points are lost from one frame to the next
    # A SAD is small below this share of what a shift of the block by `shift_px` makes, or below so many
    # grey levels a sample.
    small_share: float = 0.65
    shift_px: int = 3
    small_noise: float = 2.0
    large_noise: float = 16.0  # grey levels a sample that are never small


@dataclass
class TrackingCounts:
    """Operations of the tracker.

    Attributes
    ----------
    num_corners : int
        Points found on key frames.
    num_blocks, num_samples : int
        Blocks whose SAD was begun, and samples compared in them.
    num_frames : int
        Frames that were searched.
    cpu_s : float
        Processor time of all that, in seconds.
    """

    num_corners: int = 0
    num_blocks: int = 0
    num_samples: int = 0
    num_frames: int = 0
    cpu_s: float = 0.0


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


class PointTracker:
    """Tracks of one group of pictures after the other.

    Parameters
    ----------
    num_points : int
        Most points to follow.
    subpixel_bits : int
        Binary digits of the positions after the point.
    settings : TrackingSettings, optional
        How they are followed.
    """

    def __init__(
        self, num_points: int, subpixel_bits: int = 0, settings: TrackingSettings | None = None
    ) -> None:
        self._num_points = num_points
        self._subpixel_bits = subpixel_bits
        self._settings = settings or TrackingSettings()
        self._motion = np.zeros(2, np.int64)
        self._path: list[Floats] = []
        self._first = np.empty((0, 2), np.int64)
        self._alive = np.ones(0, np.bool_)
        self._num_before = 0
        self.counts = TrackingCounts()

    def start(self, luma: Plane) -> None:
        """Find the points of a key frame; tracks before it are forgotten, their last motion is not.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The key frame.
        """
        started = time.process_time()
        settings = self._settings
        half = settings.half_block_px
        self._key = luma
        self._first = find_corners(luma, self._num_points, half + 1, settings.corners)
        count = len(self._first)
        self._last = self._first.copy()
        self._alive = np.ones(count, np.bool_)
        self._velocity = np.tile(self._motion, (count, 1))
        self._blocks = np.empty((count, 2 * half + 1, 2 * half + 1), np.uint8)
        _kernels.cut_blocks(luma, self._first, self._blocks)
        self._quarter_blocks = np.empty((0, 9, 9), np.uint8)
        self._small = self._small_sads()
        self._path = [self._first.astype(np.float64)]
        self._num_before = len(self._first)
        self.counts.num_corners += len(self._first)
        self.counts.cpu_s += time.process_time() - started

    def step(self, luma: Plane) -> None:
        """Follow the points into the next frame.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The frame.
        """
        started = time.process_time()
        count = len(self._first)
        self._num_before = int(self._alive.sum())
        position = np.zeros((count, 2), np.int64)
        sads = np.zeros(count, np.int64)
        operations = np.zeros(2, np.int64)
        found = np.zeros(count, np.bool_)
        self._search(luma, None, position, sads, found, operations)
        if found.sum() < (1.0 - self._settings.far_share) * self._num_before:
            self._search(luma, _quarter(luma), position, sads, found, operations)
        self._alive = found
        offsets = np.zeros((count, 2))
        if self._subpixel_bits:
            _kernels.subpixel_offsets(luma, self._blocks, position, self._alive, sads, operations, offsets)
        self._velocity = position - self._last
        self._last = position
        self._path.append(self._rounded(position + offsets))
        if self._alive.any():
            _kernels.median_motion(self._velocity, self._alive, self._motion)
        self.counts.num_blocks += int(operations[0])
        self.counts.num_samples += int(operations[1])
        self.counts.num_frames += 1
        self.counts.cpu_s += time.process_time() - started

    @property
    def longest_px(self) -> float:
        """Largest distance of a live point from where it started, in pixels; 0 if none is left."""
        if not self._alive.any():
            return 0.0
        return float(np.hypot(*(self._last - self._first)[self._alive].T).max())

    @property
    def lost_share(self) -> float:
        """Share of the points of the key frame that are lost; 0 if there were none."""
        return 1.0 - float(self._alive.mean()) if len(self._alive) else 0.0

    @property
    def last_lost_share(self) -> float:
        """Share of the points of the last frame but one that were lost in the last; 0 if there were none."""
        return 1.0 - float(self._alive.sum()) / self._num_before if self._num_before else 0.0

    def tracks(self, num_instants: int) -> PointTracks:
        """Return the tracks up to an instant.

        Parameters
        ----------
        num_instants : int
            Frames from the key frame on, at least 2.

        Returns
        -------
        PointTracks
            Those that were found at least once after the key frame.
        """
        positions = np.stack(self._path[:num_instants], axis=1)
        return PointTracks(positions[np.isfinite(positions[:, 1, 0])])

    def _rounded(self, position: Floats) -> Floats:
        scale = 2**self._subpixel_bits
        rounded: Floats = np.round(position * scale) / scale
        rounded[~self._alive] = np.nan
        return rounded

    def _search(
        self,
        luma: Plane,
        quarter: Plane | None,
        position: Integers,
        sads: Integers,
        found: NDArray[np.bool_],
        operations: Integers,
    ) -> None:
        settings = self._settings
        if quarter is not None and len(self._quarter_blocks) == 0:
            self._quarter_blocks = np.empty((len(self._first), 9, 9), np.uint8)
            _kernels.cut_blocks(_quarter(self._key), self._first // 4, self._quarter_blocks)
        _kernels.track_frame(
            luma,
            self._blocks,
            self._small,
            self._first,
            self._last,
            self._velocity,
            self._alive,
            spiral(settings.spiral_px),
            luma if quarter is None else quarter,
            self._quarter_blocks,
            spiral(settings.far_px // 4),
            0 if quarter is None else settings.max_far_searches,
            position,
            sads,
            found,
            operations,
        )

    def _small_sads(self) -> Integers:
        settings = self._settings
        least = np.empty(len(self._first), np.int64)
        _kernels.least_shift_sads(self._key, self._first, self._blocks, settings.shift_px, least)
        num_samples = (2 * settings.half_block_px + 1) ** 2
        small = np.clip(
            settings.small_share * np.minimum(least, 255 * num_samples),
            settings.small_noise * num_samples,
            settings.large_noise * num_samples,
        )
        return small.astype(np.int64)


def thinned(tracks: PointTracks, count: int) -> PointTracks:
    """Keep the tracks that tell the most: those that last longest, and of these the first.

    Parameters
    ----------
    tracks : PointTracks
        Points of strong corners first, as `PointTracker.tracks` returns them.
    count : int
        Number of tracks to keep.

    Returns
    -------
    PointTracks
        At most `count`, in the order they had.
    """
    lifetime = np.isfinite(tracks.positions[:, :, 0]).sum(axis=1)
    kept = np.sort(np.argsort(-lifetime, kind="stable")[:count])
    return PointTracks(tracks.positions[kept])


def _quarter(luma: Plane) -> Plane:
    import cv2

    height, width = luma.shape
    size = (-(-width // 4), -(-height // 4))
    return np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
