"""The process in which groups of pictures are decoded: `decoder.parallel` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument and, if the encoder is live,
answers to requests. What goes back has the number of its group: requests, and at last the decoded group or
the exception that it ended with. Any number of groups are under way: while some wait for answers, the first
of those that can go on does.
"""

import heapq
import os
import sys
import traceback
from collections.abc import Iterator
from itertools import count
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any

from decoder.tasks import Answered, GroupTask, naming_group
from dvc.config import decode_config
from dvc.errors import DvcError

if TYPE_CHECKING:
    from decoder.group import GroupCoroutine, GroupDecoder
    from decoder.wyner_ziv import WynerZivDecoder


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
    for message in _first_group_first(received):
        try:
            with naming_group(message.number):
                outcome = groups.go_on(message)
        except DvcError as err:
            outcome = err
        except Exception as err:  # whose class the other side may be unable to read
            outcome = RuntimeError(repr(err))
            outcome.add_note(f"in the decoding process:\n{traceback.format_exc()}")
        connection.send((message.number, outcome))


def _first_group_first(received: "SimpleQueue[Any]") -> Iterator[GroupTask | Answered]:
    """Take what was received, always that of the first group of all that is there."""
    waiting: list[tuple[int, int, GroupTask | Answered]] = []
    arrivals = count()
    while True:
        while not waiting or not received.empty():
            message = received.get()
            heapq.heappush(waiting, (message.number, next(arrivals), message))
        yield heapq.heappop(waiting)[-1]


class _Groups:
    """Groups that are under way; their decoders are kept for others of the same configuration."""

    def __init__(self) -> None:
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []
        self._running: dict[int, tuple[GroupDecoder, GroupCoroutine]] = {}

    def go_on(self, message: GroupTask | Answered) -> object:
        """Begin a group, or go on with it; return further requests, or the decoded group."""
        if isinstance(message, GroupTask):
            decoder = self._decoder(message.config)
            self._running[message.number] = decoder, decoder.steps(message)
        decoder, steps = self._running.pop(message.number)
        try:
            if isinstance(message, GroupTask):
                requests = next(steps)
            else:
                requests = steps.send((message.place, message.bits))
        except StopIteration as stop:
            self._idle.append(decoder)
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
