"""What waits, first in, first out: in memory up to a bound, and in a file beyond it, up to another one."""

import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from dvc.errors import DvcError
from dvc.files import Closing

MEMORY_MIB, FILE_MIB = 64, 1024
"""Most that waits in memory, and in the file, where nobody says how much."""


@dataclass
class SpoolReport:
    """Most that has waited, in bytes."""

    most_in_memory: int = 0
    most_on_disk: int = 0
    failure: str = ""  # why the file takes nothing any more


class _Place(NamedTuple):
    start: int  # as if the file had no end
    size: int


class Spool(Closing):
    """Bytes that wait; the file has no name once it is there, and so is gone however this ends.

    It is written round and round. Where it can be written no more, it takes nothing from then on.
    """

    def __init__(
        self,
        path: str,
        max_file_bytes: int,
        max_memory_bytes: int,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.report = SpoolReport()
        self._path, self._say = path, say
        self._max_file_bytes, self._max_memory_bytes = max_file_bytes, max_memory_bytes
        self._waiting: deque[bytes | _Place] = deque()
        self._start = self._end = self._memory_bytes = self._largest = 0
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            os.unlink(path)
        except OSError as err:
            raise DvcError(f"cannot spool to {path}: {err.strerror}") from err

    @property
    def has_room(self) -> bool:
        """Whether there is room for as much as the most that came at a time."""
        left = self._max_file_bytes - (self._end - self._start)
        return self._memory_bytes + self._largest <= self._max_memory_bytes or (
            not self.report.failure and self._largest <= left
        )

    def put(self, data: bytes) -> None:
        """Let something wait; it may go beyond the bound of memory where the file does not take it."""
        self._largest = max(self._largest, len(data))
        place = None
        if self._memory_bytes + len(data) > self._max_memory_bytes:
            place = self._write(data)
        self._waiting.append(place or data)
        self._memory_bytes += 0 if place else len(data)
        report = self.report
        report.most_in_memory = max(report.most_in_memory, self._memory_bytes)
        report.most_on_disk = max(report.most_on_disk, self._end - self._start)

    def _write(self, data: bytes) -> _Place | None:
        """Write to the file, if there is room and nothing is wrong with it."""
        place = _Place(self._end, len(data))
        if self.report.failure or self._end + place.size - self._start > self._max_file_bytes:
            return None
        try:
            view = memoryview(data)
            while view:
                at, size = self._span(place.start + len(data) - len(view), len(view))
                view = view[os.pwrite(self._file, view[:size], at) :]
        except OSError as err:
            self.report.failure = err.strerror or str(err)
            self._say(f"cannot spool to {self._path} any more: {self.report.failure}")
            return None
        self._end += place.size
        return place

    def _span(self, start: int, size: int) -> tuple[int, int]:
        """Return where in the file something begins, and how much of it comes before the file's end."""
        at = start % self._max_file_bytes
        return at, min(size, self._max_file_bytes - at)

    def take(self) -> bytes:
        """Return what has waited longest."""
        first = self._waiting.popleft()
        if isinstance(first, bytes):
            self._memory_bytes -= len(first)
            return first
        data = self._read(first)
        self._start += first.size
        if self._start == self._end:
            os.ftruncate(self._file, 0)
            self._start = self._end = 0
        return data

    def _read(self, place: _Place) -> bytes:
        parts, done = [], 0
        while done < place.size:
            at, size = self._span(place.start + done, place.size - done)
            part = os.pread(self._file, size, at)
            if not part:
                raise DvcError(f"what was spooled to {self._path} is gone")
            parts.append(part)
            done += len(part)
        return b"".join(parts)

    def close(self) -> None:
        """Let go of the file, and with it of what waits there."""
        os.close(self._file)
