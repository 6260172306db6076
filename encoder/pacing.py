"""Whether the encoder keeps up with a source whose frames come at the rate of the video, and a decoder."""

import time
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction

from dvc.video import Frame


def lateness_s(late_s: float, busy_s: float, waited_s: float, interval_s: float) -> float:
    """Return how long after it came a frame is asked for, from the same of the frame before it.

    Parameters
    ----------
    late_s : float
        That of the frame before, in seconds.
    busy_s : float
        What was then spent on anything but waiting.
    waited_s : float
        What was spent waiting for the frame: the source came no sooner.
    interval_s : float
        From frame to frame of the source.

    Returns
    -------
    float
        Seconds, 0 where the encoder keeps up.

    References
    ----------
    D. V. Lindley, "The theory of queues with a single server", 1952.

    Examples
    --------
    >>> lateness_s(0.0, 0.5, 0.0, 0.25), lateness_s(0.0, 0.125, 0.125, 0.25)
    (0.25, 0.0)
    """
    return max(0.0, late_s + busy_s - waited_s - interval_s)


class PacedFrames:
    """Frames of a source, and how far what is done with them falls behind it.

    Parameters
    ----------
    source : iterable of Frame
        The source.
    frame_rate : Fraction
        Frames per second that the source has.
    clock, cpu_clock : callable, optional
        Tell the time, and the processor time of this thread: reading is work as far as it takes that.

    Attributes
    ----------
    behind_s : float
        The most that a frame had to wait before it was asked for, in seconds.
    """

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
    """How far a live decoder falls behind the video while its window of groups of pictures is full.

    Parameters
    ----------
    frame_rate : Fraction
        Frames per second of the video.
    say : callable
        Told a line when the decoder is late, and again each time that it is `GROWTH` times as late.
    clock : callable, optional
        Tells the time in seconds.

    Attributes
    ----------
    behind_s : float
        The most that the next frame had to wait for the decoder, in seconds.
    most_frames_open : int
        The most frames that were sent, and not done, at a time.
    """

    GROWTH = 4.0

    def __init__(
        self, frame_rate: Fraction, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.behind_s = 0.0
        self.most_frames_open = 0
        self._interval_s = float(1 / frame_rate)
        self._say, self._clock = say, clock
        self._start_s: float | None = None
        self._num_sent = self._num_done = 0
        self._told_s = 1.0 / self.GROWTH

    def sent(self, num_frames: int) -> None:
        """Count frames that go to the decoder.

        Parameters
        ----------
        num_frames : int
            Number of frames.
        """
        if self._start_s is None:
            self._start_s = self._clock()
        self._num_sent += num_frames
        self.most_frames_open = max(self.most_frames_open, self._num_sent - self._num_done)

    def done(self, num_frames: int) -> None:
        """Count frames that the decoder is done with.

        Parameters
        ----------
        num_frames : int
            Number of frames.
        """
        self._num_done += num_frames

    def waits(self) -> None:
        """Notice that the decoder takes no more for now; say it where it is late."""
        if self._start_s is None:
            return
        behind_s = self._clock() - self._start_s - self._num_sent * self._interval_s
        self.behind_s = max(self.behind_s, behind_s)
        if behind_s >= self.GROWTH * self._told_s:
            self._told_s = behind_s
            self._say(
                f"the decoder is {behind_s:.1f} s behind the video: it has {self._num_sent - self._num_done}"
                f" frames up to number {self._num_sent - 1}, others wait at the source; none is dropped"
            )
