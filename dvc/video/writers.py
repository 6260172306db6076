"""Write videos: y4m and FFV1 without loss, H.264 for players."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast

import numpy as np

from dvc.errors import VideoError
from dvc.files import OutputFile
from dvc.video.frames import Frame, check_frame_rate, check_size, exact_frame_rate
from dvc.video.pixels import picture_from_frame

if TYPE_CHECKING:
    from av import VideoFrame
    from av.video.stream import VideoStream

_LOG = logging.getLogger(__name__)
SUFFIXES = (".y4m", ".mkv", ".mp4")
_TICK_S = Fraction(1, 1000)
"""Smallest distance of two frames that Matroska can resolve."""
_MICROSECOND_S = Fraction(1, 10**6)
_H264_OPTIONS = {"crf": "12", "preset": "medium"}
_MOST_PX_OF_FOUR_SLICES = 1 << 24


class VideoWriter(ABC):
    """A video file in the making: it appears under its name when `close` succeeds, or not at all."""

    def __init__(
        self,
        path: Path,
        output: OutputFile,
        size: tuple[int, int],
        rate: Fraction,
        *,
        luma_only: bool,
        full_range: bool,
        kept: bool,
    ) -> None:
        self._path, self._output, self._size, self._rate = path, output, size, rate
        self._luma_only, self._kept = luma_only, kept
        self._open = True
        self._num_frames = 0
        self._start_s = Fraction(0)  # time of the first frame
        self._last_s = -1 / rate  # time of the last frame, relative to the first
        self._begin(full_range)

    @abstractmethod
    def _begin(self, full_range: bool) -> None:
        """Open the file."""

    @abstractmethod
    def _store(self, frame: Frame, time_s: Fraction | None) -> None:
        """Append a frame, with its time if that deviates from the constant rate."""

    @abstractmethod
    def _finish(self) -> None:
        """Write pending data and close the file."""

    def _discard(self) -> None:
        """Close the file, complete or not."""
        self._finish()

    def write(self, frame: Frame, time_s: Fraction | None = None) -> None:
        """Append a frame of the announced size, with its time if that deviates from the constant rate."""
        if not self._open:
            raise ValueError("`frame` cannot be written: the video is closed")
        if (frame.width, frame.height) != self._size:
            raise ValueError(f"`frame` must be {self._size} pixels, got {(frame.width, frame.height)}")
        planned_s = self._num_frames / self._rate
        if self._num_frames == 0:
            self._start_s = time_s or planned_s
        time_s = planned_s if time_s is None else time_s - self._start_s
        self._last_s = max(time_s, self._last_s + min(1 / self._rate, _TICK_S))
        with self._cleaning_up():
            self._store(frame, None if self._last_s == planned_s else self._last_s)
        self._num_frames += 1

    def close(self) -> None:
        """Finish the file and rename it into place; harmless when repeated."""
        if not self._open:
            return
        with self._cleaning_up():
            if self._num_frames == 0:
                raise VideoError(f"cannot write {self._path}: the video has no frames")
            self._finish()
            self._output.commit()
        self._open = False

    def abort(self) -> None:
        """Discard the written data unless they are to be kept; harmless when repeated."""
        if not self._open:
            return
        self._open = False
        kept = self._kept and self._num_frames > 0
        with suppress(OSError):
            (self._finish if kept else self._discard)()
        with suppress(OSError, VideoError):
            if kept:
                self._output.commit(partial=True)
        self._output.discard()

    @contextmanager
    def _cleaning_up(self) -> Iterator[None]:
        """Abort on any exception, and name the file in errors of the system."""
        try:
            yield
        except OSError as err:
            self.abort()
            raise VideoError(f"cannot write {self._path}: {err.strerror}") from err
        except BaseException:
            self.abort()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def check_suffix(path: str | Path) -> None:
    """Refuse the name of a video with a suffix of no known format.

    Parameters
    ----------
    path : str or Path
        Name of the file.

    Raises
    ------
    VideoError
        If `create_video` would refuse it for its suffix.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise VideoError(
            f"cannot write {path}: the name must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
        )


