"""Reading of all formats of FFmpeg, as checked 4:2:0 frames."""

import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import chain, islice
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from dvc.errors import VideoError
from dvc.video.damage import DamageCheck, file_extent
from dvc.video.frames import Frame, TimeStamp, VideoInfo, check_frame_rate, check_size
from dvc.video.pixels import conversion_notices, frame_from_picture, is_full_range
from dvc.video.sources import DEFAULT_FRAME_RATE, Pipe, PipeFeed, Request, SourceClock, VideoReader

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream

Extent = Callable[[], tuple[int, bytes]]

_STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}
# FFmpeg counts every tag that its TIFF decoder does not know as an error.
_STRICT_TIFF = {"err_detect": "crccheck+bitstream+buffer"}
_LOCAL = {"protocol_whitelist": "file"}
_NETWORK = "crypto,http,https,httpproxy,rtmp,rtmps,rtmpt,rtp,rtsp,rtsps,srtp,tcp,tls,udp"
_OVER_TCP = {"rtsp_transport": "tcp"}  # over UDP packets get lost
_LONGEST_S = 86400
_VIDEO_DEVICE = "/dev/video"


def open_container(request: Request, path: Path) -> VideoReader:
    """Open a file through FFmpeg, and decode its first frame to learn its format."""
    container = _open(path, input_format=request.input_format)
    return _frame_stream(request, container, partial(file_extent, path))


def open_live(request: Request) -> VideoReader:
    """Open a device or a network address through FFmpeg, and wait for its first frame."""
    import av

    name = str(request.path)
    with _av_errors(name, "is not a video that FFmpeg can read"):
        try:
            container = _open_address(request, name)
        except av.error.ExitError as err:
            raise _silence(name, request.timeout_s or 0.0) from err
    _refuse_text(container, name)
    return _frame_stream(request, container, None, live=True)


def open_pipe(request: Request, pipe: Pipe) -> VideoReader:
    """Open a pipe through FFmpeg, and wait for its first frame."""
    import av

    feed = PipeFeed(pipe)
    with feed.raising():
        with _av_errors(pipe.name, "is not a video that FFmpeg can read"):
            container = av.open(feed, "r", format=request.input_format, options=_LOCAL)
        _refuse_text(container, pipe.name)
        stream = _frame_stream(request, container, pipe.extent, live=True)

    def _frames() -> Iterator[Frame]:
        with feed.raising():
            yield from stream

    def _close() -> None:
        stream.close()
        pipe.close()

    return VideoReader(stream.info, _frames(), _close, stream.clock)


def is_device(request: Request) -> bool:
    """Return whether frames come from a device, by its name or by FFmpeg's name of its kind."""
    name = request.input_format
    if name is None:
        return str(request.path).startswith(_VIDEO_DEVICE)
    from av import ContainerFormat

    try:
        return bool(ContainerFormat(name, "r").no_file)
    except ValueError as err:
        raise VideoError(f"{request.path}: FFmpeg reads no format {name}") from err


def _open_address(request: Request, name: str) -> "InputContainer":
    """Open a device or an address; data from a network must not refer to local files."""
    import av

    if "://" in name:
        options = {"protocol_whitelist": _NETWORK}
        if name.startswith("rtsp"):
            options |= _listening_rtsp(request.timeout_s) if request.listen else _OVER_TCP
        elif request.listen:
            options["listen"] = "1"
        return av.open(name, format=request.input_format, options=options, timeout=request.timeout_s)
    options = {}
    if request.size is not None:
        options["video_size"] = f"{request.size[0]}x{request.size[1]}"
    if request.frame_rate is not None:
        options["framerate"] = str(request.frame_rate)
    return av.open(name, format=request.input_format or "v4l2", options=options)


def _listening_rtsp(timeout_s: float | None) -> dict[str, str]:
    """Return the options of an RTSP server; FFmpeg's default timeout exceeds its range."""
    return {"rtsp_flags": "listen", "listen_timeout": str(ceil(timeout_s or _LONGEST_S))}


def _frame_stream(
    request: Request, container: "InputContainer", extent: Extent | None, *, live: bool = False
) -> VideoReader:
    """Decode the first frame; return a reader of all requested frames."""
    try:
        stream = _video_stream(container, request.path)
        if live:
            stream.thread_type = "SLICE"  # threads for frames would hold some back
        pictures = _decoded(container, stream, request.path, extent, request.timeout_s if live else None)
        first = next(islice(pictures, request.start, None), None)
        if first is None:
            raise request.too_short()
        info = _stream_info(request, stream, first, live=live)
        request.check_size(info)
    except BaseException:
        container.close()
        raise
    clock = SourceClock()
    chosen: Iterator[av.VideoFrame] = islice(chain([first], pictures), request.num_frames)
    if live:
        chosen = _ticking(chosen, clock, info.frame_rate)
    timed = request.frame_rate is None or is_device(request)  # a device may ignore the requested rate
    frames = consistent_frames(((request.path, picture) for picture in chosen), info, timed=timed)
    return VideoReader(info, frames, container.close, clock)


def _ticking(
    pictures: Iterable["av.VideoFrame"], clock: SourceClock, frame_rate: Fraction
) -> Iterator["av.VideoFrame"]:
    """Show the time stamps of pictures to a clock."""
    for picture in pictures:
        clock.tick(picture.time, frame_rate)
        yield picture


