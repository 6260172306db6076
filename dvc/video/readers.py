"""Open videos: raw files and folders of images here, everything else through FFmpeg."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import chain, count, islice
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dvc.errors import VideoError
from dvc.files import Closing, natural_key
from dvc.video.decoding import (
    LOCAL,
    Extent,
    av_errors,
    consistent_frames,
    decoded,
    file_extent,
    open_file,
    read_image,
    refuse_text,
    silence,
    video_stream,
)
from dvc.video.frames import Frame, TimeStamp, VideoInfo, check_frame_rate, check_size, exact_frame_rate
from dvc.video.pixels import conversion_notices, is_full_range, planar_frame, planar_frame_bytes
from dvc.video.sources import (
    DEFAULT_FRAME_RATE,
    STANDARD_INPUT,
    Pipe,
    PipeFeed,
    Request,
    SourceClock,
    VideoReader,
)

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream

_NETWORK = "crypto,http,https,httpproxy,rtmp,rtmps,rtmpt,rtp,rtsp,rtsps,srtp,tcp,tls,udp"
_LONGEST_S = 86400
_VIDEO_DEVICE = "/dev/video"
RAW_FORMAT = "rawvideo"
_ALIASES = {"y4m": "yuv4mpegpipe", "raw": RAW_FORMAT}
RAW_SUFFIXES = frozenset({".yuv", ".raw"})
IMAGE_SUFFIXES = frozenset(
    f".{name}"
    for name in "png jpg jpeg jp2 tif tiff bmp pbm pgm ppm pnm webp tga".split()  # noqa: SIM905
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
) -> VideoReader:
    """Open a video of any kind for reading; one frame at a time is held in memory.

    A folder is read as images in natural order (``2.png`` before ``10.png``); ``.yuv`` and ``.raw`` are
    planar 8-bit 4:2:0 with odd sides rounded up for chroma; anything else goes to FFmpeg, and its first video
    stream is taken. Grey sources give frames without chroma.

    Frames have the times that their file or source gives them.

    A damaged or cut file gives its frames up to the damage, and then `VideoError`; a frame that the decoder
    had to conceal is not passed on. (A file without checksums can hide damage; a raw file of the wrong length
    is refused at once, since it most likely has another size.)

    Frames of a pipe, a device or a network address are read as they arrive, without a limit of time. Those of
    a pipe are raw if `size` is given and `input_format` is not.

    Parameters
    ----------
    path : str or Path
        A file or folder; ``-`` for standard input; a device (``/dev/video0``) or an address (``rtsp://...``).
    size : tuple of int, optional
        Width and height; required for raw files, checked for all other files.
    frame_rate : Fraction or float, optional
        Frames per second; needed for raw files, 25 by default for images; replaces the rate that any other
        file declares, and the times of its frames.
    start : int, optional
        Number of frames to skip.
    num_frames : int, optional
        Largest number of frames to read; all if None.
    input_format : str, optional
        FFmpeg's name of the format or device (``yuv4mpegpipe`` or ``y4m``, ``mjpeg``, ``v4l2``, ...), if
        neither the name nor the beginning shows it; ``rawvideo`` or ``raw`` for planar 4:2:0.
    timeout_s : float, optional
        Patience with a silent network, in seconds.
    listen : bool, optional
        Wait at the address for the source to connect.

    Returns
    -------
    VideoReader
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
    if "://" in str(path) or _is_device(request):
        return _open_live(replace(request, path=str(path)))
    path = Path(path)
    if not path.exists():
        raise VideoError(f"{path}: no such file or folder")
    if path.is_dir():
        return _open_folder(request, path)
    if path.is_fifo() or path.is_socket():
        return _open_pipe(request)
    if name == RAW_FORMAT or (name is None and path.suffix.lower() in RAW_SUFFIXES):
        return _open_pipe(replace(request, input_format=RAW_FORMAT), path.stat().st_size)
    return _frame_stream(request, open_file(path, input_format=name), partial(file_extent, path))


def _open_pipe(request: Request, file_bytes: int | None = None) -> VideoReader:
    """Open a pipe, or a raw file of a known size; a pipe is raw if a size is given without another format."""
    pipe = Pipe(request.path)
    named = replace(request, path=pipe.name)
    is_raw = request.size is not None if request.input_format is None else request.input_format == RAW_FORMAT
    try:
        return _open_raw(named, pipe, file_bytes) if is_raw else _open_piped_format(named, pipe)
    except BaseException:
        pipe.close()
        raise


def _open_raw(request: Request, source: Pipe, file_bytes: int | None = None) -> VideoReader:
    """Read planar 4:2:0 frames of a pipe, or of a file of a known size."""
    if request.size is None or request.frame_rate is None:
        raise VideoError(f"{request.path}: raw video requires the size of its pictures and the frame rate")
    width, height = request.size
    check_size(width, height, str(request.path))
    frame_bytes = planar_frame_bytes(width, height)
    num_frames, first = request.num_frames, 0
    if file_bytes is not None:
        if file_bytes % frame_bytes:
            raise VideoError(
                f"{request.path}: {file_bytes} bytes are not a whole number of {width}x{height} 4:2:0 frames "
                f"({frame_bytes} bytes each)"
            )
        num_frames, first = request.count_of(file_bytes // frame_bytes), request.start
        source.seek(first * frame_bytes)
    info = VideoInfo(width, height, request.frame_rate, num_frames, live=file_bytes is None)
    frames = _raw_frames(request, source, info, first)
    num_skipped = request.start - first
    end = None if num_frames is None else num_skipped + num_frames
    return VideoReader(info, islice(frames, num_skipped, end), source.close)


def _raw_frames(request: Request, source: Pipe, info: VideoInfo, first: int) -> Iterator[Frame]:
    """Read frames from one on; those of a pipe have time stamps. Close the source at the end."""
    frame_bytes = planar_frame_bytes(info.width, info.height)
    with source:
        for index in count(first):
            try:
                data = source.read_fully(frame_bytes)
            except OSError as err:
                message = f"damaged after {index - first} frames ({err.strerror})"
                raise VideoError(f"{request.path}: {message}") from err
            if len(data) < frame_bytes:
                break
            frame = planar_frame(np.frombuffer(data, np.uint8), info.width, info.height)
            time = TimeStamp.nearest(index / info.frame_rate, info.frame_rate.numerator)
            yield replace(frame, time=time) if info.live else frame
    if data or not info.live:
        message = f"ends within frame {index}, after {len(data)} of its {frame_bytes} bytes"
        raise VideoError(f"{request.path}: damaged after {index - first} frames ({message})")
    if index <= request.start:
        raise request.too_short(total=index)


def _open_folder(request: Request, folder: Path) -> VideoReader:
    try:
        entries = list(folder.iterdir())
    except OSError as err:
        raise VideoError(f"{folder}: cannot be read ({err.strerror})") from err
    images = [f for f in entries if f.suffix.lower() in IMAGE_SUFFIXES and not f.name.startswith(".")]
    num_frames = request.count_of(len(images), "images")
    chosen = sorted(images, key=natural_key)[request.start : request.start + num_frames]
    first = read_image(chosen[0])
    notices = conversion_notices(first)
    if request.frame_rate is None:
        notices += (f"images have no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed",)
    info = VideoInfo(
        width=first.width,
        height=first.height,
        frame_rate=request.frame_rate or DEFAULT_FRAME_RATE,
        num_frames=num_frames,
        notices=notices,
        full_range=is_full_range(first),
    )
    request.check_size(info)
    pictures = chain([(chosen[0], first)], ((f, read_image(f)) for f in chosen[1:]))
    return VideoReader(info, consistent_frames(pictures, info), lambda: None)


def _open_live(request: Request) -> VideoReader:
    """Open a device or a network address through FFmpeg, and wait for its first frame."""
    import av

    name, input_format, timeout_s = str(request.path), request.input_format, None
    options = {}
    if "://" in name:
        timeout_s = request.timeout_s
        options["protocol_whitelist"] = _NETWORK  # data from a network must not refer to local files
        if name.startswith("rtsp") and request.listen:  # FFmpeg's default timeout exceeds its range
            options |= {"rtsp_flags": "listen", "listen_timeout": str(ceil(timeout_s or _LONGEST_S))}
        elif name.startswith("rtsp"):
            options["rtsp_transport"] = "tcp"  # over UDP packets get lost
        elif request.listen:
            options["listen"] = "1"
    else:
        input_format = input_format or "v4l2"
        if request.size is not None:
            options["video_size"] = f"{request.size[0]}x{request.size[1]}"
        if request.frame_rate is not None:
            options["framerate"] = str(request.frame_rate)
    with av_errors(name, "is not a video that FFmpeg can read"):
        try:
            container = av.open(name, format=input_format, options=options, timeout=timeout_s)
        except av.error.ExitError as err:
            raise silence(name, timeout_s or 0.0) from err
    refuse_text(container, name)
    return _frame_stream(request, container, None, live=True)


def _open_piped_format(request: Request, pipe: Pipe) -> VideoReader:
    """Open a pipe through FFmpeg, and wait for its first frame."""
    import av

    feed = PipeFeed(pipe)
    with feed.raising():
        with av_errors(pipe.name, "is not a video that FFmpeg can read"):
            container = av.open(feed, "r", format=request.input_format, options=LOCAL)
        refuse_text(container, pipe.name)
        stream = _frame_stream(request, container, pipe.extent, live=True)

    def _frames() -> Iterator[Frame]:
        with feed.raising():
            yield from stream

    def _close() -> None:
        stream.close()
        pipe.close()

    return VideoReader(stream.info, _frames(), _close, stream.clock)


def _is_device(request: Request) -> bool:
    """Return whether frames come from a device, by its name or by FFmpeg's name of its kind."""
    name = request.input_format
    if name is None:
        return str(request.path).startswith(_VIDEO_DEVICE)
    from av import ContainerFormat

    try:
        return bool(ContainerFormat(name, "r").no_file)
    except ValueError as err:
        raise VideoError(f"{request.path}: FFmpeg reads no format {name}") from err


def _frame_stream(
    request: Request, container: "InputContainer", extent: Extent | None, *, live: bool = False
) -> VideoReader:
    """Decode the first frame; return a reader of all requested frames."""
    try:
        stream = video_stream(container, request.path)
        if live:
            stream.thread_type = "SLICE"  # threads for frames would hold some back
        pictures = decoded(container, stream, request.path, extent, request.timeout_s if live else None)
        first = next(islice(pictures, request.start, None), None)
        if first is None:
            raise request.too_short()
        info = _stream_info(request, stream, first, live=live)
        request.check_size(info)
    except BaseException:
        container.close()
        raise
    clock = SourceClock()

    def _pictures() -> Iterator[tuple[Path | str, "av.VideoFrame"]]:
        for picture in islice(chain([first], pictures), request.num_frames):
            if live:
                clock.tick(picture.time, info.frame_rate)
            yield request.path, picture

    timed = request.frame_rate is None or _is_device(request)  # a device may ignore the requested rate
    return VideoReader(info, consistent_frames(_pictures(), info, timed=timed), container.close, clock)


def _stream_info(request: Request, stream: "VideoStream", first: "av.VideoFrame", *, live: bool) -> VideoInfo:
    """Gather the properties of the container and the first picture."""
    notices = list(conversion_notices(first))
    mean, finest = stream.average_rate, stream.base_rate
    declared = mean or stream.guessed_rate
    is_variable = mean and finest and all(abs(finest / mean - factor) > 0.01 for factor in (1, 2))
    if request.frame_rate is None and not declared:
        notices.append(f"the file states no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed")
    elif request.frame_rate is None and is_variable:
        notices.append("variable frame rate: time stamps are kept")
    if (aspect := stream.sample_aspect_ratio) and aspect != 1:
        notices.append(f"pixels are not square ({aspect.numerator}:{aspect.denominator}): taken as they are")
    rate = request.frame_rate or Fraction(declared or DEFAULT_FRAME_RATE)
    check_frame_rate(rate, str(request.path))
    return VideoInfo(
        width=first.width,
        height=first.height,
        frame_rate=rate,
        num_frames=request.count_of(stream.frames) if stream.frames > request.start else None,
        notices=tuple(notices),
        full_range=is_full_range(first),
        live=live,
    )


class FrameLookup(Closing):
    """Finds frames of a file or a folder; in rising order each is decoded once."""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._reader: VideoReader | None = None
        self._number = 0
        self._frame: Frame | None = None  # the last one that was decoded

    def __call__(self, number: int) -> Frame:
        """Return a frame by its number from 0."""
        if self._reader is None or number < self._number:
            self.close()
            self._reader = open_video(self._path, start=number)
            self._number, self._frame = number - 1, None
        while self._frame is None or self._number < number:
            self._frame = next(iter(self._reader), None)
            self._number += 1
            if self._frame is None:
                raise VideoError(f"{self._path} has no frame {number}")
        return self._frame

    def close(self) -> None:
        """Close the video."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