def create_video(
    path: str | Path,
    size: tuple[int, int],
    frame_rate: Fraction | float,
    *,
    luma_only: bool = False,
    full_range: bool = False,
    kept: bool = False,
) -> VideoWriter:
    """Start a video file; its suffix chooses the format.

    ``.y4m`` is uncompressed and ``.mkv`` is FFV1 level 3 with slice checksums: both give back the very same
    samples and frame rate, for odd sides as well. ``.mp4`` is H.264 (4:2:0, CRF 12), for players: not
    lossless, and odd sides are padded to even ones by repeating the last column or row.

    Parameters
    ----------
    path : str or Path
        Name of the finished file; until `close` it is written under another name in the same folder.
    size : tuple of int
        Width and height in pixels.
    frame_rate : Fraction or float
        Frames per second, stored exactly (29.97 and similar ones as the NTSC rates, see `exact_frame_rate`).
        Frames may be written with times of their own, which ``.y4m`` cannot hold.
    luma_only : bool, optional
        Store grey pictures (in ``.mp4``, neutral chroma); chroma of the frames is left out. Otherwise frames
        without chroma get neutral chroma.
    full_range : bool, optional
        Mark the samples as using 0 to 255 (see `VideoInfo.full_range`).
    kept : bool, optional
        Write to `path` with ``.part`` after it; frames that were written before `abort` stay there as a video
        that players read.

    Returns
    -------
    VideoWriter
        Also a context manager, which aborts when its block is left by an exception.

    Raises
    ------
    VideoError
        If the suffix is unknown, the size too large, the frame rate not between 10**-6 and 10**6, or the file
        cannot be made there.
    ValueError
        If the frame rate is not positive.
    """
    check_suffix(path)
    path = Path(path)
    check_size(*size, str(path))
    if frame_rate > 0:
        check_frame_rate(frame_rate, str(path))
    rate = exact_frame_rate(frame_rate)
    kind = _Y4mWriter if path.suffix.lower() == ".y4m" else _FfmpegWriter
    output = OutputFile(path, VideoError, visible=kept)
    try:
        return kind(path, output, size, rate, luma_only=luma_only, full_range=full_range, kept=kept)
    except BaseException as err:
        output.discard()
        if isinstance(err, OSError):
            raise VideoError(f"cannot write {path}: {err.strerror}") from err
        raise


class _Y4mWriter(VideoWriter):
    """YUV4MPEG2: a text header, then plain planes."""

    def _begin(self, full_range: bool) -> None:
        self._warned = False  # that times are lost
        self._file = self._output.temporary.open("wb")
        (width, height), rate = self._size, self._rate
        colour = "mono" if self._luma_only else "420mpeg2"
        range_tag = "FULL" if full_range else "LIMITED"
        self._file.write(
            f"YUV4MPEG2 W{width} H{height} F{rate.numerator}:{rate.denominator} Ip A1:1 C{colour} "
            f"XCOLORRANGE={range_tag}\n".encode("ascii")
        )

    def _store(self, frame: Frame, time_s: Fraction | None) -> None:
        if time_s is not None and not self._warned:
            self._warned = True
            _LOG.warning("y4m holds no time stamps: frames with times of their own are at the constant rate")
        chroma = () if self._luma_only else frame.with_chroma().chroma or ()
        self._file.write(b"FRAME\n")
        for plane in (frame.luma, *chroma):
            self._file.write(np.ascontiguousarray(plane).data)
        self._file.flush()  # concurrent readers see whole frames

    def _finish(self) -> None:
        self._file.close()


