"""Points tracked through a sequence by pyramidal KLT, from key frames chosen by motion.

Between two key frames every frame is compared with the first of them, so that errors do not add up from frame
to frame; at a key frame new points replace lost ones.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.video import Frame

MAX_POINTS = 900
"""Largest number of points tracked at a time: more points no longer change the cameras."""
MIN_POINTS = 40
"""Least number of points; with fewer the next frame is a key frame, and points are detected again."""
KEY_MOTION = 0.025
"""Median motion from one key frame to the next, as a share of the longer side of the frame."""
KEY_SURVIVORS = 0.7
"""Least share of the points of the last key frame; with fewer the next frame is a key frame."""
MAX_BACK_PX = 0.5
"""Largest distance of a correct point, tracked there and back, from its start."""
MAX_LEVELS = 22.0
"""Largest mean difference of a correct point's window, in luma levels."""
QUALITY = 0.004
"""Least corner strength, relative to that of the strongest corner."""
WINDOW = 0.02
"""Half the side of the compared windows, as a share of the longer side of the frame."""
FINE_WINDOW = 0.011
"""The same for the windows of the final positions: large windows are biased when the scale changes."""
MAX_EPIPOLAR_PX = 1.5
"""Largest distance from the epipolar line of a point that moves with the scene."""
MIN_SIDE_PX = 11
"""Shortest side with room for the windows of corners."""
LEVELS = 4
"""Number of levels of the pyramid, of factor 2, from one frame to the next."""


class VisiblePoints(NamedTuple):
    """Points in one frame."""

    ids: Integers  # point indices, each once
    positions: Floats  # (x, y) in pixels


@dataclass(frozen=True, eq=False)
class SequenceTracks:
    """Tracks of a whole sequence."""

    width_px: int  # size of the frames
    height_px: int
    seen: tuple[VisiblePoints, ...]  # points in every frame
    key_frames: tuple[int, ...]  # frames with newly detected points, in order, and the last frame
    num_points: int


def track_sequence(frames: Iterable[Frame]) -> SequenceTracks:
    """Track points through all frames."""
    tracker: _Tracker | None = None
    seen: list[VisiblePoints] = []
    keys: list[int] = []
    for index, frame in enumerate(frames):
        if tracker is None:
            tracker = _Tracker(frame.luma)
            keys.append(index)
        elif frame.luma.shape != tracker.shape:
            raise ValueError(f"all frames must have one size, got {tracker.shape} and {frame.luma.shape}")
        else:
            tracker.follow(frame.luma)
            if tracker.needs_key_frame:
                tracker.make_key_frame(frame.luma)
                keys.append(index)
        seen.append(tracker.seen)
    if tracker is None:
        return SequenceTracks(0, 0, (), (), 0)
    height, width = tracker.shape
    if keys[-1] != len(seen) - 1 and len(seen) > 1:
        keys.append(len(seen) - 1)
    return SequenceTracks(width, height, tuple(seen), tuple(keys), tracker.num_points)


