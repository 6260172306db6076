"""Read videos as a stream of frames: containers, raw files and folders of images."""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from dvc.errors import VideoError
from dvc.video.frames import Frame, VideoInfo, VideoReader, check_size, chroma_shape
from dvc.video.pixels import conversion_notices, frame_from_picture, is_full_range

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream

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
DEFAULT_FRAME_RATE = Fraction(25)

_MAX_DAMAGE_CHECK = "crccheck+bitstream+buffer+explode"


@dataclass(frozen=True)
class _Wanted:
    """What part of a video the caller asked for, and what he knows of it."""

    path: Path
    size: tuple[int, int] | None
    frame_rate: Fraction | None
    start: int
    num_frames: int | None


class _FrameStream:
    """The one `VideoReader` behind all sources: information, an iterator of frames, something to close."""

    def __init__(self, info: VideoInfo, frames: Iterator[Frame], close: Callable[[], None]) -> None:
        self.info = info
        self._frames = frames
        self._close = close

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames that have not been read yet."""
        return self._frames

    def close(self) -> None:
        """Release the source; no frame comes after that."""
        self._frames = iter(())
        self._close()

    def __enter__(self) -> Self:
        """Return the reader."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the reader."""
        self.close()


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

    A damaged or cut file gives its frames up to the damage, and then `VideoError`: a frame that the decoder
    had to conceal is never passed on.

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
        Also a context manager.

    Raises
    ------
    VideoError
        If the video cannot be read, has no frames or fewer than `start` + 1, or needs `size` or `frame_rate`.
    ValueError
        If `start` is negative, or `num_frames`, `frame_rate` or `size` is not positive.
    """
    if start < 0:
        raise ValueError(f"`start` must not be negative, got {start}")
    if num_frames is not None and num_frames < 1:
        raise ValueError(f"`num_frames` must be positive, got {num_frames}")
    if frame_rate is not None and not 0 < frame_rate < 2**31:
        raise ValueError(f"`frame_rate` must be positive, got {frame_rate}")
    if size is not None and min(size) < 1:
        raise ValueError(f"`size` must be positive, got {size}")
    rate = None if frame_rate is None else exact_frame_rate(frame_rate)
    wanted = _Wanted(Path(path), size, rate, start, num_frames)
    if not wanted.path.exists():
        raise VideoError(f"{path}: no such file or folder")
    if wanted.path.is_dir():
        return _open_folder(wanted)
    if wanted.path.suffix.lower() in RAW_SUFFIXES:
        return _open_raw(wanted)
    return _open_container(wanted)


def exact_frame_rate(frame_rate: Fraction | float) -> Fraction:
    """Return the rate as a fraction; 29.97 and its kin become the NTSC rates that they stand for.

    Parameters
    ----------
    frame_rate : Fraction or float
        Frames per second.

    Returns
    -------
    Fraction
        Denominator at most 10**6.

    Examples
    --------
    >>> exact_frame_rate(29.97), exact_frame_rate(12.5)
    (Fraction(30000, 1001), Fraction(25, 2))
    """
    if isinstance(frame_rate, float):
        ntsc = Fraction(round(frame_rate) * 1000, 1001)
        if frame_rate != round(frame_rate) and abs(frame_rate - ntsc) < 0.005:
            return ntsc
    return Fraction(frame_rate).limit_denominator(10**6)


def _open_raw(wanted: _Wanted) -> _FrameStream:
    """Open a headerless file of planar 4:2:0 frames."""
    if wanted.size is None or wanted.frame_rate is None:
        raise VideoError(f"{wanted.path}: a raw file needs the size of its pictures and the frame rate")
    width, height = wanted.size
    check_size(width, height, str(wanted.path))
    rows, columns = chroma_shape(height, width)
    frame_bytes = width * height + 2 * rows * columns
    try:
        total, rest = divmod(wanted.path.stat().st_size, frame_bytes)
        file = wanted.path.open("rb")
    except OSError as err:
        raise VideoError(f"{wanted.path}: {err.strerror}") from err
    if rest:
        file.close()
        raise VideoError(
            f"{wanted.path}: {total * frame_bytes + rest} bytes are not a whole number of "
            f"{width}x{height} 4:2:0 frames ({frame_bytes} bytes each)"
        )
    _check_start(wanted, total)
    file.seek(wanted.start * frame_bytes)

    def frames() -> Iterator[Frame]:
        for index in range(count):
            data = np.frombuffer(file.read(frame_bytes), np.uint8)
            if data.size != frame_bytes:
                raise VideoError(f"{wanted.path}: ends in frame {wanted.start + index}")
            luma, cb, cr = np.split(data, [width * height, width * height + rows * columns])
            yield Frame(luma.reshape(height, width), (cb.reshape(rows, columns), cr.reshape(rows, columns)))

    count = _count_to_read(wanted, total)
    return _FrameStream(VideoInfo(width, height, wanted.frame_rate, count), frames(), file.close)


def _open_folder(wanted: _Wanted) -> _FrameStream:
    """Open a folder of images."""
    files = sorted(
        (
            f
            for f in wanted.path.iterdir()
            if f.suffix.lower() in IMAGE_SUFFIXES and not f.name.startswith(".")
        ),
        key=_natural_key,
    )
    _check_start(wanted, len(files), "images")
    count = _count_to_read(wanted, len(files))
    chosen = files[wanted.start : wanted.start + count]
    first = _read_image(chosen[0])
    notices = conversion_notices(first)
    if wanted.frame_rate is None:
        notices += (f"images have no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed",)
    info = VideoInfo(
        first.width,
        first.height,
        wanted.frame_rate or DEFAULT_FRAME_RATE,
        count,
        notices,
        is_full_range(first),
    )
    _check_wanted_size(wanted, info)
    pictures = chain([(chosen[0], first)], ((f, _read_image(f)) for f in chosen[1:]))
    return _FrameStream(info, _consistent_frames(pictures, info), lambda: None)


def _natural_key(path: Path) -> list[tuple[int, int | str]]:
    """Order names with the numbers in them as numbers."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", path.name)]


