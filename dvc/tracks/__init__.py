"""Feature points and point tracks: the geometry that the encoder sends, and its coding."""

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
