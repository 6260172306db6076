"""Tracks that are worth their bits, and within a budget: a group with more of them keeps the best."""

import math

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.corners import spaced
from dvc.tracks import PointTracks, encode_tracks
from encoder.corners import TRACKED_CORNERS

Floats = NDArray[np.float64]

MIN_TRACKS = 32
"""Tracks that a group keeps at any cost: cameras have eleven unknowns."""
FULL_QP, FULL_PIXELS, FULL_COUNT = 30, 352 * 288, 128
"""Up to this quality, and from this size of frames on, so many tracks are worth their bits."""
NEW_PER_TRACK = 0.375


def worthwhile(tracks: PointTracks, config: CodecConfig) -> PointTracks:
    """Keep tracks that are the farther apart, the coarser the quality is: the more a bit counts."""
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
    """Keep tracks that start at a distance from each other: the longest first, the strongest of these."""
    ordered = positions[_by_lifetime(positions)]
    kept: Floats = ordered[spaced(ordered[:, start], count, distance_px)]
    return kept


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
    """Keep the tracks that tell the most: those that last longest, and of these the first."""
    count = min(count, len(tracks))
    num_backward = count * tracks.num_backward // max(len(tracks), 1)
    forward = _longest(tracks.forward, count - num_backward)
    backward = _longest(tracks.backward, num_backward)
    return PointTracks(np.concatenate([forward, backward]), num_backward)


def _longest(positions: Floats, count: int) -> Floats:
    kept: Floats = positions[np.sort(_by_lifetime(positions)[:count])]
    return kept


def _by_lifetime(positions: Floats) -> NDArray[np.intp]:
    """Return the order of tracks from the longest to the shortest; of equal ones the first comes first."""
    lifetime = np.isfinite(positions[:, :, 0]).sum(axis=1)
    return np.argsort(-lifetime, kind="stable")