def _read_image(path: Path) -> "av.VideoFrame":
    """Decode one image file."""
    with _av_errors(path, "cannot be read as an image"):
        container = _av_open(path)
        try:
            for picture in container.decode(video=0):
                check_size(picture.width, picture.height, str(path))
                return picture
        finally:
            container.close()
    raise VideoError(f"{path}: holds no picture")


def _consistent_frames(pictures: Iterable[tuple[Path, "av.VideoFrame"]], info: VideoInfo) -> Iterator[Frame]:
    """Convert pictures, and refuse those that differ from the first in size or in being grey."""
    first: Frame | None = None
    for path, picture in pictures:
        if (picture.width, picture.height) != info.size:
            raise VideoError(
                f"{path}: the picture size changes from {info.width}x{info.height} to "
                f"{picture.width}x{picture.height}"
            )
        frame = frame_from_picture(picture)
        first = first or frame
        if (frame.chroma is None) != (first.chroma is None):
            raise VideoError(f"{path}: grey and colour pictures are mixed")
        yield frame


def _open_container(wanted: _Wanted) -> _FrameStream:
    """Open a file through FFmpeg."""
    path = wanted.path
    with _av_errors(path, "is not a video that FFmpeg can read"):
        container = _av_open(path)
    try:
        stream = _video_stream(container, path)
        pictures = _decoded(container, stream, path)
        first = next(islice(pictures, wanted.start, None), None)
        if first is None:
            raise _too_short(wanted, "frames")
        info = _stream_info(wanted, stream, first)
        _check_wanted_size(wanted, info)
    except BaseException:
        container.close()
        raise
    chosen = islice(chain([first], pictures), wanted.num_frames)
    frames = _consistent_frames(((path, picture) for picture in chosen), info)
    return _FrameStream(info, frames, container.close)


def _av_open(path: Path) -> "InputContainer":
    """Open a local file; what it refers to must be local as well."""
    import av

    options = {"protocol_whitelist": "file"}
    if path.suffix.lower() in IMAGE_SUFFIXES:
        options["pattern_type"] = "none"
    container = av.open(f"file:{os.path.abspath(path)}", options=options)
    if container.format.name == "tty":
        container.close()
        raise VideoError(f"{path}: is a text file, not a video")
    return container


