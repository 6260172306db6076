"""Groups of pictures: which frames are key frames, and which Wyner-Ziv frames lie between them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from dvc.config import KeyFrameRule
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame
from encoder.corners import CornerDetector
from encoder.spacing import Spacing
from encoder.tracking import PointTracker


@dataclass(frozen=True)
class Group:
    """One group of pictures."""

    wyner_ziv: tuple[Frame, ...]  # frames since the previous key frame, in display order
    key: Frame  # the key frame that ends the group
    # points of the previous key frame, followed to this one, and points of this one, followed back
    tracks: PointTracks | None = None
    points: FeaturePoints | None = None  # corners of the Wyner-Ziv frames
    begins_scene: bool = False  # whether the key frame is the first after a cut


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
    frames: Iterable[Frame],
    length: int,
    tracker: PointTracker,
    rule: KeyFrameRule,
    spacing: Spacing | None = None,
) -> Iterator[Group]:
    """Cut a sequence where its tracks have become long, or are lost; the last frame is always a key frame.

    With `spacing`, it is also cut where prediction does not serve.
    """
    window = _Window(tracker, length, rule, spacing)
    for frame in frames:
        yield from window.take(frame)
    yield from window.flush()


class _Window:
    """Frames since the last key frame, and what their tracks tell."""

    def __init__(
        self, tracker: PointTracker, length: int, rule: KeyFrameRule, spacing: Spacing | None
    ) -> None:
        self._tracker, self._length, self._rule, self._spacing = tracker, length, rule, spacing
        self._key: Frame | None = None  # the last one
        self._waiting: list[Frame] = []

    def take(self, frame: Frame) -> Iterator[Group]:
        tracker = self._tracker
        if self._key is None:
            self._key = frame
            yield Group((), frame)
            tracker.start(frame.luma)
            return
        tracker.step(frame.luma)
        if self._waiting and _is_cut(tracker, self._rule):
            yield from self.flush()
            tracker.step(frame.luma)
        self._waiting.append(frame)
        lumas = [one.luma for one in (self._key, *self._waiting)]
        is_too_far = self._spacing is not None and self._spacing.is_too_far(lumas, tracker)
        if is_too_far and len(self._waiting) == 2:
            yield Group((), self._waiting.pop(0))
        if is_too_far or _is_due(len(self._waiting), self._length, tracker, self._rule):
            yield from self.flush(begins_scene=_is_cut(tracker, self._rule))

    def flush(self, begins_scene: bool = False) -> Iterator[Group]:
        """Close a group of all frames that wait, if there are any."""
        if self._waiting:
            (*wyner_ziv, key), self._waiting = self._waiting, []
            tracks = self._tracker.close([frame.luma for frame in (*wyner_ziv, key)])
            self._key = key
            yield Group(tuple(wyner_ziv), key, tracks if wyner_ziv else None, begins_scene=begins_scene)


def _is_cut(tracker: PointTracker, rule: KeyFrameRule) -> bool:
    return tracker.last_lost_share >= rule.cut_share


def _is_due(current: int, length: int, tracker: PointTracker, rule: KeyFrameRule) -> bool:
    if current >= length or _is_cut(tracker, rule):
        return True
    if current < rule.min_length:
        return False
    return tracker.longest_px >= rule.longest_track_px or tracker.lost_share >= rule.lost_share
