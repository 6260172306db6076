"""Frames of a live source that wait for a decoder that is slower; a thread reads them as they come."""

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Self

from dvc.video import Frame

MAX_CLOSING_S = 1.0
"""Longest wait for a read of the source to end; a pipe or a camera may be silent for ever."""
MAX_FRAMES = 64
"""Frames that wait where nobody says how many: two seconds of most cameras."""
MAX_PX = 1 << 27
"""Pixels that wait where nobody says how many frames: 64 of 1920x1080, 200 MB."""


def default_frames(num_px: int, group_length: int) -> int:
    """Return how many frames of a size wait where nobody says so: those of a group at least."""
    return max(group_length, min(MAX_FRAMES, MAX_PX // num_px))


MAX_NAMED_GAPS = 10_000
"""Gaps whose frames are named; further ones are counted."""


@dataclass
class LeftOut:
    """How many frames of a source were left out, in how many places, and which."""

    frames: int = 0
    gaps: int = 0
    named: list[list[int]] = field(default_factory=list)  # first and last of each gap, from 0

    def add(self, number: int, begins_gap: bool) -> None:
        """Count a frame."""
        self.frames += 1
        self.gaps += begins_gap
        if self.gaps <= MAX_NAMED_GAPS:
            if begins_gap:
                self.named.append([number, number])
            self.named[-1][1] = number


class FrameQueue:
    """So many frames at most; where it is full the source waits, or frames are left out, by whole groups.

    Where frames are left out None stands in their place, once, and a group of pictures can be taken after it.
    """

    def __init__(self, source: Iterable[Frame], max_frames: int, group_length: int = 0) -> None:
        self.left_out = LeftOut()
        self._source, self._max_frames = source, max_frames
        self._group_length = group_length  # of the longest group that is left out; 0: the source waits
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
        """Read the source from now on; nothing is read before it is asked for."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, name="frame queue", daemon=True)
            self._thread.start()

    def holds(self, count: int) -> bool:
        """Tell whether so many frames wait, or all that there will be."""
        self._begin()
        with self._changed:
            return self._num_waiting >= count or self._ended

    def close(self) -> bool:
        """Take no more of the source; tell whether it is at rest, so that it can be closed."""
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
                if not self._keep(number, frame):
                    break
        except BaseException as err:
            failure = err
        with self._changed:
            self._failure, self._ended = failure, True
            self._changed.notify_all()

    def _keep(self, number: int, frame: Frame) -> bool:
        """Put a frame with the others, or leave it out; tell whether more are wanted."""
        with self._changed:
            if self._group_length == 0:
                while self._num_waiting >= self._max_frames and not self._closed:
                    self._changed.wait()
            elif self._num_waiting + (self._group_length if self._leaves_out else 1) > self._max_frames:
                self.left_out.add(number, not self._leaves_out)
                self._leaves_out = True
                return not self._closed
            if self._leaves_out:
                self._frames.append(None)
                self._leaves_out = False
            self._frames.append(frame)
            self._num_waiting += 1
            self._changed.notify_all()
            return not self._closed
