"""Tracks within a budget of bits: a group with more of them keeps the best."""

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.tracks import PointTracks, encode_tracks

Floats = NDArray[np.float64]

MIN_TRACKS = 32
"""Tracks that a group keeps at any cost: cameras have eleven unknowns."""


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
    lifetime = np.isfinite(positions[:, :, 0]).sum(axis=1)
    kept: Floats = positions[np.sort(np.argsort(-lifetime, kind="stable")[:count])]
    return kept
