"""Frames, and reading and writing them as video files."""

from dvc.video.frames import (
    Frame,
    TimeStamp,
    VideoInfo,
    chroma_shape,
    exact_frame_rate,
)
from dvc.video.readers import open_video
from dvc.video.sources import VideoReader
from dvc.video.writers import VideoWriter, check_suffix, create_video, pad_frame

__all__ = [
    "Frame",
    "TimeStamp",
    "VideoInfo",
    "VideoReader",
    "VideoWriter",
    "check_suffix",
    "chroma_shape",
    "create_video",
    "exact_frame_rate",
    "open_video",
    "pad_frame",
]
