"""Groups of pictures at a fixed distance of key frames, or that end when their tracks are long or lost.

Tracks are sent only if they are worth their bits, and within a budget.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from dvc.arrays import Floats, Integers
from dvc.config import CodecConfig, KeyFrameRule
from dvc.corners import spaced
from dvc.tracks import FeaturePoints, PointTracks, encode_points, encode_tracks
from dvc.video import Frame
from encoder.corner_detector import TRACKED_CORNERS, CornerDetector
from encoder.encoder_report import TrackingWork, predicted_positions
from encoder.point_tracker import PointTracker
from encoder.spacing import Spacing

MIN_TRACKS = 32
"""Number of tracks that a group keeps at any cost: the cameras of two views have eleven unknowns."""
FULL_QP, FULL_PIXELS, FULL_COUNT = 30, 352 * 288, 128
"""Finest QP, frame size and number of tracks that are worth their bits there."""
NEW_PER_TRACK = 0.375


@dataclass(frozen=True)
class Group:
    """One group of pictures."""

    wyner_ziv: tuple[Frame, ...]  # frames since the previous key frame, in display order
    key: Frame  # the key frame that ends the group
    # points of the previous key frame tracked to this one, and points of this one tracked back
    tracks: PointTracks | None = None
    points: FeaturePoints | None = None  # corners of the Wyner-Ziv frames
    begins_scene: bool = False  # whether the key frame is the first one after a cut


class FixedGroups:
    """Groups at a fixed distance of key frames, without points."""

    def __init__(self, length: int) -> None:
        self._length = length

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence; its last frame is always a key frame."""
        waiting: list[Frame] = []
        for index, frame in enumerate(frames):
            if index % self._length == 0:
                yield Group(tuple(waiting), frame)
                waiting = []
            else:
                waiting.append(frame)
        if waiting:
            yield Group(tuple(waiting[:-1]), waiting[-1])

    def payload(self, group: Group) -> bytes:
        """Return the coded points of a group with Wyner-Ziv frames: none."""
        del group
        return b""


class CornerGroups(FixedGroups):
    """Groups at a fixed distance of key frames, with the corners of their Wyner-Ziv frames."""

    def __init__(self, config: CodecConfig, work: TrackingWork) -> None:
        super().__init__(config.gop.length)
        self._config, self._detector = config, CornerDetector(config.tracks.num_points, work=work)

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence."""
        for group in super().groups(frames):
            yield replace(group, points=self._detector.detect([frame.luma for frame in group.wyner_ziv]))

    def payload(self, group: Group) -> bytes:
        """Return the coded corners."""
        assert group.points is not None
        return encode_points(group.points, self._config)


class TrackedGroups(FixedGroups):
    """Groups with tracks; with `spacing` they also end if prediction fails."""

    def __init__(
        self,
        config: CodecConfig,
        rule: KeyFrameRule,
        max_tracks_bpp: float,
        tracker: PointTracker,
        spacing: Spacing | None = None,
    ) -> None:
        super().__init__(config.gop.length)
        self._config, self._rule, self._max_tracks_bpp = config, rule, max_tracks_bpp
        self._tracker, self._spacing = tracker, spacing

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence."""
        tracker, rule, source = self._tracker, self._rule, iter(frames)
        if (first := next(source, None)) is None:
            return
        yield Group((), first)
        tracker.start(first.luma)
        self._key, self._waiting = first, list[Frame]()  # the last key frame, and frames since
        for frame in source:
            tracker.step(frame.luma)
            if self._waiting and self._is_cut():
                yield self._close()
                tracker.step(frame.luma)
            self._waiting.append(frame)
            lumas = [waiting.luma for waiting in (self._key, *self._waiting)]
            too_far = self._spacing is not None and self._spacing.is_too_far(lumas, tracker)
            if too_far and len(self._waiting) == 2:
                yield Group((), self._waiting.pop(0))
            length, is_cut = len(self._waiting), self._is_cut()
            is_long = tracker.longest_px >= rule.longest_track_px or tracker.lost_share >= rule.lost_share
            if too_far or is_cut or length >= min(self._length, rule.min_length if is_long else self._length):
                yield self._close(begins_scene=is_cut)
        if self._waiting:
            yield self._close()

    def payload(self, group: Group) -> bytes:
        """Return the coded tracks that are worth their bits, or as many as the budget allows."""
        assert group.tracks is not None
        config, tracks = self._config, worthwhile(group.tracks, self._config)
        self._tracker.work.num_positions += predicted_positions(tracks)
        max_bits = self._max_tracks_bpp * config.video.width * config.video.height
        max_bits *= tracks.num_instants - 2
        payload = encode_tracks(tracks, config)
        while 8 * len(payload) > max_bits and len(tracks) > MIN_TRACKS:
            count = min(int(0.95 * len(tracks) * max_bits / (8 * len(payload))), len(tracks) - 1)
            tracks = thinned(tracks, max(count, MIN_TRACKS))
            payload = encode_tracks(tracks, config)
        return payload

    def _close(self, begins_scene: bool = False) -> Group:
        """Return a group of all waiting frames."""
        *wyner_ziv, key = self._waiting
        self._key, self._waiting = key, []
        tracks = self._tracker.close([frame.luma for frame in (*wyner_ziv, key)])
        return Group(tuple(wyner_ziv), key, tracks if wyner_ziv else None, begins_scene=begins_scene)

    def _is_cut(self) -> bool:
        return self._tracker.last_lost_share >= self._rule.cut_share


def worthwhile(tracks: PointTracks, config: CodecConfig) -> PointTracks:
    """Keep tracks that are worth their bits, farther apart at coarser qualities; the longest come first."""
    qp, num_pixels = config.wyner_ziv.qp, config.video.width * config.video.height
    share = math.sqrt(num_pixels / FULL_PIXELS) * math.exp2((FULL_QP - qp) / 6)
    count = max(round(FULL_COUNT * share), MIN_TRACKS)
    if count >= config.tracks.num_points:
        return tracks
    distance_px = TRACKED_CORNERS.min_distance * math.sqrt(num_pixels / count)
    forward, backward = (some[_by_lifetime(some)] for some in (tracks.forward, tracks.backward))
    forward = forward[spaced(forward[:, 0], count, distance_px)]
    backward = backward[spaced(backward[:, -1], int(NEW_PER_TRACK * count), distance_px)]
    return PointTracks(np.concatenate([forward, backward]), len(backward))


def thinned(tracks: PointTracks, count: int) -> PointTracks:
    """Keep the most informative tracks: those that last longest, and of these the first."""
    count = min(count, len(tracks))
    num_backward = count * tracks.num_backward // max(len(tracks), 1)
    pairs = (tracks.forward, count - num_backward), (tracks.backward, num_backward)
    longest = [some[np.sort(_by_lifetime(some)[:number])] for some, number in pairs]
    return PointTracks(np.concatenate(longest), num_backward)


def _by_lifetime(positions: Floats) -> Integers:
    """Return the order of tracks from the longest to the shortest; equal ones keep their order."""
    return np.argsort(-np.isfinite(positions[:, :, 0]).sum(axis=1), kind="stable")
