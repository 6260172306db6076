"""Common parts of all sources of frames: the request, the reader, and pipes."""

import io
import os
import select
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from dvc.errors import VideoError
from dvc.files import Closing
from dvc.video.decoding import HEAD_BYTES
from dvc.video.frames import Frame, VideoInfo

DEFAULT_FRAME_RATE = Fraction(25)


@dataclass(frozen=True)
class Request:
    """Part of a video that the caller requested, and its known properties."""

    path: Path | str  # file or folder; name of a pipe for messages; device or address
    size: tuple[int, int] | None = None  # width and height in pixels
    frame_rate: Fraction | None = None  # frames per second
    start: int = 0  # number of frames to skip
    num_frames: int | None = None  # largest number of frames to read
    input_format: str | None = None  # FFmpeg's name of the format or device; None: detected
    timeout_s: float | None = None  # patience with a silent network, in seconds
    listen: bool = False  # wait at the address for the source to connect

    def count_of(self, total: int, unit: str = "frames") -> int:
        """Return the number of frames to read."""
        if total <= self.start:
            raise self.too_short(unit, total)
        rest = total - self.start
        return rest if self.num_frames is None else min(rest, self.num_frames)

    def too_short(self, unit: str = "frames", total: int | None = None) -> VideoError:
        """Return the error that the video ends before the first requested frame."""
        if self.start == 0 or total == 0:
            return VideoError(f"{self.path}: has no {unit}")
        number = f"no more than {self.start}" if total is None else f"only {total}"
        return VideoError(f"{self.path}: has {number} {unit}, cannot start at frame {self.start}")

    def check_size(self, info: VideoInfo) -> None:
        """Refuse pictures of another size than the requested one."""
        if self.size is not None and self.size != info.size:
            width, height = self.size
            raise VideoError(f"{self.path}: pictures are {info.width}x{info.height}, not {width}x{height}")


class SourceClock:
    """Compares the time stamps of a live source with the number of its frames."""

    def __init__(self) -> None:
        self._first_s: float | None = None
        self._num_frames = 0
        self.lead_s: float | None = None  # largest lead of time stamps; None without time stamps

    def tick(self, time_s: float | None, frame_rate: Fraction) -> None:
        """Count a frame."""
        if time_s is not None:
            if self._first_s is None:
                self._first_s = time_s - self._num_frames / float(frame_rate)
            lead_s = time_s - self._first_s - self._num_frames / float(frame_rate)
            self.lead_s = max(self.lead_s or 0.0, lead_s)
        self._num_frames += 1


class VideoReader(Closing):
    """A source of frames in display order, one in memory at a time, read once from front to back."""

    def __init__(
        self,
        info: VideoInfo,
        frames: Iterator[Frame],
        close: Callable[[], None],
        clock: SourceClock | None = None,
    ) -> None:
        self.clock = clock or SourceClock()
        self.info = info  # properties of the video
        self._frames = frames
        self._close = close

    def __iter__(self) -> Iterator[Frame]:
        """Yield the remaining frames; raise `VideoError` at damage."""
        return self._frames

    def leave_open(self) -> None:
        """Leave the source open until the process ends, because another thread reads it."""
        self._close = lambda: None

    def close(self) -> None:
        """Release the source, which has no more frames then; harmless when repeated."""
        self._frames = iter(())
        self._close()


STANDARD_INPUT = "-"


class Pipe(Closing):
    """A pipe or a file that is read in order; a read waits for data without a limit."""

    def __init__(self, path: Path | str) -> None:
        self.name = "standard input" if str(path) == STANDARD_INPUT else str(path)
        self._num_bytes = 0
        self._head = b""
        try:
            self._file = (
                io.FileIO(0, closefd=False) if str(path) == STANDARD_INPUT else io.FileIO(os.fspath(path))
            )
        except OSError as err:
            raise VideoError(f"{self.name}: cannot be read ({err.strerror})") from err

    def extent(self) -> tuple[int, bytes]:
        """Return the number of bytes that were read, and the first of them."""
        return self._num_bytes, self._head

    def seek(self, position: int) -> None:
        """Continue at a position of a file."""
        self._file.seek(position)

    def read(self, count: int) -> bytes:
        """Read available data, waiting for some."""
        while (data := self._file.read(count)) is None:  # another process made the pipe non-blocking
            select.select([self._file], [], [])
        self._num_bytes += len(data)
        if len(self._head) < HEAD_BYTES:
            self._head += data[: HEAD_BYTES - len(self._head)]
        return data

    def read_fully(self, count: int) -> bytearray:
        """Read a number of bytes, fewer only at the end."""
        parts = []
        while count > 0 and (part := self.read(count)):
            parts.append(part)
            count -= len(part)
        return bytearray().join(parts)

    def close(self) -> None:
        """Close the pipe."""
        self._file.close()


class PipeFeed:
    """A pipe for FFmpeg, which drops exceptions of callbacks: they end the data, and are raised later."""

    def __init__(self, pipe: Pipe) -> None:
        self._pipe = pipe
        self._error: BaseException | None = None

    def read(self, count: int) -> bytes:
        """Read available data; nothing after an exception."""
        try:
            return b"" if self._error else self._pipe.read(count)
        except BaseException as err:
            self._error = err
            return b""

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Raise the exception of a read within the block instead of the error that FFmpeg made of it."""
        try:
            yield
        except VideoError:
            if self._error is None:
                raise
        if isinstance(self._error, OSError):
            raise VideoError(f"{self._pipe.name}: cannot be read ({self._error.strerror})") from self._error
        if self._error is not None:
            raise self._error
