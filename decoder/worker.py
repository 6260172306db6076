"""The process in which groups of pictures are decoded: `decoder.parallel` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument and, if the encoder is live,
answers to requests. What goes back has the number of its group: requests, and at last the decoded group or
the exception that it ended with. Any number of groups are under way: while some wait for answers, another
that can go on does, first of all the one with the most to be decoded after what it is at.
"""

import heapq
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from itertools import count
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, TypeVar

from decoder.tasks import Answered, GroupTask, naming_group
from dvc.config import decode_config
from dvc.errors import DvcError

if TYPE_CHECKING:
    from decoder.group import GroupCoroutine, GroupDecoder
    from decoder.wyner_ziv import WynerZivDecoder

Message = TypeVar("Message", bound=GroupTask | Answered)


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until nobody wants any.

    Parameters
    ----------
    connection : Connection
        The other end of that of a `DecodingProcess`.
    """
    received: SimpleQueue[Any] = SimpleQueue()
    Thread(target=_receive, args=(connection, received), daemon=True).start()
    _import_opencv_quietly()
    groups = _Groups()
    for message in longest_way_first(received, groups.levels_left):
        try:
            with naming_group(message.number):
                outcome = groups.go_on(message)
        except DvcError as err:
            outcome = err
        except Exception as err:  # whose class the other side may be unable to read
            outcome = RuntimeError(repr(err))
            outcome.add_note(f"in the decoding process:\n{traceback.format_exc()}")
        connection.send((message.number, outcome))


def longest_way_first(
    received: "SimpleQueue[Message]", levels_left: Callable[[Message], int]
) -> Iterator[Message]:
    """Take what was received: what others wait for does not wait for them.

    In the end, only frames that can go side by side are left.

    Parameters
    ----------
    received : SimpleQueue
        Tasks and answers, to which others are added at any time.
    levels_left : callable
        Tells how many levels of frames are decoded from that of a message on.

    Yields
    ------
    GroupTask or Answered
        Of all that is there, what has the most levels left; of the same, what is of the first group.
    """
    waiting: list[tuple[int, int, int, Message]] = []
    arrivals = count()
    while True:
        while not waiting or not received.empty():
            message = received.get()
            heapq.heappush(waiting, (-levels_left(message), message.number, next(arrivals), message))
        yield heapq.heappop(waiting)[-1]


class _Groups:
    """Groups that are under way; their decoders are kept for others of the same configuration."""

    def __init__(self) -> None:
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []
        self._running: dict[int, tuple[GroupDecoder, GroupCoroutine]] = {}
        self._levels_left: dict[int, dict[int, int]] = {}  # of each frame of the groups under way

    def levels_left(self, message: GroupTask | Answered) -> int:
        """Return how many levels of its group are decoded from that of a message on."""
        if isinstance(message, GroupTask):
            return sys.maxsize  # a group begins at once
        return self._levels_left[message.number][message.place[0]]

    def go_on(self, message: GroupTask | Answered) -> object:
        """Begin a group, or go on with it; return further requests, or the decoded group."""
        if isinstance(message, GroupTask):
            decoder = self._decoder(message.config)
            self._running[message.number] = decoder, decoder.steps(message)
            self._levels_left[message.number] = decoder.levels_left(message)
        decoder, steps = self._running.pop(message.number)
        try:
            if isinstance(message, GroupTask):
                requests = next(steps)
            else:
                requests = steps.send((message.place, message.bits))
        except StopIteration as stop:
            self._idle.append(decoder)
            del self._levels_left[message.number]
            return stop.value
        self._running[message.number] = decoder, steps
        return requests

    def _decoder(self, config: bytes) -> "GroupDecoder":
        from decoder.group import GroupDecoder
        from decoder.wyner_ziv import WynerZivDecoder

        if config != self._config:
            self._config, self._idle = config, []
            self._frames = WynerZivDecoder(decode_config(config))
        return self._idle.pop() if self._idle else GroupDecoder(decode_config(config), self._frames)


def _receive(connection: "Connection[Any, Any]", received: "SimpleQueue[Any]") -> None:
    """Take what comes; end the process, whatever it does, where nobody is left who wants it."""
    try:
        while True:
            received.put(connection.recv())
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
