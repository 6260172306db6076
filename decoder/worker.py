"""The process in which groups of pictures are decoded: `decoder.processes` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument and, if the encoder is live,
answers to requests. What goes back has the number of its group: requests, the last frame of a group that no
key frame ends as soon as it is decoded, and at last the decoded group or the exception that it ended with.
Groups of a stream, whose records answer, are decoded one after the other. Of a live encoder any number are
under way: while some wait for answers, another that can go on does, first of all the one with the most to be
decoded after what it is at. Of frames that are decoded at the same time there are no more than memory is for,
however many groups are open.
"""

import heapq
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from decoder.side_information.protocol import ReferenceFrame
from decoder.tasks import Answered, Bits, Cores, GroupTask, naming_group
from decoder.team import Team
from dvc.config import decode_config
from dvc.errors import DvcError
from dvc.slepian_wolf import Place

if TYPE_CHECKING:
    from decoder.group import GroupCoroutine, GroupDecoder
    from decoder.wyner_ziv import WynerZivDecoder

MAX_ACTIVE_PX = 3 << 22
"""Pixels of all frames that are decoded at a time, where that leaves one level of one group."""


class NextLevel(NamedTuple):
    """The turn of a group to begin its next level of frames."""

    number: int


Message = TypeVar("Message", bound=GroupTask | Answered | NextLevel)


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until nobody wants any."""
    received: SimpleQueue[Any] = SimpleQueue()
    team = Team()
    Thread(target=_receive, args=(connection, received, team), daemon=True).start()
    _import_opencv_quietly()

    def hand_on(number: int, last: ReferenceFrame) -> None:
        connection.send((number, last, False))

    groups = _Groups(LevelTurns(received.put), hand_on, team)
    for message in longest_way_first(received, groups.levels_left):
        try:
            with naming_group(message.number):
                outcome = groups.go_on(message)
        except DvcError as err:
            outcome = err
        except Exception as err:  # whose class the other side may be unable to read
            outcome = RuntimeError(repr(err))
            outcome.add_note(f"in the decoding process:\n{traceback.format_exc()}")
        connection.send((message.number, outcome, not isinstance(message, NextLevel)))


def longest_way_first(
    received: "SimpleQueue[Message]", levels_left: Callable[[Message], int]
) -> Iterator[Message]:
    """Take what was received: what others wait for does not wait for them."""
    waiting: list[tuple[int, int, int, Message]] = []
    arrivals = count()
    while True:
        while not waiting or not received.empty():
            message = received.get()
            heapq.heappush(waiting, (-levels_left(message), message.number, next(arrivals), message))
        yield heapq.heappop(waiting)[-1]


class LevelTurns:
    """Whose turn it is to begin a level: of as many groups at a time as memory is for."""

    def __init__(self, begin: Callable[[NextLevel], object]) -> None:
        self._begin = begin
        self._waiting: list[tuple[int, int, int]] = []
        self._active: dict[int, int] = {}  # pixels of the levels under way, by group

    def wait(self, number: int, levels_left: int, num_pixels: int) -> None:
        """Let a group wait for its turn, which has ended the level before."""
        heapq.heappush(self._waiting, (-levels_left, number, num_pixels))
        self.end(number)

    def end(self, number: int) -> None:
        """Notice that a group takes no memory now."""
        self._active.pop(number, None)
        while self._waiting:
            _, number, num_pixels = self._waiting[0]
            if self._active and sum(self._active.values()) + num_pixels > MAX_ACTIVE_PX:
                return
            heapq.heappop(self._waiting)
            self._active[number] = num_pixels
            self._begin(NextLevel(number))


@dataclass
class _Group:
    """A group under way."""

    decoder: "GroupDecoder"
    steps: "GroupCoroutine"
    frame_px: int
    level_sizes: list[int]
    levels_left: int  # that are not decoded


class _Groups:
    """Groups that are under way; their decoders are kept for others of the same configuration."""

    def __init__(
        self, turns: LevelTurns, hand_on: Callable[[int, ReferenceFrame], object], team: Team
    ) -> None:
        self._turns, self._hand_on, self._team = turns, hand_on, team
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []
        self._running: dict[int, _Group] = {}

    def levels_left(self, message: GroupTask | Answered | NextLevel) -> int:
        """Return how many levels of its group are decoded from that of a message on."""
        if isinstance(message, GroupTask):
            return sys.maxsize  # begins at once
        group = self._running.get(message.number)
        return group.levels_left if group else 0

    def go_on(self, message: GroupTask | Answered | NextLevel) -> object:
        """Begin a group, or go on with it; return further requests, or the decoded group."""
        if isinstance(message, GroupTask):
            return self._begin(message)
        number = message.number
        answer = (message.place, message.bits) if isinstance(message, Answered) else None
        return self._advance(number, self._running.pop(number), answer)

    def _begin(self, task: GroupTask) -> object:
        """Begin a group; of a stream, decode it."""
        decoder = self._decoder(task.config)
        if task.form is not None:
            group = decoder.decode(task, partial(self._hand_on, task.number))
            self._idle.append(decoder)
            return group
        video, sizes = decode_config(task.config).video, decoder.level_sizes(task)
        running = _Group(decoder, decoder.steps(task), video.width * video.height, sizes, len(sizes) + 1)
        return self._advance(task.number, running, None)

    def _advance(self, number: int, group: _Group, answer: tuple[Place, Bits] | None) -> object:
        """Go on with a group of a live encoder."""
        try:
            requests = group.steps.send(answer)
            if isinstance(requests, ReferenceFrame):
                self._hand_on(number, requests)
                requests = group.steps.send(None)
        except BaseException as err:
            self._turns.end(number)
            if not isinstance(err, StopIteration):
                raise
            self._idle.append(group.decoder)
            return err.value
        self._running[number] = group
        if requests is None:
            group.levels_left -= 1
            num_frames = group.level_sizes[-group.levels_left]
            self._turns.wait(number, group.levels_left, num_frames * group.frame_px)
        return requests or ()

    def _decoder(self, config: bytes) -> "GroupDecoder":
        from decoder.group import GroupDecoder
        from decoder.wyner_ziv import WynerZivDecoder

        if config != self._config:
            self._config, self._idle = config, []
            self._frames = WynerZivDecoder(decode_config(config))
        if self._idle:
            return self._idle.pop()
        return GroupDecoder(decode_config(config), self._frames, team=self._team)


def _receive(connection: "Connection[Any, Any]", received: "SimpleQueue[Any]", team: Team) -> None:
    """Take what comes; end the process, whatever it does, where nobody is left who wants it."""
    try:
        while True:
            message = connection.recv()
            if isinstance(message, Cores):
                team.resize(message.number)
            else:
                received.put(message)
    except (EOFError, OSError):
        os._exit(0)


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