def read_image(path: Path) -> "av.VideoFrame":
    """Decode one image file."""
    # By its name the file would be taken for a pattern of many names.
    container = _open(path, pattern_type="none")
    try:
        pictures = _decoded(container, _video_stream(container, path), path, partial(file_extent, path))
        picture = next(pictures, None)
    finally:
        container.close()
    if picture is None:
        raise VideoError(f"{path}: holds no picture")
    return picture


def consistent_frames(
    pictures: Iterable[tuple[Path | str, "av.VideoFrame"]], info: VideoInfo, *, timed: bool = False
) -> Iterator[Frame]:
    """Convert pictures, with or without their times; refuse changes of size and of colour to grey."""
    is_grey: bool | None = None
    for path, picture in pictures:
        if (picture.width, picture.height) != info.size:
            raise VideoError(
                f"{path}: the picture size changes from {info.width}x{info.height} to "
                f"{picture.width}x{picture.height}"
            )
        with _av_errors(path, f"the pixel format {picture.format.name} cannot be converted"):
            frame = frame_from_picture(picture)
        if is_grey not in (None, frame.chroma is None):
            raise VideoError(f"{path}: grey and colour pictures are mixed")
        is_grey = frame.chroma is None
        yield replace(frame, time=_time_stamp(picture)) if timed else frame


def _time_stamp(picture: "av.VideoFrame") -> TimeStamp | None:
    """Return the display time of a picture by the clock of its stream."""
    if picture.pts is None or picture.time_base is None:
        return None
    return TimeStamp.nearest(picture.pts * picture.time_base, picture.time_base.denominator)


def _open(path: Path, input_format: str | None = None, **options: str) -> "InputContainer":
    """Open a local file; it may refer to local files only."""
    import av

    with _av_errors(path, "is not a video that FFmpeg can read"):
        container = av.open(
            f"file:{os.path.abspath(path)}", format=input_format, options={**_LOCAL, **options}
        )
    _refuse_text(container, path)
    return container


def _refuse_text(container: "InputContainer", path: Path | str) -> None:
    """Refuse text, which FFmpeg would draw."""
    if container.format.name == "tty":
        container.close()
        raise VideoError(f"{path}: is a text file, not a video")


def _video_stream(container: "InputContainer", path: Path | str) -> "VideoStream":
    """Return the first video stream except cover pictures, with strict error detection."""
    from av.stream import Disposition

    for stream in container.streams.video:
        if not stream.disposition & Disposition.attached_pic:
            context = stream.codec_context
            if context is None:
                raise VideoError(f"{path}: is coded in a way that FFmpeg does not know")
            check_size(max(context.width, 1), max(context.height, 1), str(path))
            context.options = dict(_STRICT_TIFF if context.name == "tiff" else _STRICT)
            stream.thread_type = "AUTO"
            return stream
    raise VideoError(f"{path}: has no video stream")


def _decoded(
    container: "InputContainer",
    stream: "VideoStream",
    path: Path | str,
    extent: Extent | None,
    timeout_s: float | None = None,
) -> Iterator["av.VideoFrame"]:
    """Yield the pictures of a stream; `VideoError` after the last one before any damage."""
    count = 0
    problem: str | None = None
    check = DamageCheck(extent, container, stream)
    with _av_errors(path, lambda: f"damaged after {count} frames" if count else "cannot be decoded"):
        for packet in _in_time(container.demux(stream), path, timeout_s):
            problem = check.packet(packet) if packet.size else check.end()
            for picture in stream.decode(None if problem else packet):
                if picture.is_corrupt:
                    raise VideoError(f"{path}: damaged after {count} frames (the next one is incomplete)")
                check_size(picture.width, picture.height, str(path))
                count += 1
                yield picture
            if problem:
                raise VideoError(f"{path}: damaged after {count} frames ({problem})")


def _in_time(
    packets: Iterator["av.Packet[VideoStream]"], path: Path | str, timeout_s: float | None
) -> Iterator["av.Packet[VideoStream]"]:
    """Yield packets; report a timeout, which FFmpeg returns as an end or as various errors."""
    import av

    while True:
        asked_s = time.monotonic()
        failure, packet = None, None
        try:
            packet = next(packets, None)
        except av.FFmpegError as err:
            failure = err
        if timeout_s is not None and time.monotonic() - asked_s >= timeout_s:
            raise _silence(path, timeout_s) from failure
        if failure is not None:
            raise failure
        if packet is None:
            return
        yield packet


def _silence(path: Path | str, timeout_s: float) -> VideoError:
    return VideoError(f"{path}: nothing came for {timeout_s:g} s")


def _stream_info(request: Request, stream: "VideoStream", first: "av.VideoFrame", *, live: bool) -> VideoInfo:
    """Gather the properties of the container and the first picture."""
    notices = list(conversion_notices(first))
    declared = stream.average_rate or stream.guessed_rate
    if request.frame_rate is None and not declared:
        notices.append(f"the file states no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed")
    elif request.frame_rate is None and _has_variable_rate(stream):
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


def _has_variable_rate(stream: "VideoStream") -> bool:
    """Return whether the mean rate differs from the finest one by more than rounding."""
    mean, finest = stream.average_rate, stream.base_rate
    return bool(mean and finest and all(abs(finest / mean - factor) > 0.01 for factor in (1, 2)))


@contextmanager
def _av_errors(path: Path | str, problem: str | Callable[[], str]) -> Iterator[None]:
    """Convert errors of FFmpeg and the file system into `VideoError`."""
    import av

    try:
        yield
    except (av.FFmpegError, OSError, ValueError) as err:
        text = problem if isinstance(problem, str) else problem()
        raise VideoError(f"{path}: {text} ({getattr(err, 'strerror', None) or err})") from err
