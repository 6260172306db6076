"""Open videos: raw files and folders of images here, everything else through FFmpeg."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dvc.errors import VideoError
from dvc.files import Closing, natural_key
from dvc.video.containers import (
    consistent_frames,
    is_device,
    open_container,
    open_live,
    open_pipe,
    read_image,
)
from dvc.video.frames import Frame, VideoInfo, VideoReader, check_size, exact_frame_rate
from dvc.video.pixels import conversion_notices, is_full_range, planar_frame, planar_frame_bytes
from dvc.video.sources import (
    DEFAULT_FRAME_RATE,
    STANDARD_INPUT,
    FrameStream,
    Pipe,
    Request,
    is_pipe,
    open_raw_pipe,
)

RAW_FORMAT = "rawvideo"
_ALIASES = {"y4m": "yuv4mpegpipe", "raw": RAW_FORMAT}
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
    input_format: str | None = None,
    timeout_s: float | None = None,
    listen: bool = False,
) -> FrameStream:
    """Open a video of any kind for reading; one frame at a time is held in memory.

    A folder is read as images in natural order (``2.png`` before ``10.png``); ``.yuv`` and ``.raw`` are
    planar 8-bit 4:2:0 with odd sides rounded up for chroma; anything else goes to FFmpeg, and its first video
    stream is taken. Grey sources give frames without chroma.

    Frames have the times that their file or source gives them.

    A damaged or cut file gives its frames up to the damage, and then `VideoError`; a frame that the decoder
    had to conceal is not passed on. (A file without checksums can hide damage; a raw file of the wrong length
    is refused at once, since it most likely has another size.)

    Of a pipe, a device or a network address frames are taken as they come, waiting for each as long as it
    takes. What comes from a pipe is raw if `size` is given and `input_format` is not.

    Parameters
    ----------
    path : str or Path
        A file or folder; ``-`` for standard input; a device (``/dev/video0``) or an address (``rtsp://...``).
    size : tuple of int, optional
        Width and height; required for raw files, checked for all other files.
    frame_rate : Fraction or float, optional
        Frames per second; needed for raw files, 25 by default for images, replaces the rate that any other
        file declares, and the times of its frames.
    start : int, optional
        Number of frames to skip.
    num_frames : int, optional
        Largest number of frames to read; all if None.
    input_format : str, optional
        FFmpeg's name of the format or device (``yuv4mpegpipe`` or ``y4m``, ``mjpeg``, ``v4l2``, ...), where
        neither the name nor the beginning shows it; ``rawvideo`` or ``raw`` for planar 4:2:0.
    timeout_s : float, optional
        Patience with a silent network, in seconds.
    listen : bool, optional
        Wait at the address for the source to connect.

    Returns
    -------
    FrameStream
        A `VideoReader`, and a context manager; ``info.notices`` lists conversions and assumptions.

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
    name = _ALIASES.get(input_format or "", input_format)
    request = Request(Path(path), size, rate, start, num_frames, name, timeout_s, listen)
    if listen and "://" not in str(path):
        raise VideoError(f"{path}: --listen requires an address to which a source can connect")
    if str(path) == STANDARD_INPUT:
        return _open_pipe(request)
    if "://" in str(path) or is_device(request):
        return open_live(replace(request, path=str(path)))
    return _open_path(request, Path(path))


def _open_path(request: Request, path: Path) -> FrameStream:
    """Open a file, a folder or a named pipe."""
    if not path.exists():
        raise VideoError(f"{path}: no such file or folder")
    if path.is_dir():
        return _open_folder(request, path)
    if is_pipe(path):
        return _open_pipe(request)
    if request.input_format == RAW_FORMAT or (
        request.input_format is None and path.suffix.lower() in RAW_SUFFIXES
    ):
        return _open_raw(request, path)
    return open_container(request, path)


def _open_pipe(request: Request) -> FrameStream:
    """Open a pipe: raw frames if their size is given without another format, else any format of FFmpeg."""
    pipe = Pipe(request.path)
    named = replace(request, path=pipe.name)
    is_raw = request.size is not None if request.input_format is None else request.input_format == RAW_FORMAT
    try:
        if is_raw:
            _check_raw(named)
            return open_raw_pipe(named, pipe)
        return open_pipe(named, pipe)
    except BaseException:
        pipe.close()
        raise


def _check_raw(request: Request) -> tuple[int, int, Fraction]:
    """Return width, height and frame rate of raw frames."""
    if request.size is None or request.frame_rate is None:
        raise VideoError(f"{request.path}: raw video requires the size of its pictures and the frame rate")
    check_size(*request.size, str(request.path))
    return *request.size, request.frame_rate


def _open_raw(request: Request, path: Path) -> FrameStream:
    """Open a headerless file of planar 4:2:0 frames."""
    width, height, frame_rate = _check_raw(request)
    frame_bytes = planar_frame_bytes(width, height)
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
    info = VideoInfo(width, height, frame_rate, count)
    return FrameStream(info, _raw_frames(file, info, path), file.close)


def _raw_frames(file: BinaryIO, info: VideoInfo, path: Path) -> Iterator[Frame]:
    """Read planes one after the other; close the file at the end."""
    frame_bytes = planar_frame_bytes(info.width, info.height)
    with file:
        for index in range(info.num_frames or 0):
            try:
                data = np.fromfile(file, np.uint8, frame_bytes)
            except OSError as err:
                raise VideoError(f"{path}: damaged after {index} frames ({err.strerror})") from err
            if data.size != frame_bytes:
                raise VideoError(f"{path}: damaged after {index} frames (the file ends within a frame)")
            yield planar_frame(data, info.width, info.height)


def _open_folder(request: Request, folder: Path) -> FrameStream:
    """Open a folder of images."""
    try:
        entries = list(folder.iterdir())
    except OSError as err:
        raise VideoError(f"{folder}: cannot be read ({err.strerror})") from err
    images = [f for f in entries if f.suffix.lower() in IMAGE_SUFFIXES and not f.name.startswith(".")]
    count = request.count_of(len(images), "images")
    chosen = sorted(images, key=natural_key)[request.start : request.start + count]
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


class FrameLookup(Closing):
    """Finds frames of a file or a folder; in rising order each is decoded once."""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._reader: VideoReader | None = None
        self._frames: Iterator[Frame] = iter(())
        self._next = 0
        self._last: tuple[int, Frame] | None = None

    def __call__(self, number: int) -> Frame:
        """Return a frame by its number from 0."""
        if self._last is not None and self._last[0] == number:
            return self._last[1]
        if self._reader is None or number < self._next:
            self.close()
            self._reader = open_video(self._path, start=number)
            self._frames, self._next = iter(self._reader), number
        for frame in self._frames:
            self._next += 1
            if self._next > number:
                self._last = number, frame
                return frame
        raise VideoError(f"{self._path} has no frame {number}")

    def close(self) -> None:
        """Close the video."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
