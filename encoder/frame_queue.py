"""Frames of a source until it ends or is stopped: lag behind a live one, and a queue for a slower decoder."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Self

from dvc.errors import PartialOutputError, VideoError
from dvc.video import Frame

MAX_CLOSING_S = 1.0
"""Longest wait for a read of the source to end; a pipe or a camera may never send again."""
MAX_NAMED_GAPS = 10_000
"""Number of gaps that are listed by frame numbers; further gaps are only counted."""


@dataclass
class LeftOut:
    """Frames of a source that were left out."""

    frames: int = 0
    gaps: int = 0
    named: list[list[int]] = field(default_factory=list)  # first and last frame of each gap, from 0


class FrameQueue:
    """A bounded queue, filled by a thread; if it is full the source waits, or whole groups are left out.

    One None replaces all frames of a gap; after it a whole group of pictures can be read.
    """

    def __init__(self, source: Iterable[Frame], max_frames: int, group_length: int = 0) -> None:
        self.left_out = LeftOut()
        self._source, self._max_frames = source, max_frames
        self._group_length = group_length  # length of the longest group; 0: the source waits
        self._frames: deque[Frame | None] = deque()
        self._num_waiting = 0
        self._leaves_out = self._ended = self._closed = False
        self._failure: BaseException | None = None
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Frame | None:
        self._begin()
        with self._changed:
            while not self._frames and not self._ended:
                self._changed.wait()
            if self._frames:
                frame = self._frames.popleft()
                self._num_waiting -= frame is not None
                self._changed.notify_all()
                return frame
            failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        raise StopIteration

    def _begin(self) -> None:
        """Start to read the source."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="frame queue", daemon=True)
            self._thread.start()

    def holds(self, count: int) -> bool:
        """Return whether at least `count` frames can be read without waiting, or all that are left."""
        self._begin()
        with self._changed:
            return self._num_waiting >= min(count, self._max_frames) or self._ended

    def close(self) -> bool:
        """Stop to read the source; return whether the thread has ended, so that it can be closed."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(MAX_CLOSING_S)
        return self._thread is None or not self._thread.is_alive()

    def _read(self) -> None:
        failure: BaseException | None = None
        try:
            for number, frame in enumerate(self._source):
                if not self._put(number, frame):
                    break
        except BaseException as err:
            failure = err
        with self._changed:
            self._failure, self._ended = failure, True
            self._changed.notify_all()

    def _put(self, number: int, frame: Frame) -> bool:
        """Append a frame or leave it out; return whether more frames are read."""
        with self._changed:
            if self._group_length == 0:
                while self._num_waiting >= self._max_frames and not self._closed:
                    self._changed.wait()
            elif self._num_waiting + (self._group_length if self._leaves_out else 1) > self._max_frames:
                left_out = self.left_out
                left_out.frames += 1
                left_out.gaps += not self._leaves_out
                if left_out.gaps <= MAX_NAMED_GAPS:
                    left_out.named += [[number, number]] * (not self._leaves_out)
                    left_out.named[-1][1] = number
                self._leaves_out = True
                return not self._closed
            if self._leaves_out:
                self._frames.append(None)
                self._leaves_out = False
            self._frames.append(frame)
            self._num_waiting += 1
            self._changed.notify_all()
            return not self._closed


class PacedFrames:
    """Frames of a source, and the lag of their consumer behind it."""

    def __init__(
        self,
        source: Iterable[Frame],
        frame_rate: Fraction,
        clock: Callable[[], float] = time.monotonic,
        cpu_clock: Callable[[], float] = time.thread_time,
    ) -> None:
        self.behind_s = 0.0
        self._source = source
        self._interval_s = float(1 / frame_rate)
        self._clock, self._cpu_clock = clock, cpu_clock

    def __iter__(self) -> Iterator[Frame]:
        late_s, source, before = 0.0, iter(self._source), None
        while True:
            asked, asked_cpu = self._clock(), self._cpu_clock()
            frame = next(source, None)
            if frame is None:
                return
            now, read_s = self._clock(), self._cpu_clock() - asked_cpu
            if before is not None:
                waited_s = max(0.0, now - asked - read_s)
                busy_s = asked - before + read_s
                late_s = max(0.0, late_s + busy_s - waited_s - self._interval_s)
                self.behind_s = max(self.behind_s, late_s)
            before = now
            yield frame


class InputFrames:
    """Frames of a recording until it ends, the source fails, or a signal stops it."""

    def __init__(self, source: Iterable[Frame | None]) -> None:
        self.failure: VideoError | None = None  # failure of the source after its frames
        self.stopped = False
        self._source = iter(source)
        self._waiting = False

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Frame | None:
        if self.stopped or self.failure is not None:
            raise StopIteration
        try:
            self._waiting = True
            return next(self._source)
        except VideoError as err:
            self.failure = err
            raise StopIteration from err
        except KeyboardInterrupt:
            if not self.stopped:
                raise
            raise StopIteration from None
        finally:
            self._waiting = False

    def stop(self) -> None:
        """End the frames like at the end of the source; for `dvc.cli.stopping_at_signals`."""
        self.stopped = True
        if self._waiting:
            raise KeyboardInterrupt

    def raise_end(self, kept: bool = False) -> None:
        """Raise the reason if the frames ended before the source; `kept`: earlier frames are written."""
        if kept and self.failure is not None:
            raise PartialOutputError(f"{self.failure}; earlier frames are kept") from self.failure
        if self.failure is not None:
            raise self.failure
        if self.stopped:
            raise KeyboardInterrupt
