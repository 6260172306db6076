"""Frames, and reading and writing them as video files."""

from dvc.video.frames import (
    Frame as Frame,
    TimeStamp as TimeStamp,
    VideoInfo as VideoInfo,
    chroma_shape as chroma_shape,
    exact_frame_rate as exact_frame_rate,
)
from dvc.video.readers import open_video as open_video
from dvc.video.sources import VideoReader as VideoReader
from dvc.video.writers import (
    VideoWriter as VideoWriter,
    check_suffix as check_suffix,
    create_video as create_video,
    pad_frame as pad_frame,
)
