"""Open videos: raw files and folders of images here, everything else through FFmpeg."""

import re
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dvc.errors import VideoError
from dvc.video.containers import consistent_frames, open_container, read_image
from dvc.video.frames import Frame, VideoInfo, VideoReader, check_size, chroma_shape, exact_frame_rate
from dvc.video.pixels import conversion_notices, is_full_range
from dvc.video.sources import DEFAULT_FRAME_RATE, FrameStream, Request

RAW_SUFFIXES = frozenset({".yuv", ".raw"})
IMAGE_SUFFIXES = frozenset(
    {
        ".png",
        ".jpg",
        ".jpeg",
        ".tif",
        ".tiff",
        ".bmp",
        ".pbm",
        ".pgm",
        ".ppm",
        ".pnm",
        ".webp",
        ".tga",
        ".jp2",
    }
)


def open_video(
    path: str | Path,
    *,
    size: tuple[int, int] | None = None,
    frame_rate: Fraction | float | None = None,
    start: int = 0,
    num_frames: int | None = None,
) -> VideoReader:
    """Open a video for reading, whatever it is; one frame at a time is held in memory.

    A folder is read as images in natural order (``2.png`` before ``10.png``); ``.yuv`` and ``.raw`` are
    planar 8-bit 4:2:0 with odd sides rounded up for chroma; anything else goes to FFmpeg, and its first video
    stream is taken. Grey sources give frames without chroma.

    A damaged or cut file gives its frames up to the damage, and then `VideoError`; a frame that the decoder
    had to conceal is not passed on. (A file without checksums can hide damage; a raw file of the wrong length
    is refused at once, since it most likely has another size.)

    Parameters
    ----------
    path : str or Path
        A file or folder.
    size : tuple of int, optional
        Width and height; needed for raw files, checked for all others.
    frame_rate : Fraction or float, optional
        Frames per second; needed for raw files, 25 by default for images, replaces the rate that any other
        file declares.
    start : int, optional
        Number of frames to skip.
    num_frames : int, optional
        Read at most so many; all if None.

    Returns
    -------
    VideoReader
        Also a context manager; ``info.notices`` says what is converted or assumed.

    Raises
    ------
    VideoError
        If the video cannot be read, has no frames or no more than `start`, or needs `size` or `frame_rate`.
    ValueError
        If `start` is negative, or `num_frames`, `frame_rate` or `size` is not positive.
    """
    if start < 0:
        raise ValueError(f"`start` must not be negative, got {start}")
    if num_frames is not None and num_frames < 1:
        raise ValueError(f"`num_frames` must be positive, got {num_frames}")
    if size is not None and min(size) < 1:
        raise ValueError(f"`size` must be positive, got {size}")
    rate = None if frame_rate is None else exact_frame_rate(frame_rate)
    request = Request(Path(path), size, rate, start, num_frames)
    if not request.path.exists():
        raise VideoError(f"{path}: no such file or folder")
    if request.path.is_dir():
        return _open_folder(request)
    if request.path.suffix.lower() in RAW_SUFFIXES:
        return _open_raw(request)
    return open_container(request)


def _open_raw(request: Request) -> FrameStream:
    """Open a headerless file of planar 4:2:0 frames."""
    path = request.path
    if request.size is None or request.frame_rate is None:
        raise VideoError(f"{path}: a raw file needs the size of its pictures and the frame rate")
    width, height = request.size
    check_size(width, height, str(path))
    rows, columns = chroma_shape(height, width)
    frame_bytes = width * height + 2 * rows * columns
    try:
        file_bytes = path.stat().st_size
        file = path.open("rb")
    except OSError as err:
        raise VideoError(f"{path}: cannot be read ({err.strerror})") from err
    try:
        if file_bytes % frame_bytes:
            raise VideoError(
                f"{path}: {file_bytes} bytes are not a whole number of {width}x{height} 4:2:0 frames "
                f"({frame_bytes} bytes each)"
            )
        count = request.count_of(file_bytes // frame_bytes)
        file.seek(request.start * frame_bytes)
    except BaseException:
        file.close()
        raise
    info = VideoInfo(width, height, request.frame_rate, count)
    return FrameStream(info, _raw_frames(file, info, path), file.close)


def _raw_frames(file: BinaryIO, info: VideoInfo, path: Path) -> Iterator[Frame]:
    """Read planes one after the other; close the file at the end."""
    rows, columns = chroma_shape(info.height, info.width)
    luma_bytes, chroma_bytes = info.width * info.height, rows * columns
    with file:
        for index in range(info.num_frames or 0):
            try:
                data = np.fromfile(file, np.uint8, luma_bytes + 2 * chroma_bytes)
            except OSError as err:
                raise VideoError(f"{path}: damaged after {index} frames ({err.strerror})") from err
            if data.size != luma_bytes + 2 * chroma_bytes:
                raise VideoError(f"{path}: damaged after {index} frames (the file ends within a frame)")
            luma, cb, cr = np.split(data, [luma_bytes, luma_bytes + chroma_bytes])
            chroma = (cb.reshape(rows, columns), cr.reshape(rows, columns))
            yield Frame(luma.reshape(info.height, info.width), chroma)


def _open_folder(request: Request) -> FrameStream:
    """Open a folder of images."""
    try:
        entries = list(request.path.iterdir())
    except OSError as err:
        raise VideoError(f"{request.path}: cannot be read ({err.strerror})") from err
    images = [f for f in entries if f.suffix.lower() in IMAGE_SUFFIXES and not f.name.startswith(".")]
    count = request.count_of(len(images), "images")
    chosen = sorted(images, key=_natural_key)[request.start : request.start + count]
    first = read_image(chosen[0])
    notices = conversion_notices(first)
    if request.frame_rate is None:
        notices += (f"images have no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed",)
    info = VideoInfo(
        width=first.width,
        height=first.height,
        frame_rate=request.frame_rate or DEFAULT_FRAME_RATE,
        num_frames=count,
        notices=notices,
        full_range=is_full_range(first),
    )
    request.check_size(info)
    pictures = chain([(chosen[0], first)], ((f, read_image(f)) for f in chosen[1:]))
    return FrameStream(info, consistent_frames(pictures, info), lambda: None)


def _natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Order names with the numbers in them as numbers."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts]
