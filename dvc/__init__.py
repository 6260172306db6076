"""Shared library of the distributed video codec: video, stream, key frames, turbo and Wyner-Ziv coding."""

import os

__version__ = "2.0.0.dev0"

MAX_PIXELS = 2**26
"""Largest number of pixels of a picture or a frame."""

# OpenCV reads it once, when it is loaded.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_PIXELS))