class _FfmpegWriter(VideoWriter):
    """FFV1 in Matroska, or H.264 in MP4."""

    def _begin(self, full_range: bool) -> None:
        import av

        self._lossless = self._path.suffix.lower() == ".mkv"
        self._pixel_format = "gray" if self._luma_only and self._lossless else "yuv420p"
        size, rate, codec, settings = self._size, self._rate, "libx264", _H264_OPTIONS
        if self._lossless:
            codec, settings = "ffv1", {"g": "1"} | _slices(*size)
        # Without "bitexact" the muxers write random identifiers, and two runs would differ.
        options = {"fflags": "+bitexact"} | ({} if self._lossless else {"movflags": "+faststart"})
        options |= {"flush_packets": "1"} if self._kept else {}  # all but the last frame
        with _ffmpeg_errors():
            path, muxer = f"file:{self._output.temporary}", "matroska" if self._lossless else "mp4"
            self._container = av.open(path, "w", format=muxer, container_options=options)
            stream = cast("VideoStream", self._container.add_stream(codec, rate=rate, options=settings))
            stream.width, stream.height = size if self._lossless else (side + side % 2 for side in size)
            stream.pix_fmt = self._pixel_format
            stream.codec_context.color_range = 2 if full_range else 1
            stream.codec_context.thread_count = 1
            stream.time_base = stream.codec_context.time_base = 1 / rate
        self._stream = stream
        # Times of frames with pending packets, without those at the constant rate.
        self._times_s: dict[int, Fraction] = {}

    def _store(self, frame: Frame, time_s: Fraction | None) -> None:
        if self._luma_only:
            frame = frame.without_chroma()
        if not self._lossless:
            frame = pad_frame(frame, 2)
        picture = picture_from_frame(frame, self._pixel_format)
        picture.pts = self._num_frames
        picture.time_base = self._stream.codec_context.time_base
        if time_s is not None:
            self._times_s[self._num_frames] = time_s
        self._encode(picture)

    def _encode(self, picture: "VideoFrame | None") -> None:
        """Encode at the constant rate, and store the packets at the times of their frames."""
        with _ffmpeg_errors():
            for packet in self._stream.encode(picture):
                if self._times_s:
                    numbers = cast("tuple[int, int]", (packet.pts, packet.dts))
                    times_s = [self._times_s.get(number, number / self._rate) for number in numbers]
                    packet.pts, packet.dts = (round(time_s / _MICROSECOND_S) for time_s in times_s)
                    packet.duration = round(1 / self._rate / _MICROSECOND_S)
                    packet.time_base = _MICROSECOND_S
                    for number in [number for number in self._times_s if number < numbers[1]]:
                        del self._times_s[number]
                self._container.mux(packet)

    def _finish(self) -> None:
        with _ffmpeg_errors():
            self._encode(None)
            self._container.close()

    def _discard(self) -> None:
        with _ffmpeg_errors():
            self._container.close()


def _slices(width: int, height: int) -> dict[str, str]:
    """Return the level of FFV1, and a number of slices that FFmpeg takes for pictures of this size."""
    checked = {"level": "3", "slicecrc": "1"}
    if (
        min(width, height) >= 16
        and width % 4 == height % 4 == 0
        and width * height <= _MOST_PX_OF_FOUR_SLICES
    ):
        return {**checked, "slices": "4"}
    if width <= 352 and height <= 288:
        return {**checked, "slices": "1"}
    return checked if min(width, height) >= 16 else {"level": "1"}  # FFmpeg chooses; it cannot divide a strip


@contextmanager
def _ffmpeg_errors() -> Iterator[None]:
    """Convert errors of FFmpeg into OSError; only some of them are of that type."""
    import av

    try:
        yield
    except av.FFmpegError as err:
        raise OSError(err.errno, err.strerror) from err


def pad_frame(frame: Frame, multiple: int) -> Frame:
    """Extend a picture to sides that are multiples of a number, repeating its last column and row.

    Parameters
    ----------
    frame : Frame
        The picture.
    multiple : int
        An even number of pixels.

    Returns
    -------
    Frame
        The picture itself if nothing is missing.
    """
    sides = [-(-side // multiple) * multiple for side in frame.luma.shape]
    if sides == list(frame.luma.shape):
        return frame
    luma, *chroma = (
        np.pad(plane, [(0, size // part - old) for size, old in zip(sides, plane.shape, strict=True)], "edge")
        for plane, part in zip((frame.luma, *(frame.chroma or ())), (1, 2, 2), strict=False)
    )
    return Frame(luma, (chroma[0], chroma[1]) if chroma else None)
