"""Tracks within a budget of bits: a group with more of them keeps the best."""

from dvc.config import CodecConfig
from dvc.tracks import PointTracks, encode_tracks
from encoder.tracking import thinned

MIN_TRACKS = 32
"""Tracks that a group keeps at any cost: cameras have eleven unknowns."""


def encode_within_budget(tracks: PointTracks, config: CodecConfig, max_bpp: float) -> bytes:
    """Encode the tracks of a group, or as many of them as the budget allows.

    Parameters
    ----------
    tracks : PointTracks
        Tracks from key frame to key frame.
    config : CodecConfig
        Configuration of the stream.
    max_bpp : float
        Bits that a Wyner-Ziv frame may cost, per pixel.

    Returns
    -------
    bytes
        Payload, of `MIN_TRACKS` tracks at least where there are so many.
    """
    max_bits = max_bpp * config.video.width * config.video.height * (tracks.num_instants - 2)
    payload = encode_tracks(tracks, config)
    while 8 * len(payload) > max_bits and len(tracks) > MIN_TRACKS:
        count = min(int(0.95 * len(tracks) * max_bits / (8 * len(payload))), len(tracks) - 1)
        tracks = thinned(tracks, max(count, MIN_TRACKS))
        payload = encode_tracks(tracks, config)
    return payload