class _Tracker:
    """Points of the last key frame and their positions in the current frame."""

    def __init__(self, luma: Bytes) -> None:
        self.shape = luma.shape
        self.num_points = 0
        self._ids = np.empty(0, np.int64)
        self.positions = np.empty((0, 2), np.float32)
        self.make_key_frame(luma)

    @property
    def seen(self) -> VisiblePoints:
        """Points in the current frame."""
        return VisiblePoints(self._ids, self.positions.astype(np.float64))

    @property
    def needs_key_frame(self) -> bool:
        """Whether the points have moved too far, or too many are lost."""
        if len(self._ids) < max(MIN_POINTS, KEY_SURVIVORS * self._num_at_key):
            return True
        motion = np.hypot(*(self.positions - self._key_positions).T)
        return bool(np.median(motion) > KEY_MOTION * max(self.shape))

    def make_key_frame(self, luma: Bytes) -> None:
        """Detect additional points, and compare later frames with this one."""
        new = _new_corners(luma, self.positions)
        self._ids = np.concatenate([self._ids, self.num_points + np.arange(len(new))])
        self.num_points += len(new)
        self.positions = np.concatenate([self.positions, new])
        self._key, self._last = luma, luma
        self._key_positions = self.positions
        self._num_at_key = len(self._ids)

    def follow(self, luma: Bytes) -> None:
        """Track the points into the next frame, and drop lost points."""
        import cv2

        if len(self._ids):
            guess, _ = _flow(self._last, luma, self.positions, self.positions, levels=LEVELS)
            moved, good = _flow(self._key, luma, self._key_positions, guess)
            moved, good_fine = _flow(self._key, luma, self._key_positions, moved, FINE_WINDOW)
            back, good_back = _flow(luma, self._key, moved, self._key_positions, FINE_WINDOW)
            good &= good_fine & good_back & (np.hypot(*(back - self._key_positions).T) <= MAX_BACK_PX)
            if np.count_nonzero(good) >= MIN_POINTS:  # keep those that the majority's epipolar geometry fits
                _, inliers = cv2.findFundamentalMat(
                    self._key_positions[good], moved[good], cv2.USAC_MAGSAC, MAX_EPIPOLAR_PX, 0.999, 2000
                )
                if inliers is not None:
                    good[good] = inliers.ravel() > 0
            size = np.array([self.shape[1], self.shape[0]])
            good &= ((moved >= 0) & (moved <= size - 1)).all(axis=1)
            self._ids, self._key_positions = self._ids[good], self._key_positions[good]
            self.positions = moved[good]
        self._last = luma


def evenly_spaced(items: Sequence[int], count: int) -> list[int]:
    """Return at most `count` items of a list, from the first to the last."""
    chosen = np.unique(np.linspace(0, len(items) - 1, min(len(items), count)).round().astype(int))
    return [items[index] for index in chosen] if items else []


def window_radius_px(shape: tuple[int, ...], window: float = WINDOW) -> int:
    """Return half the side of the compared windows."""
    return max(3, round(window * max(shape)))


def _flow(
    source: Bytes, target: Bytes, points: Singles, guess: Singles, window: float = WINDOW, levels: int = 1
) -> tuple[Singles, Mask]:
    """Track points from one frame to another, from a guess."""
    import cv2

    side = 2 * window_radius_px(source.shape, window) + 1
    moved, status, error = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points.reshape(-1, 1, 2),
        guess.reshape(-1, 1, 2).copy(),
        winSize=(side, side),
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    good = (status.ravel() == 1) & (error.ravel() <= MAX_LEVELS)
    moved = np.asarray(moved, np.float32).reshape(-1, 2)
    return moved, good & np.isfinite(moved).all(axis=1)


def _new_corners(luma: Bytes, tracked: Singles) -> Singles:
    """Detect corners away from tracked points."""
    import cv2

    count = MAX_POINTS - len(tracked)
    if count <= 0 or min(luma.shape) < MIN_SIDE_PX:
        return np.empty((0, 2), np.float32)
    distance = max(5, round(max(luma.shape) / 75))
    free = np.full(luma.shape, 255, np.uint8)
    for x, y in np.rint(tracked).astype(int):
        cv2.circle(free, (int(x), int(y)), distance, 0, -1)
    border = window_radius_px(luma.shape)
    free[:border] = free[-border:] = 0
    free[:, :border] = free[:, -border:] = 0
    corners = cv2.goodFeaturesToTrack(luma, count, QUALITY, distance, mask=free, blockSize=5)
    if corners is None:
        return np.empty((0, 2), np.float32)
    window = cv2.cornerSubPix(
        luma, corners.astype(np.float32), (3, 3), (-1, -1), (cv2.TERM_CRITERIA_COUNT, 10, 0.01)
    )
    drifted = np.abs(window - corners).max(axis=-1, keepdims=True) > 2
    return np.asarray(np.where(drifted, corners, window), np.float32).reshape(-1, 2)
