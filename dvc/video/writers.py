"""Write videos: y4m and FFV1 without loss, H.264 for looking at."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, cast

import numpy as np

from dvc.errors import VideoError
from dvc.files import OutputFile
from dvc.video.frames import Frame, Plane, VideoWriter, check_frame_rate, check_size, exact_frame_rate
from dvc.video.pixels import picture_from_frame

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.video.stream import VideoStream

_LOG = logging.getLogger(__name__)
SUFFIXES = (".y4m", ".mkv", ".mp4")


class _Sink(Protocol):
    """Stores frames in one format; knows nothing of names and renaming."""

    def write(self, frame: Frame, time_s: Fraction | None) -> None:
        """Append a frame, with its time if that deviates from the constant rate."""

    def finish(self) -> None:
        """Write pending data and close the file."""

    def discard(self) -> None:
        """Close the file, complete or not."""


class _AtomicWriter:
    """The one `VideoWriter`: checks frames, hands them to a sink, renames the file or removes it."""

    def __init__(
        self,
        path: str | Path,
        output: OutputFile,
        sink: _Sink,
        size: tuple[int, int],
        interval_s: Fraction,
        *,
        kept: bool,
    ) -> None:
        self._kept = kept
        self._path = path
        self._output = output
        self._sink = sink
        self._size = size
        self._open = True
        self._num_frames = 0
        self._interval_s = interval_s
        self._start_s, self._last_s = (
            Fraction(0),
            -interval_s,
        )  # time of the first frame; of the last after it

    def write(self, frame: Frame, time_s: Fraction | None = None) -> None:
        """Append a frame of the size that was announced."""
        if not self._open:
            raise ValueError("`frame` cannot be written: the video is closed")
        if (frame.width, frame.height) != self._size:
            raise ValueError(f"`frame` must be {self._size} pixels, got {(frame.width, frame.height)}")
        with self._cleaning_up():
            self._sink.write(frame, self._own_time_s(time_s))
        self._num_frames += 1

    def _own_time_s(self, time_s: Fraction | None) -> Fraction | None:
        """Return how long after the first frame the next one is shown, if not at the constant rate."""
        planned_s = self._num_frames * self._interval_s
        if self._num_frames == 0:
            self._start_s = time_s or planned_s
        time_s = planned_s if time_s is None else time_s - self._start_s
        self._last_s = max(time_s, self._last_s + min(self._interval_s, _TICK_S))
        return None if self._last_s == planned_s else self._last_s

    def close(self) -> None:
        """Finish the file and rename it into place."""
        if not self._open:
            return
        with self._cleaning_up():
            if self._num_frames == 0:
                raise VideoError(f"cannot write {self._path}: the video has no frames")
            self._sink.finish()
            self._output.commit()
        self._open = False

    def abort(self) -> None:
        """Discard the written data unless it is to be kept."""
        if not self._open:
            return
        self._open = False
        kept = self._kept and self._num_frames > 0
        with suppress(OSError):
            (self._sink.finish if kept else self._sink.discard)()
        with suppress(OSError, VideoError):
            if kept:
                self._output.keep()
        self._output.discard()

    @contextmanager
    def _cleaning_up(self) -> Iterator[None]:
        """Abort on any exception, and name the file in those of the system."""
        try:
            yield
        except OSError as err:
            self.abort()
            raise VideoError(f"cannot write {self._path}: {err.strerror}") from err
        except BaseException:
            self.abort()
            raise

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the writer, or abort it if the block was left by an exception."""
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
        Frames per second, stored exactly (29.97 and its kin as the NTSC rates, see `exact_frame_rate`).
        Frames may be written with times of their own, which ``.y4m`` cannot hold.
    luma_only : bool, optional
        Store grey pictures (in ``.mp4``, neutral chroma); chroma of the frames is left out. Otherwise frames
        without chroma get neutral chroma.
    full_range : bool, optional
        Mark the samples as using 0 to 255 (see `VideoInfo.full_range`).
    kept : bool, optional
        Write to `path` with ``.part`` after it, and let frames that were written before `abort` stay there,
        as a video that players read.

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
    suffix = path.suffix.lower()
    check_size(*size, str(path))
    if frame_rate > 0:
        check_frame_rate(frame_rate, str(path))
    rate = exact_frame_rate(frame_rate)
    output = OutputFile(path, VideoError, visible=kept)
    try:
        sink: _Sink
        if suffix == ".y4m":
            sink = _Y4mSink(output.temporary, size, rate, luma_only=luma_only, full_range=full_range)
        else:
            sink = _FfmpegSink(
                output.temporary,
                size,
                rate,
                luma_only=luma_only,
                full_range=full_range,
                lossless=suffix == ".mkv",
                flushed=kept,
            )
    except BaseException as err:
        output.discard()
        if isinstance(err, OSError):
            raise VideoError(f"cannot write {path}: {err.strerror}") from err
        raise
    return _AtomicWriter(path, output, sink, size, 1 / rate, kept=kept)


