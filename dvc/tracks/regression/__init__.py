"""Coding of point tracks by the motion of all tracks of an instant, as far as they are known."""

from dvc.tracks.regression.coding import code_tracks

__all__ = ["code_tracks"]
