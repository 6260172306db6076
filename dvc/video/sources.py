"""What all sources of frames share: the request, the reader, and the refusals."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from dvc.errors import VideoError
from dvc.files import Closing
from dvc.video.frames import Frame, VideoInfo

DEFAULT_FRAME_RATE = Fraction(25)


@dataclass(frozen=True)
class Request:
    """What part of a video the caller asked for, and what he knows of it."""

    path: Path | str  # a file or folder that exists; what a message calls a pipe; a device or an address
    size: tuple[int, int] | None = None  # width and height in pixels
    frame_rate: Fraction | None = None  # frames per second
    start: int = 0  # number of frames to skip
    num_frames: int | None = None  # most frames to read
    # FFmpeg's name of the format or device; it is found out by itself otherwise
    input_format: str | None = None
    timeout_s: float | None = None  # patience with a silent network, in seconds
    listen: bool = False  # wait at the address for the source to connect

    def count_of(self, total: int, unit: str = "frames") -> int:
        """Return how many frames there are to read."""
        if total <= self.start:
            raise self.too_short(unit, total)
        rest = total - self.start
        return rest if self.num_frames is None else min(rest, self.num_frames)

    def too_short(self, unit: str = "frames", total: int | None = None) -> VideoError:
        """Return the error that says that there is nothing to read."""
        if self.start == 0 or total == 0:
            return VideoError(f"{self.path}: has no {unit}")
        number = f"no more than {self.start}" if total is None else f"only {total}"
        return VideoError(f"{self.path}: has {number} {unit}, cannot start at frame {self.start}")

    def check_size(self, info: VideoInfo) -> None:
        """Refuse pictures that are not of the size that was asked for."""
        if self.size is not None and self.size != info.size:
            width, height = self.size
            raise VideoError(f"{self.path}: pictures are {info.width}x{info.height}, not {width}x{height}")


class SourceClock:
    """Compares the time stamps of a live source with the number of frames that came."""

    def __init__(self) -> None:
        self._first_s: float | None = None
        self._num_frames = 0
        self.lead_s: float | None = None  # the most by which time stamps were ahead; None without any

    def tick(self, time_s: float | None, frame_rate: Fraction) -> None:
        """Take note of a frame."""
        if time_s is not None:
            if self._first_s is None:
                self._first_s = time_s - self._num_frames / float(frame_rate)
            lead_s = time_s - self._first_s - self._num_frames / float(frame_rate)
            self.lead_s = max(self.lead_s or 0.0, lead_s)
        self._num_frames += 1


class FrameStream(Closing):
    """The one `VideoReader` behind all files: information, an iterator of frames, something to close."""

    def __init__(
        self,
        info: VideoInfo,
        frames: Iterator[Frame],
        close: Callable[[], None],
        clock: SourceClock | None = None,
    ) -> None:
        self.clock = clock or SourceClock()
        self._info = info
        self._frames = frames
        self._close = close

    @property
    def info(self) -> VideoInfo:
        """What is known of the video."""
        return self._info

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames that have not been read yet."""
        return self._frames

    def leave_open(self) -> None:
        """Let the end of the process release the source, which is being read by another thread."""
        self._close = lambda: None

    def close(self) -> None:
        """Release the source; no frame comes after that."""
        self._frames = iter(())
        self._close()
