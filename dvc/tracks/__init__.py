"""Feature points and point tracks: what the encoder tells the decoder of the geometry, and its coding."""

from dvc.tracks.coding import (
    decode_points,
    decode_tracks,
    encode_points,
    encode_tracks,
)
from dvc.tracks.points import FeaturePoints, PointTracks

__all__ = [
    "FeaturePoints",
    "PointTracks",
    "decode_points",
    "decode_tracks",
    "encode_points",
    "encode_tracks",
]
