"""Groups of pictures that end when their tracks are long or lost, and tracks that are worth their bits."""

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig, KeyFrameRule
from dvc.corners import spaced
from dvc.tracks import PointTracks, encode_tracks
from dvc.video import Frame
from encoder.corner_detector import TRACKED_CORNERS
from encoder.groups import Group
from encoder.point_tracker import PointTracker
from encoder.spacing import Spacing
from encoder.work import predicted_positions

Floats = NDArray[np.float64]

MIN_TRACKS = 32
"""Number of tracks that a group keeps at any cost: the cameras of two views have eleven unknowns."""
FULL_QP, FULL_PIXELS, FULL_COUNT = 30, 352 * 288, 128
"""Finest QP, frame size and number of tracks that are worth their bits there."""
NEW_PER_TRACK = 0.375


class TrackedGroups:
    """Groups with tracks; with `spacing` they also end if prediction fails."""

    def __init__(
        self,
        config: CodecConfig,
        rule: KeyFrameRule,
        max_tracks_bpp: float,
        tracker: PointTracker,
        spacing: Spacing | None = None,
    ) -> None:
        self._config, self._rule, self._max_tracks_bpp = config, rule, max_tracks_bpp
        self._tracker, self._spacing = tracker, spacing
        self._key: Frame | None = None  # key frame before the waiting ones
        self._waiting: list[Frame] = []

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence; its last frame is always a key frame."""
        tracker, self._key, self._waiting = self._tracker, None, []
        for frame in frames:
            if self._key is None:
                self._key = frame
                yield Group((), frame)
                tracker.start(frame.luma)
                continue
            tracker.step(frame.luma)
            if self._waiting and self._is_cut():
                yield self._close()
                tracker.step(frame.luma)
            self._waiting.append(frame)
            too_far = self._spacing is not None and self._spacing.is_too_far(self._lumas(), tracker)
            if too_far and len(self._waiting) == 2:
                yield Group((), self._waiting.pop(0))
            if too_far or self._is_due():
                yield self._close(begins_scene=self._is_cut())
        if self._waiting:
            yield self._close()

    def payload(self, group: Group) -> bytes:
        """Return the coded tracks that are worth their bits and within the budget."""
        assert group.tracks is not None
        tracks = worthwhile(group.tracks, self._config)
        self._tracker.work.num_positions += predicted_positions(tracks)
        return encode_within_budget(tracks, self._config, self._max_tracks_bpp)

    def _lumas(self) -> list[NDArray[np.uint8]]:
        assert self._key is not None
        return [frame.luma for frame in (self._key, *self._waiting)]

    def _close(self, begins_scene: bool = False) -> Group:
        """Return a group of all waiting frames."""
        (*wyner_ziv, key), self._waiting = self._waiting, []
        tracks = self._tracker.close([frame.luma for frame in (*wyner_ziv, key)])
        self._key = key
        return Group(tuple(wyner_ziv), key, tracks if wyner_ziv else None, begins_scene=begins_scene)

    def _is_cut(self) -> bool:
        return self._tracker.last_lost_share >= self._rule.cut_share

    def _is_due(self) -> bool:
        length, rule, tracker = len(self._waiting), self._rule, self._tracker
        if length >= self._config.gop.length or self._is_cut():
            return True
        if length < rule.min_length:
            return False
        return tracker.longest_px >= rule.longest_track_px or tracker.lost_share >= rule.lost_share


def worthwhile(tracks: PointTracks, config: CodecConfig) -> PointTracks:
    """Keep tracks that are farther apart at coarser qualities: a bit costs more there."""
    qp, num_pixels = config.wyner_ziv.qp, config.video.width * config.video.height
    share = math.sqrt(num_pixels / FULL_PIXELS) * math.exp2((FULL_QP - qp) / 6)
    count = max(round(FULL_COUNT * share), MIN_TRACKS)
    if count >= config.tracks.num_points:
        return tracks
    distance_px = TRACKED_CORNERS.min_distance * math.sqrt(num_pixels / count)
    forward = _spread(tracks.forward, 0, count, distance_px)
    backward = _spread(tracks.backward, -1, int(NEW_PER_TRACK * count), distance_px)
    return PointTracks(np.concatenate([forward, backward]), len(backward))


def _spread(positions: Floats, start: int, count: int, distance_px: float) -> Floats:
    """Keep tracks with starts at a distance from each other: the longest first, the strongest of these."""
    ordered = positions[_by_lifetime(positions)]
    spread: Floats = ordered[spaced(ordered[:, start], count, distance_px)]
    return spread


def encode_within_budget(tracks: PointTracks, config: CodecConfig, max_bpp: float) -> bytes:
    """Encode the tracks of a group, or as many as the budget of the frames between its ends allows."""
    max_bits = max_bpp * config.video.width * config.video.height * (tracks.num_instants - 2)
    payload = encode_tracks(tracks, config)
    while 8 * len(payload) > max_bits and len(tracks) > MIN_TRACKS:
        count = min(int(0.95 * len(tracks) * max_bits / (8 * len(payload))), len(tracks) - 1)
        tracks = thinned(tracks, max(count, MIN_TRACKS))
        payload = encode_tracks(tracks, config)
    return payload


def thinned(tracks: PointTracks, count: int) -> PointTracks:
    """Keep the most informative tracks: those that last longest, and of these the first."""
    count = min(count, len(tracks))
    num_backward = count * tracks.num_backward // max(len(tracks), 1)
    forward = _longest(tracks.forward, count - num_backward)
    backward = _longest(tracks.backward, num_backward)
    return PointTracks(np.concatenate([forward, backward]), num_backward)


def _longest(positions: Floats, count: int) -> Floats:
    longest: Floats = positions[np.sort(_by_lifetime(positions)[:count])]
    return longest


def _by_lifetime(positions: Floats) -> NDArray[np.intp]:
    """Return the order of tracks from the longest to the shortest; equal ones keep their order."""
    lifetime = np.isfinite(positions[:, :, 0]).sum(axis=1)
    return np.argsort(-lifetime, kind="stable")
