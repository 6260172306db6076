"""Tracks of groups of pictures: points of each key frame, followed into the frames after it and before it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.tracks import PointTracks
from dvc.video.frames import Plane
from encoder import _kernels
from encoder.block_matching import BlockMatchingTracker, KeyPoints, PointTrackerSettings
from encoder.clock import coding_time_s
from encoder.corners import TrackingWork

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class PointTracker:
    """Tracks of one group of pictures after the other."""

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
        self._last_moved: tuple[Integers, NDArray[np.bool_]] | None = None
        self._num_before = 0
        self.work = TrackingWork() if work is None else work

    def start(self, luma: Plane) -> None:
        """Find the points of a key frame; tracks before it are forgotten, their last motion is not."""
        started = coding_time_s()
        operations = np.zeros(2, np.int64)
        points = KeyPoints.find(luma, self._num_points, self._settings, operations)
        self._count(operations)
        count = len(points.positions)
        velocity = np.tile(self._last_motion(), (count, 1))
        self._matching = BlockMatchingTracker(points, velocity, self._subpixel_bits, self._settings)
        self._num_before = count
        self.work.num_corners += count
        self.work.num_starts += 1
        self.work.cpu_s += coding_time_s() - started

    def step(self, luma: Plane) -> None:
        """Follow the points into the next frame."""
        started = coding_time_s()
        matching = self._matching
        self._num_before = matching.num_alive
        self._follow(matching, luma, self._settings.max_coarse_searches)
        if matching.num_alive:
            self._last_moved = matching.velocity, matching.alive
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
        """Largest distance of a live point from where it started, in pixels; 0 if none is left."""
        return self._matching.longest_px

    @property
    def lost_share(self) -> float:
        """Share of the points of the key frame that are lost; 0 if there were none."""
        matching = self._matching
        return 1.0 - matching.num_alive / len(matching.alive) if len(matching.alive) else 0.0

    @property
    def last_lost_share(self) -> float:
        """Share of the points of the last frame but one that were lost in the last; 0 if there were none."""
        return 1.0 - self._matching.num_alive / self._num_before if self._num_before else 0.0

    def tracks(self, num_instants: int) -> PointTracks:
        """Return the tracks up to an instant."""
        positions = self.path(num_instants)
        return PointTracks(positions[np.isfinite(positions[:, 1, 0])])

    def path(self, num_instants: int) -> Floats:
        """Return where the points of the key frame are, up to an instant; nan once they are lost."""
        return np.stack(self._matching.path[:num_instants], axis=1)

    def _new_tracks(self, forward: PointTracks, frames: Sequence[Plane]) -> Floats:
        """Follow points of the last frame back in time, where no track comes near."""
        settings = self._settings
        if len(frames) - 2 < settings.min_new_track_frames:
            return np.empty((0, len(frames), 2))
        matching = self._uncovered(forward.positions[:, -2:])
        for luma in reversed(frames[:-1]):
            if not matching.num_alive:
                break
            self._follow(matching, luma, 0)
        positions = np.full((len(matching.alive), len(frames), 2), np.nan)
        positions[:, len(frames) - len(matching.path) :] = np.stack(matching.path[::-1], axis=1)
        num_found = np.isfinite(positions[:, 1:-1, 0]).sum(axis=1)
        lasting: Floats = positions[num_found >= settings.min_new_track_frames]
        return lasting

    def _uncovered(self, ends: Floats) -> BlockMatchingTracker:
        """Choose points far from the tracks, whose last two positions are given; they move as the nearest."""
        settings, points = self._settings, self._matching.points
        squares, velocity = np.empty(len(points.positions)), np.empty_like(points.positions)
        _kernels.move_as_nearest(points.positions, np.ascontiguousarray(ends), squares, velocity)
        chosen = np.flatnonzero(squares >= settings.new_track_distance_px**2)[: settings.max_new_tracks]
        return BlockMatchingTracker(points[chosen], velocity[chosen], self._subpixel_bits, settings)

    def _last_motion(self) -> Integers:
        """Return the median motion into the last frame where any point was found; at first, none."""
        median = np.zeros(2, np.int64)
        if self._last_moved:
            _kernels.median_motion(*self._last_moved, median)
        return median

    def _follow(self, matching: BlockMatchingTracker, luma: Plane, max_coarse_searches: int) -> None:
        count = len(matching.alive)
        self._count(matching.step(luma, max_coarse_searches))
        self.work.num_pairs += count * (count - 1) // 2

    def _count(self, operations: Integers) -> None:
        num_blocks, num_samples = operations.tolist()
        self.work.num_blocks += num_blocks
        self.work.num_samples += num_samples
