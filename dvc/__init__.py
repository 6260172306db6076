"""Shared library of the distributed video codec: video, stream, key frames, turbo and Wyner-Ziv coding."""

__version__ = "2.0.0.dev0"
