"""Feature points and point tracks: the geometry that the encoder sends, and its coding."""

from dvc.tracks.coding import (
    decode_points as decode_points,
    decode_tracks as decode_tracks,
    encode_points as encode_points,
    encode_tracks as encode_tracks,
)
from dvc.tracks.points import FeaturePoints as FeaturePoints, PointTracks as PointTracks
