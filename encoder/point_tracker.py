"""Tracker of the points of key frames through groups of pictures, by sums of absolute differences of blocks.

A search starts at the position of the point at rest, under its last motion, and under the motion of the
nearest point located before. It follows a spiral until a SAD is small, then the steepest path of SADs to a
local minimum. A point without a small SAD is lost.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Bytes, Floats, Integers
from dvc.config import MAX_NEW_TRACKS
from dvc.tracks import PointTracks
from dvc.video.frames import Plane
from encoder import _kernels
from encoder.corner_detector import TRACKED_CORNERS, CornerSettings, find_corners
from encoder.encoder_report import TrackingWork, coding_time_s

_SIDE_PX = 2 * _kernels.HALF_BLOCK_PX + 1
_QUARTER_SIDE_PX = 2 * _kernels.QUARTER_HALF_BLOCK_PX + 1


@dataclass(frozen=True)
class PointTrackerSettings:
    """Settings of detection and tracking."""

    corners: CornerSettings = TRACKED_CORNERS
    spiral_px: int = 5  # reach of the spiral
    coarse_reach_px: int = 48  # reach of the coarse search, for points without any motion hypothesis
    max_coarse_searches: int = 4  # largest number of coarse searches in a frame
    coarse_search_share: float = 0.3  # share of points lost in one frame that starts coarse searches
    # A SAD is small below this share of the SAD of the block shifted by `shift_px`, or below this noise.
    small_share: float = 0.65
    shift_px: int = 3
    small_noise: float = 2.0  # grey levels per sample
    large_noise: float = 16.0  # grey levels per sample of a SAD that is never small
    # Points of the closing key frame are tracked back in time if they are farther than a distance from all
    # tracks; tracks through fewer frames between the key frames are dropped.
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
    """Points of a key frame and the blocks around them."""

    luma: Plane  # the key frame
    positions: Integers  # points (x, y), strongest corners first
    blocks: Bytes  # the block around each
    small: Integers  # largest SAD of each point that counts as a match

    @classmethod
    def find(cls, luma: Plane, num_points: int, settings: PointTrackerSettings, work: TrackingWork) -> Self:
        """Detect the corners of a key frame."""
        operations = np.zeros(2, np.int64)
        positions = find_corners(luma, num_points, _kernels.HALF_BLOCK_PX + 1, settings.corners)
        blocks = np.empty((len(positions), _SIDE_PX, _SIDE_PX), np.uint8)
        _kernels.cut_blocks(luma, positions, blocks)
        min_sads = np.empty(len(positions), np.int64)
        matching = _kernels.Matching(luma, blocks, operations)
        _kernels.min_shift_sads(matching, positions, settings.shift_px, min_sads)
        work.add_blocks(operations)
        num_samples = _SIDE_PX**2
        small = np.clip(
            settings.small_share * np.minimum(min_sads, 255 * num_samples),
            settings.small_noise * num_samples,
            settings.large_noise * num_samples,
        )
        return cls(luma, positions, blocks, small.astype(np.int64))

    def __getitem__(self, chosen: NDArray[np.intp]) -> "KeyPoints":
        """Return a selection of the points."""
        return KeyPoints(self.luma, self.positions[chosen], self.blocks[chosen], self.small[chosen])


class BlockMatchingTracker:
    """Tracks the points of one key frame from frame to frame, forward or back in time."""

    def __init__(
        self, points: KeyPoints, velocity: Integers, subpixel_bits: int, settings: PointTrackerSettings
    ) -> None:
        self.points = points
        self.velocity = velocity
        self.alive = np.ones(len(points.positions), np.bool_)
        self.num_alive = len(self.alive)
        self.path: list[Floats] = [points.positions.astype(np.float64)]
        self._last = points.positions
        self.longest_px2 = 0  # squared distance of the farthest live point from its start
        self._scale = 2.0**subpixel_bits
        self._settings = settings
        self._references = _kernels.Points(points.positions, points.small)
        self._spirals = spiral(settings.spiral_px), spiral(settings.coarse_reach_px // 4)

    def step(self, luma: Plane, max_coarse_searches: int, work: TrackingWork) -> None:
        """Track the points into the next frame."""
        count, points = len(self.alive), self.points
        operations = np.zeros(2, np.int64)
        search = _kernels.Matches(
            np.zeros((count, 2), np.int64),
            np.empty(count, np.int64),
            np.empty((count, 4), np.int64),
            np.zeros(count, np.bool_),
        )
        velocity, path = np.empty((count, 2), np.int64), np.empty((count, 2))
        matching = quarter = _kernels.Matching(luma, points.blocks, operations)
        least = (1.0 - self._settings.coarse_search_share) * self.num_alive
        attempts = ((0, least), (max_coarse_searches, 0.0)) if max_coarse_searches else ((0, 0.0),)
        for num_coarse, enough in attempts:
            if num_coarse:
                quarter = _kernels.Matching(_quarter(luma), self._quarter_blocks, operations)
            self.num_alive, self.longest_px2 = _kernels.follow(
                matching,
                quarter,
                self._references,
                _kernels.Movement(self._last, self.velocity, self.alive),
                self._spirals,
                num_coarse,
                enough,
                search,
                self._scale,
                velocity,
                path,
            )
            if self.num_alive >= enough:
                break
        self._last, self.velocity, self.alive = search.position, velocity, search.matched
        self.path.append(path)
        work.add_blocks(operations)
        work.num_pairs += count * (count - 1) // 2

    @cached_property
    def _quarter_blocks(self) -> Bytes:
        """Blocks around the points in the key frame at a quarter of its size."""
        blocks = np.empty((len(self.alive), _QUARTER_SIDE_PX, _QUARTER_SIDE_PX), np.uint8)
        _kernels.cut_blocks(_quarter(self.points.luma), self.points.positions // 4, blocks)
        return blocks


def _quarter(luma: Plane) -> Plane:
    """Halve the sides of a picture twice, which is much faster than quartering them once."""
    import cv2

    for _ in range(2):
        size = (-(-luma.shape[1] // 2), -(-luma.shape[0] // 2))
        luma = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
    return luma


class PointTracker:
    """Tracks the points of one group of pictures after the other."""

    def __init__(
        self,
        num_points: int,
        subpixel_bits: int = 0,
        settings: PointTrackerSettings | None = None,
        work: TrackingWork | None = None,
    ) -> None:
        self._num_points = num_points
        self._subpixel_bits = subpixel_bits
        self._settings = settings or PointTrackerSettings()
        self._last_moved = np.empty((0, 2), np.int64)  # motion of live points into the last frame with any
        self.work = TrackingWork() if work is None else work

    def start(self, luma: Plane) -> None:
        """Detect the points of a key frame; forget earlier tracks except for their last motion."""
        started = coding_time_s()
        points = KeyPoints.find(luma, self._num_points, self._settings, self.work)
        count, moved = len(points.positions), self._last_moved
        median = np.sort(moved, axis=0)[len(moved) // 2] if len(moved) else moved.sum(axis=0)
        velocity = np.tile(median, (count, 1))
        self._matching = BlockMatchingTracker(points, velocity, self._subpixel_bits, self._settings)
        self._num_before = count  # live points before the last frame
        self.work.num_corners += count
        self.work.num_starts += 1
        self.work.cpu_s += coding_time_s() - started

    def step(self, luma: Plane) -> None:
        """Track the points into the next frame."""
        started = coding_time_s()
        matching = self._matching
        self._num_before = matching.num_alive
        matching.step(luma, self._settings.max_coarse_searches, self.work)
        if matching.num_alive:
            self._last_moved = matching.velocity[matching.alive]
        self.work.num_frames += 1
        self.work.cpu_s += coding_time_s() - started

    def close(self, frames: Sequence[Plane]) -> PointTracks:
        """End a group, and start the next at the key frame that closes it."""
        before = self._matching
        forward = self.tracks(len(frames) + 1)
        self.start(frames[-1])
        started = coding_time_s()
        backward = self._new_tracks(forward, [before.points.luma, *frames])
        self.work.cpu_s += coding_time_s() - started
        return PointTracks(np.concatenate([forward.positions, backward]), len(backward))

    @property
    def longest_px(self) -> float:
        """Largest distance of a live point from its start, in pixels; 0 without live points."""
        return math.sqrt(self._matching.longest_px2)

    @property
    def lost_share(self) -> float:
        """Share of the points of the key frame that are lost; 0 without points."""
        matching = self._matching
        return 1.0 - matching.num_alive / len(matching.alive) if len(matching.alive) else 0.0

    @property
    def last_lost_share(self) -> float:
        """Share of the live points that were lost in the last frame; 0 without points."""
        return 1.0 - self._matching.num_alive / self._num_before if self._num_before else 0.0

    def tracks(self, num_instants: int) -> PointTracks:
        """Return the tracks up to an instant."""
        positions = self.path(num_instants)
        return PointTracks(positions[np.isfinite(positions[:, 1, 0])])

    def path(self, num_instants: int) -> Floats:
        """Return positions (N, T, 2) of the points of the key frame up to an instant; nan once lost."""
        return np.stack(self._matching.path[:num_instants], axis=1)

    def _new_tracks(self, forward: PointTracks, frames: Sequence[Plane]) -> Floats:
        """Track points of the last frame back in time if no track is near; they move as the nearest track."""
        settings, points = self._settings, self._matching.points
        if len(frames) - 2 < settings.min_new_track_frames:
            return np.empty((0, len(frames), 2))
        squares, velocity = np.empty(len(points.positions)), np.empty_like(points.positions)
        ends = np.ascontiguousarray(forward.positions[:, -2:])
        _kernels.move_as_nearest(points.positions, ends, squares, velocity)
        far = np.flatnonzero(squares >= settings.new_track_distance_px**2)[: settings.max_new_tracks]
        matching = BlockMatchingTracker(points[far], velocity[far], self._subpixel_bits, settings)
        for luma in reversed(frames[:-1]):
            if not matching.num_alive:
                break
            matching.step(luma, 0, self.work)
        positions = np.full((len(matching.alive), len(frames), 2), np.nan)
        positions[:, len(frames) - len(matching.path) :] = np.stack(matching.path[::-1], axis=1)
        num_located = np.isfinite(positions[:, 1:-1, 0]).sum(axis=1)
        lasting: Floats = positions[num_located >= settings.min_new_track_frames]
        return lasting
