"""Follow the corners of a key frame through the frames after it, by sums of absolute differences of blocks.

A search starts where the point would be at rest, under its last motion, or under the motion of the nearest
point that has been found already; it goes on along a spiral until a small SAD is found, then down the path
of least SAD to a local minimum. A point without small SAD is lost.
"""

import time
from collections.abc import Sequence
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
    # Points of the key frame that closes a group are followed back in time where they are so far from all
    # tracks, up to a number; those that are known in fewer frames beside the key frame are left out.
    max_births: int = 32
    birth_distance_px: float = 14.0
    min_birth_frames: int = 2


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

    def __getitem__(self, chosen: NDArray[np.intp]) -> "KeyPoints":
        """Return some of the points."""
        return KeyPoints(self.luma, self.positions[chosen], self.blocks[chosen], self.small[chosen])


class Pursuit:
    """Follows the points of one key frame from frame to frame, forward or back in time.

    Parameters
    ----------
    points : KeyPoints
        What to follow.
    velocity : ndarray of shape (N, 2), int64
        Motion into the next frame that is to be tried.
    subpixel_bits : int
        Binary digits of the positions after the point.
    settings : TrackingSettings
        How they are followed.
    """

    def __init__(
        self, points: KeyPoints, velocity: Integers, subpixel_bits: int, settings: TrackingSettings
    ) -> None:
        self.points = points
        self.last = points.positions.copy()
        self.velocity = velocity
        self.alive = np.ones(len(self.last), np.bool_)
        self.path: list[Floats] = [self.last.astype(np.float64)]
        self._quarter_blocks = np.empty((0, 9, 9), np.uint8)
        self._subpixel_bits = subpixel_bits
        self._settings = settings

    def step(self, luma: Plane, max_far_searches: int) -> Integers:
        """Follow the points into the next frame.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The frame.
        max_far_searches : int
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
        if max_far_searches and found.sum() < (1.0 - self._settings.far_share) * self.alive.sum():
            self._search(luma, max_far_searches, position, sads, found, operations)
        self.alive = found
        offsets = np.zeros((count, 2))
        if self._subpixel_bits:
            _kernels.subpixel_offsets(luma, self.points.blocks, position, found, sads, operations, offsets)
        self.velocity = position - self.last
        self.last = position
        self.path.append(self._rounded(position + offsets))
        return operations

    def _rounded(self, position: Floats) -> Floats:
        scale = 2**self._subpixel_bits
        rounded: Floats = np.round(position * scale) / scale
        rounded[~self.alive] = np.nan
        return rounded

    def _search(
        self,
        luma: Plane,
        max_far_searches: int,
        position: Integers,
        sads: Integers,
        found: NDArray[np.bool_],
        operations: Integers,
    ) -> None:
        points, settings = self.points, self._settings
        if max_far_searches and len(self._quarter_blocks) == 0:
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
            _quarter(luma) if max_far_searches else luma,
            self._quarter_blocks,
            spiral(settings.far_px // 4),
            max_far_searches,
            position,
            sads,
            found,
            operations,
        )


class PointTracker:
    """Tracks of one group of pictures after the other.

    Parameters
    ----------
    num_points : int
        Most points to follow from the first key frame of a group on.
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
        points = self._key_points(luma)
        count = len(points.positions)
        velocity = np.tile(self._motion, (count, 1))
        self._pursuit = Pursuit(points, velocity, self._subpixel_bits, self._settings)
        self._num_before = count
        self.counts.num_corners += count
        self.counts.cpu_s += time.process_time() - started

    def step(self, luma: Plane) -> None:
        """Follow the points into the next frame.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The frame.
        """
        started = time.process_time()
        pursuit = self._pursuit
        self._num_before = int(pursuit.alive.sum())
        self._count(pursuit.step(luma, self._settings.max_far_searches))
        if pursuit.alive.any():
            _kernels.median_motion(pursuit.velocity, pursuit.alive, self._motion)
        self.counts.num_frames += 1
        self.counts.cpu_s += time.process_time() - started

    def close(self, frames: Sequence[Plane]) -> PointTracks:
        """End a group, and start the next at the key frame that closes it.

        Parameters
        ----------
        frames : sequence of ndarray of shape (H, W), uint8
            Those after the first key frame, up to the last.

        Returns
        -------
        PointTracks
            Those that were found at least once beside their key frame: first the points of the first key
            frame, then those of the last that none of them is near, followed back in time.
        """
        before = self._pursuit
        forward = self.tracks(len(frames) + 1)
        self.start(frames[-1])
        started = time.process_time()
        backward = self._births(forward, [before.points.luma, *frames])
        self.counts.cpu_s += time.process_time() - started
        return PointTracks(np.concatenate([forward.positions, backward]), len(backward))

    @property
    def longest_px(self) -> float:
        """Largest distance of a live point from where it started, in pixels; 0 if none is left."""
        pursuit = self._pursuit
        if not pursuit.alive.any():
            return 0.0
        return float(np.hypot(*(pursuit.last - pursuit.points.positions)[pursuit.alive].T).max())

    @property
    def lost_share(self) -> float:
        """Share of the points of the key frame that are lost; 0 if there were none."""
        alive = self._pursuit.alive
        return 1.0 - float(alive.mean()) if len(alive) else 0.0

    @property
    def last_lost_share(self) -> float:
        """Share of the points of the last frame but one that were lost in the last; 0 if there were none."""
        alive = self._pursuit.alive
        return 1.0 - float(alive.sum()) / self._num_before if self._num_before else 0.0

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
        positions = np.stack(self._pursuit.path[:num_instants], axis=1)
        return PointTracks(positions[np.isfinite(positions[:, 1, 0])])

    def _births(self, forward: PointTracks, frames: Sequence[Plane]) -> Floats:
        """Follow points of the last frame back in time, where no track comes near."""
        settings, points = self._settings, self._pursuit.points
        ends = forward.positions[:, -2:]
        known = ends[np.isfinite(ends).all(axis=(1, 2))]
        distance, nearest = _nearest(points.positions, known[:, 1])
        chosen = np.flatnonzero(distance >= settings.birth_distance_px)[: settings.max_births]
        velocity = np.zeros((len(chosen), 2), np.int64)
        if len(known):
            velocity = np.rint(known[:, 0] - known[:, 1]).astype(np.int64)[nearest[chosen]]
        pursuit = Pursuit(points[chosen], velocity, self._subpixel_bits, settings)
        for luma in reversed(frames[:-1]):
            if not pursuit.alive.any():
                break
            self._count(pursuit.step(luma, 0))
        positions = np.full((len(chosen), len(frames), 2), np.nan)
        positions[:, len(frames) - len(pursuit.path) :] = np.stack(pursuit.path[::-1], axis=1)
        num_known = np.isfinite(positions[:, :, 0]).sum(axis=1)
        lasting: Floats = positions[num_known > settings.min_birth_frames]
        return lasting

    def _count(self, operations: Integers) -> None:
        self.counts.num_blocks += int(operations[0])
        self.counts.num_samples += int(operations[1])

    def _key_points(self, luma: Plane) -> KeyPoints:
        settings = self._settings
        half = settings.half_block_px
        positions = find_corners(luma, self._num_points, half + 1, settings.corners)
        blocks = np.empty((len(positions), 2 * half + 1, 2 * half + 1), np.uint8)
        _kernels.cut_blocks(luma, positions, blocks)
        least = np.empty(len(positions), np.int64)
        _kernels.least_shift_sads(luma, positions, blocks, settings.shift_px, least)
        num_samples = (2 * half + 1) ** 2
        small = np.clip(
            settings.small_share * np.minimum(least, 255 * num_samples),
            settings.small_noise * num_samples,
            settings.large_noise * num_samples,
        )
        return KeyPoints(luma, positions, blocks, small.astype(np.int64))


def _nearest(points: Integers, others: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distance of each point from the nearest of the others, and which it is."""
    if len(others) == 0:
        return np.full(len(points), np.inf), np.zeros(len(points), np.intp)
    distances = np.hypot(*(points[:, None] - others[None]).transpose(2, 0, 1))
    return distances.min(axis=1), distances.argmin(axis=1)


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
    num_backward = int((kept >= len(tracks) - tracks.num_backward).sum())
    return PointTracks(tracks.positions[kept], num_backward)


def _quarter(luma: Plane) -> Plane:
    import cv2

    height, width = luma.shape
    size = (-(-width // 4), -(-height // 4))
    return np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