def _video_stream(container: "InputContainer", path: Path) -> "VideoStream":
    """Return the first video stream that is not a cover picture, with strict error detection."""
    import av

    for stream in container.streams.video:
        if not stream.disposition & av.stream.Disposition.attached_pic:
            check_size(max(stream.codec_context.width, 1), max(stream.codec_context.height, 1), str(path))
            stream.codec_context.options = {"err_detect": _MAX_DAMAGE_CHECK}
            stream.thread_type = "AUTO"
            return stream
    raise VideoError(f"{path}: has no video stream")


def _decoded(container: "InputContainer", stream: "VideoStream", path: Path) -> Iterator["av.VideoFrame"]:
    """Yield the pictures of a stream; `VideoError` at the first that is damaged."""
    count = 0
    with _av_errors(path, lambda: f"is damaged after frame {count}" if count else "cannot be decoded"):
        for picture in container.decode(stream):
            if picture.is_corrupt:
                raise VideoError(f"{path}: frame {count} is damaged")
            check_size(picture.width, picture.height, str(path))
            count += 1
            yield picture


def _stream_info(wanted: _Wanted, stream: "VideoStream", first: "av.VideoFrame") -> VideoInfo:
    """Gather what the container and the first picture tell."""
    notices = list(conversion_notices(first))
    declared = stream.average_rate or stream.guessed_rate
    rate = wanted.frame_rate or (Fraction(declared) if declared else DEFAULT_FRAME_RATE)
    if wanted.frame_rate is None and not declared:
        notices.append(f"the file states no frame rate: {DEFAULT_FRAME_RATE} frames per second assumed")
    elif wanted.frame_rate is None and _has_variable_rate(stream):
        notices.append("variable frame rate: frames are taken as they come at the mean rate")
    if (aspect := stream.sample_aspect_ratio) and aspect != 1:
        notices.append(f"pixels are not square ({aspect.numerator}:{aspect.denominator}): taken as they are")
    count = wanted.num_frames
    if stream.frames:
        count = _count_to_read(wanted, stream.frames) if stream.frames > wanted.start else None
    return VideoInfo(first.width, first.height, rate, count, tuple(notices), is_full_range(first))


def _has_variable_rate(stream: "VideoStream") -> bool:
    """Tell whether the mean rate differs from the smallest frame distance by more than rounding."""
    mean, base = stream.average_rate, stream.base_rate
    return bool(mean and base and abs(mean / base - 1) > 0.01)


def _check_start(wanted: _Wanted, total: int, unit: str = "frames") -> None:
    """Refuse an empty source, and a start beyond its end."""
    if total <= wanted.start:
        raise _too_short(wanted, unit, total)


def _too_short(wanted: _Wanted, unit: str, total: int | None = None) -> VideoError:
    """Say that there is nothing to read."""
    if wanted.start == 0:
        return VideoError(f"{wanted.path}: has no {unit}")
    number = f"only {total} {unit}" if total else f"fewer {unit}" if total is None else f"no {unit}"
    return VideoError(f"{wanted.path}: has {number}, cannot start at frame {wanted.start}")


def _count_to_read(wanted: _Wanted, total: int) -> int:
    """Return how many of `total` frames will be read."""
    rest = total - wanted.start
    return rest if wanted.num_frames is None else min(rest, wanted.num_frames)


def _check_wanted_size(wanted: _Wanted, info: VideoInfo) -> None:
    """Refuse a file whose pictures are not of the size that was asked for."""
    if wanted.size not in (None, info.size):
        width, height = wanted.size or info.size
        raise VideoError(f"{wanted.path}: pictures are {info.width}x{info.height}, not {width}x{height}")


@contextmanager
def _av_errors(path: Path, problem: str | Callable[[], str]) -> Iterator[None]:
    """Turn what FFmpeg and the file system raise into one `VideoError`."""
    import av

    try:
        yield
    except (av.FFmpegError, OSError, ValueError) as err:
        text = problem if isinstance(problem, str) else problem()
        reason = getattr(err, "strerror", None) or str(err)
        raise VideoError(f"{path}: {text} ({reason})") from err