class _Y4mSink:
    """YUV4MPEG2: a text header, then plain planes."""

    def __init__(
        self, path: Path, size: tuple[int, int], rate: Fraction, *, luma_only: bool, full_range: bool
    ) -> None:
        self._luma_only = luma_only
        self._warned = False  # that times are lost
        self._file = path.open("wb")
        colour = "mono" if luma_only else "420mpeg2"
        range_tag = "FULL" if full_range else "LIMITED"
        self._file.write(
            f"YUV4MPEG2 W{size[0]} H{size[1]} F{rate.numerator}:{rate.denominator} Ip A1:1 C{colour} "
            f"XCOLORRANGE={range_tag}\n".encode("ascii")
        )

    def write(self, frame: Frame, time_s: Fraction | None) -> None:
        """Append the planes of a frame; warn once if its time is lost."""
        if time_s is not None and not self._warned:
            self._warned = True
            _LOG.warning("y4m holds no time stamps: frames with times of their own are at the constant rate")
        chroma = () if self._luma_only else frame.with_chroma().chroma or ()
        self._file.write(b"FRAME\n")
        for plane in (frame.luma, *chroma):
            self._file.write(np.ascontiguousarray(plane).data)
        self._file.flush()  # concurrent readers see whole frames

    def finish(self) -> None:
        """Flush and close."""
        self._file.close()

    def discard(self) -> None:
        """Close."""
        self._file.close()


class _FfmpegSink:
    """FFV1 in Matroska, or H.264 in MP4."""

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        rate: Fraction,
        *,
        luma_only: bool,
        full_range: bool,
        lossless: bool,
        flushed: bool,
    ) -> None:
        import av

        self._lossless = lossless
        self._pixel_format = "gray" if luma_only and lossless else "yuv420p"
        self._luma_only = luma_only
        # Without "bitexact" the muxers write random identifiers, and two runs would differ.
        options = {"fflags": "+bitexact"} if lossless else {"fflags": "+bitexact", "movflags": "+faststart"}
        options |= {"flush_packets": "1"} if flushed else {}  # all but the last frame
        with _ffmpeg_errors():
            self._container = av.open(
                f"file:{path}", "w", format="matroska" if lossless else "mp4", container_options=options
            )
            self._stream = self._add_stream(size, rate, full_range=full_range)
        self._rate = rate
        self._num_frames = 0
        # Times of frames with pending packets, without those at the constant rate.
        self._times_s: dict[int, Fraction] = {}

    def _add_stream(self, size: tuple[int, int], rate: Fraction, *, full_range: bool) -> "VideoStream":
        """Set up the encoder."""
        codec, options = ("ffv1", _ffv1_options(size)) if self._lossless else ("libx264", _H264_OPTIONS)
        stream = cast("VideoStream", self._container.add_stream(codec, rate=rate, options=options))
        stream.width, stream.height = size if self._lossless else (side + side % 2 for side in size)
        stream.pix_fmt = self._pixel_format
        stream.codec_context.color_range = 2 if full_range else 1
        stream.codec_context.thread_count = 1
        stream.time_base = stream.codec_context.time_base = 1 / rate
        return stream

    def write(self, frame: Frame, time_s: Fraction | None) -> None:
        """Encode a frame and store what comes out."""
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
        self._num_frames += 1

    def _encode(self, picture: "VideoFrame | None") -> None:
        """Encode at the constant rate, and store what comes out at the times of its frames."""
        with _ffmpeg_errors():
            for packet in self._stream.encode(picture):
                if self._times_s:
                    self._set_times(packet)
                self._container.mux(packet)

    def _set_times(self, packet: "Packet[VideoStream]") -> None:
        """Give a packet the times of the frames with its numbers."""
        numbers = cast("tuple[int, int]", (packet.pts, packet.dts))
        times_s = [self._times_s.get(number, number / self._rate) for number in numbers]
        packet.pts, packet.dts = (round(time_s / _MICROSECOND_S) for time_s in times_s)
        packet.duration = round(1 / self._rate / _MICROSECOND_S)
        packet.time_base = _MICROSECOND_S
        for number in [number for number in self._times_s if number < numbers[1]]:
            del self._times_s[number]

    def finish(self) -> None:
        """Flush the encoder and write the index."""
        with _ffmpeg_errors():
            self._encode(None)
            self._container.close()

    def discard(self) -> None:
        """Close the container."""
        with _ffmpeg_errors():
            self._container.close()


@contextmanager
def _ffmpeg_errors() -> Iterator[None]:
    """Turn all that FFmpeg raises into OSError; only some of it is one by itself."""
    import av

    try:
        yield
    except av.FFmpegError as err:
        raise OSError(err.errno, err.strerror) from err


_TICK_S = Fraction(1, 1000)
"""Least time between two frames that Matroska can resolve."""
_MICROSECOND_S = Fraction(1, 10**6)
_H264_OPTIONS = {"crf": "12", "preset": "medium"}


def _ffv1_options(size: tuple[int, int]) -> dict[str, str]:
    """Return FFV1 settings; one slice where FFmpeg cannot cut small pictures or odd chroma in four."""
    slices = "4" if min(size) >= 16 and not any(side % 4 for side in size) else "1"
    return {"level": "3", "slicecrc": "1", "g": "1", "slices": slices}


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
    height, width = (-(-side // multiple) * multiple for side in (frame.height, frame.width))
    if (height, width) == (frame.height, frame.width):
        return frame
    chroma = None
    if frame.chroma is not None:
        cb, cr = (_pad_plane(plane, height // 2, width // 2) for plane in frame.chroma)
        chroma = (cb, cr)
    return Frame(_pad_plane(frame.luma, height, width), chroma)


def _pad_plane(plane: Plane, height: int, width: int) -> Plane:
    """Repeat the last row and column."""
    return np.pad(plane, ((0, height - plane.shape[0]), (0, width - plane.shape[1])), mode="edge")
