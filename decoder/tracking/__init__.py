"""Tracking at the decoder: points received for each frame become tracks between two key frames."""

from decoder.tracking.matching import TrackingSettings, match_points

__all__ = ["TrackingSettings", "match_points"]
