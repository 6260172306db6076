"""The process in which groups of pictures are decoded: `decoder.processes` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument and, if the encoder is live,
answers to requests. What goes back has the number of its group: requests, and at last the decoded group or
the exception that it ended with. Groups of a stream, whose records answer, are decoded one after the other.
Groups of a live encoder are coroutines: while some wait for answers, others go on, first of all those with
the most to be decoded after them. Memory bounds how many levels are decoded at the same time.
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
    """Decode groups until nobody wants any."""
    _import_opencv_quietly()
    worker = _Worker(connection)
    while True:
        try:
            worker.take(wait=worker.is_idle)
            worker.step()
        except (EOFError, OSError):  # nobody is left who wants anything
            os._exit(0)


class _LiveGroup:
    """A group whose coroutine waits for its turn, for memory or for answers."""

    def __init__(self, number: int, steps: "GroupCoroutine", decoder: "GroupDecoder", config: bytes) -> None:
        self.number, self.steps, self.decoder, self.config = number, steps, decoder, config
        self.rank: Rank = (0, number)
        self.num_px = 0  # of the level that is decoded


class _Worker:
    """Groups that are under way, in one thread."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._decoders = _Decoders()
        self._num_taken = 0  # messages
        self._order = count()
        self._tasks: list[GroupTask] = []  # of streams
        self._groups: dict[int, _LiveGroup] = {}
        self._ready: list[tuple[Rank, int, int, Sequence[Bits] | None]] = []  # by numbers, with what is sent
        self._paused: list[tuple[Rank, int, int]] = []  # for lack of memory
        self._used_px = 0

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing to do until something comes."""
        return not (self._ready or self._tasks)

    def take(self, wait: bool) -> None:
        """Take what comes."""
        while wait or self._connection.poll():
            for message in self._connection.recv():
                self._num_taken += 1
                if isinstance(message, Answered):
                    self._go_on(self._groups[message.number], message.bits)
                elif message.form is not None:
                    self._tasks.append(message)
                else:
                    self._begin(message)
            wait = False

    def _begin(self, task: GroupTask) -> None:
        try:
            with naming_group(task.number):
                decoder = self._decoders.taken(task.config)
        except Exception as err:
            self._send(task.number, _told(err))
            return
        group = _LiveGroup(task.number, decoder.steps(task), decoder, task.config)
        self._groups[task.number] = group
        self._go_on(group, None)

    def _go_on(self, group: _LiveGroup, sent: Sequence[Bits] | None) -> None:
        heapq.heappush(self._ready, (group.rank, next(self._order), group.number, sent))

    def step(self) -> None:
        """Decode a group of a stream, or the group of the first rank up to what it asks for next."""
        if self._tasks:
            self._decode(self._tasks.pop(0))
        elif self._ready:
            _, _, number, sent = heapq.heappop(self._ready)
            self._advance(self._groups[number], sent)

    def _decode(self, task: GroupTask) -> None:
        """Decode a group whose record answers."""
        try:
            with naming_group(task.number):
                decoder = self._decoders.taken(task.config)
                outcome: object = decoder.decode(task)
                self._decoders.give_back(decoder, task.config)
        except Exception as err:
            outcome = _told(err)
        self._send(task.number, outcome)

    def _advance(self, group: _LiveGroup, sent: Sequence[Bits] | None) -> None:
        """Let a group go on to what it asks for, to the beginning of a level or to its end."""
        from decoder.group import LevelBegins

        try:
            with naming_group(group.number):
                asked = next(group.steps) if sent is None else group.steps.send(sent)
        except StopIteration as stop:
            self._decoders.give_back(group.decoder, group.config)
            self._end(group, stop.value)
            return
        except Exception as err:
            self._end(group, _told(err))
            return
        if isinstance(asked, LevelBegins):
            self._used_px -= group.num_px
            group.rank, group.num_px = asked.rank, asked.num_px
            heapq.heappush(self._paused, (group.rank, next(self._order), group.number))
            self._resume()
            asked = ()
        self._send(group.number, asked)

    def _resume(self) -> None:
        """Let levels begin for which there is memory."""
        while self._paused:
            group = self._groups[self._paused[0][2]]
            if self._used_px and self._used_px + group.num_px > MAX_ACTIVE_PX:
                return
            heapq.heappop(self._paused)
            self._used_px += group.num_px
            self._go_on(group, ())

    def _end(self, group: _LiveGroup, outcome: object) -> None:
        del self._groups[group.number]
        self._used_px -= group.num_px
        self._resume()
        self._send(group.number, outcome)

    def _send(self, number: int, outcome: object) -> None:
        """Send what a group asks for or comes to, and how much there is to do beside what is to be taken."""
        self._connection.send((number, outcome, len(self._ready) + len(self._tasks), self._num_taken))


def _told(err: Exception) -> Exception:
    """Return an error, in the place of one whose class the other side may be unable to read."""
    if isinstance(err, DvcError):
        return err
    told = RuntimeError(repr(err))
    told.add_note(f"in the decoding process:\n{''.join(traceback.format_exception(err))}")
    return told


class _Decoders:
    """Decoders of groups, which are kept for others of the same configuration."""

    def __init__(self) -> None:
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []

    def taken(self, config: bytes) -> "GroupDecoder":
        """Return one that nobody uses."""
        from decoder.group import GroupDecoder
        from decoder.wyner_ziv import WynerZivDecoder

        if config != self._config:
            self._config, self._idle = config, []
            self._frames = WynerZivDecoder(decode_config(config))
        if self._idle:
            return self._idle.pop()
        return GroupDecoder(decode_config(config), self._frames)

    def give_back(self, decoder: "GroupDecoder", config: bytes) -> None:
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
