"""Process that decodes groups of pictures; `decoder.processes` starts it and talks to it.

Tasks, and answers of a live encoder, arrive through a connection; its file descriptor is the only argument.
Replies carry the number of their group: requests, and finally the decoded group or the exception that ended
it. Groups of a stream have records that answer; they are decoded in turn. Groups of a live encoder are
coroutines: while some wait for answers, the rest continue, first those with the most levels to follow. Memory
bounds the number of levels that are decoded at the same time.
"""

import heapq
import os
import sys
import traceback
from collections.abc import Sequence
from itertools import count
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from decoder.group_tasks import Answered, Bits, GroupTask, naming_group
from dvc.config import decode_config
from dvc.errors import DvcError

if TYPE_CHECKING:
    from decoder.group import GroupCoroutine, GroupDecoder, Rank
    from decoder.wyner_ziv import WynerZivDecoder

MAX_ACTIVE_PX = 3 << 20
"""Pixels of frames of live groups that are decoded at a time, if that leaves one level of one group."""


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until the connection closes."""
    _import_opencv_quietly()
    worker = _Worker(connection)
    while True:
        try:
            worker.receive(wait=worker.is_idle)
            worker.step()
        except (EOFError, OSError):  # the parent has closed the connection
            os._exit(0)


class _LiveGroup:
    """A group with a coroutine that waits for its turn, for memory or for answers."""

    def __init__(self, number: int, steps: "GroupCoroutine", decoder: "GroupDecoder", config: bytes) -> None:
        self.number, self.steps, self.decoder, self.config = number, steps, decoder, config
        self.rank: Rank = (0, number)
        self.num_px = 0  # pixels of the level that is being decoded


class _Worker:
    """Groups that are under way, in one thread."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._decoders = _Decoders()
        self._num_taken = 0  # messages
        self._order = count()
        self._tasks: list[GroupTask] = []  # groups of streams
        self._groups: dict[int, _LiveGroup] = {}
        self._ready: list[tuple[Rank, int, int, Sequence[Bits] | None]] = []  # numbers, with bits to send
        self._paused: list[tuple[Rank, int, int]] = []  # for lack of memory
        self._used_px = 0

    @property
    def is_idle(self) -> bool:
        """Whether the process has nothing to do before the next message."""
        return not (self._ready or self._tasks)

    def receive(self, wait: bool) -> None:
        """Receive messages."""
        while wait or self._connection.poll():
            for message in self._connection.recv():
                self._num_taken += 1
                if isinstance(message, Answered):
                    self._enqueue(self._groups[message.number], message.bits)
                elif message.form is not None:
                    self._tasks.append(message)
                else:
                    self._begin(message)
            wait = False

    def _begin(self, task: GroupTask) -> None:
        try:
            with naming_group(task.number):
                decoder = self._decoders.acquire(task.config)
        except Exception as err:
            self._send(task.number, _portable(err))
            return
        group = _LiveGroup(task.number, decoder.steps(task), decoder, task.config)
        self._groups[task.number] = group
        self._enqueue(group, None)

    def _enqueue(self, group: _LiveGroup, sent: Sequence[Bits] | None) -> None:
        heapq.heappush(self._ready, (group.rank, next(self._order), group.number, sent))

    def step(self) -> None:
        """Decode a group of a stream, or advance the group of the first rank to its next request."""
        if self._tasks:
            self._decode(self._tasks.pop(0))
        elif self._ready:
            _, _, number, sent = heapq.heappop(self._ready)
            self._advance(self._groups[number], sent)

    def _decode(self, task: GroupTask) -> None:
        """Decode a group with a record that answers."""
        try:
            with naming_group(task.number):
                decoder = self._decoders.acquire(task.config)
                outcome: object = decoder.decode(task)
                self._decoders.release(decoder, task.config)
        except Exception as err:
            outcome = _portable(err)
        self._send(task.number, outcome)

    def _advance(self, group: _LiveGroup, sent: Sequence[Bits] | None) -> None:
        """Advance a group to its next request, to the start of a level or to its end."""
        from decoder.group import LevelBegins

        try:
            with naming_group(group.number):
                asked = next(group.steps) if sent is None else group.steps.send(sent)
        except StopIteration as stop:
            self._decoders.release(group.decoder, group.config)
            self._end(group, stop.value)
            return
        except Exception as err:
            self._end(group, _portable(err))
            return
        if isinstance(asked, LevelBegins):
            self._used_px -= group.num_px
            group.rank, group.num_px = asked.rank, asked.num_px
            heapq.heappush(self._paused, (group.rank, next(self._order), group.number))
            self._resume()
            asked = ()
        self._send(group.number, asked)

    def _resume(self) -> None:
        """Start levels that fit into the memory."""
        while self._paused:
            group = self._groups[self._paused[0][2]]
            if self._used_px and self._used_px + group.num_px > MAX_ACTIVE_PX:
                return
            heapq.heappop(self._paused)
            self._used_px += group.num_px
            self._enqueue(group, ())

    def _end(self, group: _LiveGroup, outcome: object) -> None:
        del self._groups[group.number]
        self._used_px -= group.num_px
        self._resume()
        self._send(group.number, outcome)

    def _send(self, number: int, outcome: object) -> None:
        """Send the requests or the result of a group, and the number of open tasks."""
        self._connection.send((number, outcome, len(self._ready) + len(self._tasks), self._num_taken))


def _portable(err: Exception) -> Exception:
    """Return an error of a class that the parent process can load."""
    if isinstance(err, DvcError):
        return err
    error = RuntimeError(repr(err))
    error.add_note(f"in the decoding process:\n{''.join(traceback.format_exception(err))}")
    return error


class _Decoders:
    """Decoders of groups, kept for further groups of the same configuration."""

    def __init__(self) -> None:
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []

    def acquire(self, config: bytes) -> "GroupDecoder":
        """Return an idle decoder."""
        from decoder.group import GroupDecoder
        from decoder.wyner_ziv import WynerZivDecoder

        if config != self._config:
            self._config, self._idle = config, []
            self._frames = WynerZivDecoder(decode_config(config))
        if self._idle:
            return self._idle.pop()
        return GroupDecoder(decode_config(config), self._frames)

    def release(self, decoder: "GroupDecoder", config: bytes) -> None:
        """Keep a decoder that has not failed."""
        if config == self._config:
            self._idle.append(decoder)


def _import_opencv_quietly() -> None:
    """Keep from standard error which features, of those that OpenCV must not use, are not there anyway."""
    kept = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        import cv2  # noqa: F401
    finally:
        os.dup2(kept, 2)
        os.close(kept)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
