"""Whether the encoder keeps up with a source whose frames come at the rate of the video, and a decoder."""

import time
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction

from dvc.video import Frame
from encoder.frame_queue import LeftOut


def lateness_s(late_s: float, busy_s: float, waited_s: float, interval_s: float) -> float:
    """Return how long after it came a frame is asked for, from the same of the frame before it."""
    return max(0.0, late_s + busy_s - waited_s - interval_s)


class PacedFrames:
    """Frames of a source, and how far what is done with them falls behind it."""

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
            got, read_s = self._clock(), self._cpu_clock() - asked_cpu
            if before is not None:
                waited_s = max(0.0, got - asked - read_s)
                late_s = lateness_s(late_s, asked - before + read_s, waited_s, self._interval_s)
                self.behind_s = max(self.behind_s, late_s)
            before = got
            yield frame


class DecoderPace:
    """How far a live decoder falls behind the video while its window of groups of pictures is full."""

    GROWTH = 4.0

    def __init__(
        self,
        frame_rate: Fraction,
        say: Callable[[str], None],
        left_out: LeftOut | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.behind_s = 0.0
        self.most_frames_open = 0
        self._interval_s = float(1 / frame_rate)
        self._say, self._clock, self._left_out = say, clock, left_out or LeftOut()
        self._start_s: float | None = None
        self._num_sent = self._num_done = 0
        self._told_s = 1.0 / self.GROWTH

    def sent(self, num_frames: int) -> None:
        """Count frames that go to the decoder."""
        if self._start_s is None:
            self._start_s = self._clock()
        self._num_sent += num_frames
        self.most_frames_open = max(self.most_frames_open, self._num_sent - self._num_done)

    def done(self, num_frames: int) -> None:
        """Count frames that the decoder is done with."""
        self._num_done += num_frames

    def begin_again(self, num_frames: int) -> None:
        """Count what another decoder is sent first; nothing else of what was sent is missing."""
        self._num_done = self._num_sent - num_frames

    def waits(self) -> None:
        """Notice that the decoder takes no more for now; say it where it is late."""
        if self._start_s is None:
            return
        left_out = self._left_out.frames
        behind_s = self._clock() - self._start_s - (self._num_sent + left_out) * self._interval_s
        self.behind_s = max(self.behind_s, behind_s)
        if behind_s >= self.GROWTH * self._told_s:
            self._told_s = behind_s
            self._say(
                f"the decoder is {behind_s:.1f} s behind the video: it has {self._num_sent - self._num_done}"
                f" frames up to number {self._num_sent - 1}, others wait; {left_out or 'none'} left out"
            )
