"""Time stamps of the source, as deviations from the constant frame rate of the stream."""

from collections.abc import Sequence
from fractions import Fraction

from dvc.stream import MAX_DEVIATION_TICKS, Deviations, planned_tick
from dvc.video import Frame


class CodingClock:
    """Compares the time stamps of frames with the number of coded frames before them."""

    def __init__(self, frame_rate: Fraction) -> None:
        self._interval_s = 1 / frame_rate
        self._ticks_per_second = 0  # clock of the source; 0 without one
        self._ticks_per_frame = Fraction(0)
        self._num_frames = 0  # coded in the stream
        self._zero: int | None = None  # tick of the source that is tick 0 of the stream
        self._last = 0  # tick of the stream when the last frame is shown

    def begin_stream(self) -> None:
        """Start a stream at the next frame; it continues the clock of the last one."""
        if self._zero is not None:
            self._zero += self._last - self._planned(-1)
        self._num_frames = 0

    def deviations(self, frames: Sequence[Frame]) -> Deviations | None:
        """Return the delay of each of the next frames; None if all are less than a tick off."""
        self._find_clock(frames)
        first, self._num_frames = self._num_frames, self._num_frames + len(frames)
        if not self._ticks_per_second:
            return None
        numbers = range(first, self._num_frames)
        ticks = [self._tick(number, frame) for number, frame in zip(numbers, frames, strict=True)]
        length, unit = self._ticks_per_frame.as_integer_ratio()
        if all(abs(unit * tick - length * n) < unit for n, tick in zip(numbers, ticks, strict=True)):
            return None
        late = (tick - self._planned(number) for number, tick in zip(numbers, ticks, strict=True))
        return Deviations(self._ticks_per_second, tuple(late))

    def _find_clock(self, frames: Sequence[Frame]) -> None:
        """Find the clock of the source, unless it is too coarse to separate frames."""
        if not self._ticks_per_second:
            clocks = (frame.time.ticks_per_second for frame in frames if frame.time is not None)
            fine = (clock for clock in clocks if clock * self._interval_s >= 1)
            self._ticks_per_second = next(fine, 0)
            self._ticks_per_frame = self._ticks_per_second * self._interval_s

    def _planned(self, number: int) -> int:
        return planned_tick(number, self._ticks_per_frame)

    def _tick(self, number: int, frame: Frame) -> int:
        """Return the tick of a frame; if the clock of the source jumps, the usual interval after the last."""
        planned, before = self._planned(number), self._planned(number - 1)
        if number == 0 or self._zero is None:
            self._last = before
        usual = planned + self._last - before
        tick = usual
        if frame.time is not None:
            now, clock = frame.time
            if clock != self._ticks_per_second:
                now = round(frame.time.seconds * self._ticks_per_second)
            zero = now - usual if self._zero is None else self._zero
            if now - zero <= self._last or abs(now - zero - planned) > MAX_DEVIATION_TICKS:
                zero = now - usual
            self._zero, tick = zero, now - zero
        self._last = tick
        return tick
