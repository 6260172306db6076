"""Read whatever FFmpeg opens, as checked 4:2:0 frames."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING

from dvc.errors import VideoError
from dvc.video.damage import DamageCheck
from dvc.video.frames import Frame, VideoInfo, check_size
from dvc.video.pixels import conversion_notices, frame_from_picture, is_full_range
from dvc.video.sources import DEFAULT_FRAME_RATE, FrameStream, Request

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream

_STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}
# FFmpeg counts every tag that its TIFF decoder does not know as an error.
_STRICT_TIFF = {"err_detect": "crccheck+bitstream+buffer"}


def open_container(request: Request) -> FrameStream:
    """Open a file through FFmpeg; its first frame is decoded to learn what the file holds.

    Parameters
    ----------
    request : Request
        The file, and what to read of it.

    Returns
    -------
    FrameStream
        The reader.

    Raises
    ------
    VideoError
        If the file is not a video, cannot be decoded, or has too few frames.
    """
    path = request.path
    container = _open(path)
    try:
        stream = _video_stream(container, path)
        pictures = _decoded(container, stream, path)
        first = next(islice(pictures, request.start, None), None)
        if first is None:
            raise request.too_short()
        info = _stream_info(request, stream, first)
        request.check_size(info)
    except BaseException:
        container.close()
        raise
    chosen = islice(chain([first], pictures), request.num_frames)
    return FrameStream(info, consistent_frames(((path, p) for p in chosen), info), container.close)


def read_image(path: Path) -> "av.VideoFrame":
    """Decode one image file.

    Parameters
    ----------
    path : Path
        Any image that FFmpeg knows.

    Returns
    -------
    av.VideoFrame
        The picture as it was stored.

    Raises
    ------
    VideoError
        If the file cannot be decoded.
    """
    # By its name the file would be taken for a pattern of many names.
    container = _open(path, pattern_type="none")
    try:
        picture = next(_decoded(container, _video_stream(container, path), path), None)
    finally:
        container.close()
    if picture is None:
        raise VideoError(f"{path}: holds no picture")
    return picture


def consistent_frames(pictures: Iterable[tuple[Path, "av.VideoFrame"]], info: VideoInfo) -> Iterator[Frame]:
    """Convert pictures, and refuse those that differ from the first in size or in being grey.

    Parameters
    ----------
    pictures : iterable of Path and av.VideoFrame
        Where each comes from, and what was decoded.
    info : VideoInfo
        What was announced.

    Yields
    ------
    Frame
        One per picture.

    Raises
    ------
    VideoError
        If a picture differs.
    """
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
        yield frame


def _open(path: Path, **options: str) -> "InputContainer":
    """Open a local file; what it refers to must be local as well."""
    import av

    with _av_errors(path, "is not a video that FFmpeg can read"):
        container = av.open(
            f"file:{os.path.abspath(path)}", options={"protocol_whitelist": "file", **options}
        )
    if container.format.name == "tty":
        container.close()
        raise VideoError(f"{path}: is a text file, not a video")
    return container


def _video_stream(container: "InputContainer", path: Path) -> "VideoStream":
    """Return the first video stream that is not a cover picture, with strict error detection."""
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


def _decoded(container: "InputContainer", stream: "VideoStream", path: Path) -> Iterator["av.VideoFrame"]:
    """Yield the pictures of a stream; `VideoError` after the last one before any damage."""
    count = 0
    problem: str | None = None
    check = DamageCheck(path, container, stream)
    with _av_errors(path, lambda: f"damaged after {count} frames" if count else "cannot be decoded"):
        for packet in container.demux(stream):
            problem = check.packet(packet) if packet.size else check.end()
            for picture in stream.decode(None if problem else packet):
                if picture.is_corrupt:
                    raise VideoError(f"{path}: damaged after {count} frames (the next one is incomplete)")
                check_size(picture.width, picture.height, str(path))
                count += 1
                yield picture
            if problem:
                raise VideoError(f"{path}: damaged after {count} frames ({problem})")


def _stream_info(request: Request, stream: "VideoStream", first: "av.VideoFrame") -> VideoInfo:
    """Gather what the container and the first picture tell."""
    notices = list(conversion_notices(first))
    declared = stream.average_rate or stream.guessed_rate
    if request.frame_rate is None and not declared:
        notices.append(f"the file states no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed")
    elif request.frame_rate is None and _has_variable_rate(stream):
        notices.append("variable frame rate: frames are taken as they come at the mean rate")
    if (aspect := stream.sample_aspect_ratio) and aspect != 1:
        notices.append(f"pixels are not square ({aspect.numerator}:{aspect.denominator}): taken as they are")
    return VideoInfo(
        width=first.width,
        height=first.height,
        frame_rate=request.frame_rate or Fraction(declared or DEFAULT_FRAME_RATE),
        num_frames=request.count_of(stream.frames) if stream.frames > request.start else None,
        notices=tuple(notices),
        full_range=is_full_range(first),
    )


def _has_variable_rate(stream: "VideoStream") -> bool:
    """Tell whether the mean rate differs from the finest one by more than rounding.

    A finest rate of just twice the mean is the field rate, which H.264 counts in.
    """
    mean, finest = stream.average_rate, stream.base_rate
    return bool(mean and finest and all(abs(finest / mean - factor) > 0.01 for factor in (1, 2)))


@contextmanager
def _av_errors(path: Path, problem: str | Callable[[], str]) -> Iterator[None]:
    """Turn what FFmpeg and the file system raise into one `VideoError`."""
    import av

    try:
        yield
    except (av.FFmpegError, OSError, ValueError) as err:
        text = problem if isinstance(problem, str) else problem()
        raise VideoError(f"{path}: {text} ({getattr(err, 'strerror', None) or err})") from err
