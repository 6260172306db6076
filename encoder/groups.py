"""Groups of pictures: which frames are key frames, and which Wyner-Ziv frames lie between them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.config import KeyFrameRule
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame
from encoder.corners import CornerDetector
from encoder.gop_segmentation import first_length, group_costs
from encoder.tracking import PointTracker

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """One group of pictures."""

    wyner_ziv: tuple[Frame, ...]  # frames since the previous key frame, in display order
    key: Frame  # the key frame that ends the group
    # points of the previous key frame, followed to this one, and points of this one, followed back
    tracks: PointTracks | None = None
    points: FeaturePoints | None = None  # corners of the Wyner-Ziv frames
    # points of the previous key frame in each frame up to this one (N, T, 2), nan once they are lost
    path: Floats | None = None


def groups(frames: Iterable[Frame], length: int) -> Iterator[Group]:
    """Cut a sequence into groups at a fixed distance of key frames; the last frame is always a key frame."""
    waiting: list[Frame] = []
    for index, frame in enumerate(frames):
        if index % length == 0:
            yield Group(tuple(waiting), frame)
            waiting = []
        else:
            waiting.append(frame)
    if waiting:
        yield Group(tuple(waiting[:-1]), waiting[-1])


def cornered_groups(frames: Iterable[Frame], length: int, detector: CornerDetector) -> Iterator[Group]:
    """Cut a sequence as `groups` does, and find the corners of its Wyner-Ziv frames."""
    for group in groups(frames, length):
        yield replace(group, points=detector.detect([frame.luma for frame in group.wyner_ziv]))


def tracked_groups(
    frames: Iterable[Frame], length: int, tracker: PointTracker, rule: KeyFrameRule
) -> Iterator[Group]:
    """Cut a sequence where its tracks have become long, or are lost; the last frame is always a key frame."""
    window = _Window(tracker, length, rule)
    for frame in frames:
        yield from window.take(frame)
    yield from window.flush()


class _Window:
    """Frames since the last key frame, and what their tracks tell."""

    def __init__(self, tracker: PointTracker, length: int, rule: KeyFrameRule) -> None:
        self._tracker, self._length, self._rule = tracker, length, rule
        self._waiting: list[Frame] = []
        self._changes: list[float] = []
        self._lost_shares: list[float] = []
        self._begun = False

    def take(self, frame: Frame) -> Iterator[Group]:
        tracker = self._tracker
        if not self._begun:
            self._begun = True
            yield Group((), frame)
            tracker.start(frame.luma)
            return
        tracker.step(frame.luma)
        if self._waiting and _is_cut(tracker, self._rule):
            yield from self.flush()
            tracker.step(frame.luma)
        self._wait(frame)
        if self._rule.choice == "rate" and not _is_cut(tracker, self._rule):
            if len(self._waiting) == self._length:
                yield self._close_first()
        elif _is_due(len(self._waiting), self._length, tracker, self._rule):
            yield from self.flush()

    def flush(self) -> Iterator[Group]:
        while self._waiting:
            yield self._close_first()

    def _wait(self, frame: Frame) -> None:
        self._waiting.append(frame)
        if self._rule.choice == "rate":
            self._changes.append(self._tracker.change)
            self._lost_shares.append(self._tracker.lost_share)

    def _close_first(self) -> Group:
        """Close a group of all frames that wait, or the first at the least rate; follow the others anew."""
        count = len(self._waiting)
        if self._rule.choice == "rate":
            costs = group_costs(self._changes, self._lost_shares, self._rule.hierarchical)
            count = first_length(costs, self._rule.min_length)
        group = _closed(self._waiting[:count], self._tracker)
        others = self._waiting[count:]
        self._waiting, self._changes, self._lost_shares = [], [], []
        for frame in others:
            self._tracker.step(frame.luma)
            self._wait(frame)
        return group


def _closed(waiting: list[Frame], tracker: PointTracker) -> Group:
    path = tracker.path(len(waiting) + 1)
    tracks = tracker.close([frame.luma for frame in waiting])
    return Group(tuple(waiting[:-1]), waiting[-1], tracks, path=path)


def _is_cut(tracker: PointTracker, rule: KeyFrameRule) -> bool:
    return tracker.last_lost_share >= rule.cut_share


def _is_due(current: int, length: int, tracker: PointTracker, rule: KeyFrameRule) -> bool:
    if current >= length or _is_cut(tracker, rule):
        return True
    if current < rule.min_length:
        return False
    return tracker.longest_px >= rule.longest_track_px or tracker.lost_share >= rule.lost_share
