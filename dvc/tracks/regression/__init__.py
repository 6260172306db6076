"""Coding of point tracks by the motion of all tracks of an instant that are coded so far."""

from dvc.tracks.regression.regression_coding import code_tracks

__all__ = ["code_tracks"]
