"""The process in which groups of pictures are decoded: `decoder.processes` starts it and talks to it.

Tasks come through the connection whose file descriptor is the only argument and, if the encoder is live,
answers to requests. What goes back has the number of its group: requests, and at last the decoded group or
the exception that it ended with. Groups of a stream, whose records answer, are decoded one after the other.
Each group of a live encoder has a thread, and so has each frame of a level: while some wait for answers,
others go on, first of all those with the most to be decoded after them. Memory bounds how many frames are
decoded at the same time, however many groups are open.
"""

import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

from decoder.tasks import Answered, Bits, DecodedFrame, GroupTask, naming_group
from decoder.team import Rank, Team
from dvc import slepian_wolf
from dvc.config import VideoConfig, decode_config
from dvc.errors import DvcError

if TYPE_CHECKING:
    from decoder.group import GroupDecoder
    from decoder.wyner_ziv import FrameCoroutine, WynerZivDecoder


def serve(connection: "Connection[Any, Any]") -> None:
    """Decode groups until nobody wants any."""
    parent, team, tasks = _Parent(connection), Team(), SimpleQueue[GroupTask]()
    Thread(target=_receive, args=(parent, tasks), daemon=True).start()
    _import_opencv_quietly()
    decoders = _Decoders()
    while True:
        task = tasks.get()
        if task.form is None:
            Thread(target=_decode, args=(task, decoders, parent, team), daemon=True).start()
        else:
            _decode(task, decoders, parent, team)


def _receive(parent: "_Parent", tasks: "SimpleQueue[GroupTask]") -> None:
    """Take what comes."""
    while True:
        with _ending_alone():
            messages = parent.connection.recv()
        for message in messages:
            if isinstance(message, Answered):
                parent.answers.pop(message.frame).put(message.bits)
            else:
                tasks.put(message)


@contextmanager
def _ending_alone() -> Iterator[None]:
    """End the process, whatever it does, where nobody is left who wants it."""
    try:
        yield
    except (EOFError, OSError):
        os._exit(0)


def _decode(task: GroupTask, decoders: "_Decoders", parent: "_Parent", team: Team) -> None:
    """Decode a group, and send what comes of it."""
    outcome: object
    try:
        with naming_group(task.number), decoders.lent(task.config) as decoder:
            encoder = None
            if task.form is None:
                parent.send(task.number, (), 1)
                encoder = _Encoder(task.number, decode_config(task.config).video, parent, team)
            outcome = decoder.decode(task, encoder)
    except DvcError as err:
        outcome = err
    except Exception as err:  # whose class the other side may be unable to read
        outcome = RuntimeError(repr(err))
        outcome.add_note(f"in the decoding process:\n{traceback.format_exc()}")
    parent.send(task.number, outcome, int(task.form is not None))


class _Parent:
    """The process that wants groups decoded."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self.connection = connection
        self.answers: dict[int, SimpleQueue[Sequence[Bits]]] = {}  # to come, by frame
        self._sending = Lock()

    def send(self, number: int, outcome: object, steps: int = 0) -> None:
        """Send what a group comes to, and how many steps less of decoding are under way."""
        with self._sending, _ending_alone():
            self.connection.send((number, outcome, steps))


class _Encoder:
    """The live encoder, as the frames of a group see it: each waits for its own answers."""

    def __init__(self, number: int, video: VideoConfig, parent: _Parent, team: Team) -> None:
        self._number, self._parent, self._team = number, parent, team
        self._frame_px = video.width * video.height
        self._rank: Rank = ()

    def decode_level(self, rank: Rank, frames: "Sequence[FrameCoroutine]") -> list[DecodedFrame]:
        """Decode frames side by side, once there is memory for them."""
        self._rank = rank
        with self._team.pixels.taken(len(frames) * self._frame_px, rank):
            self._parent.send(self._number, (), -len(frames))
            return self._team.run([partial(self._drive, frame) for frame in frames], rank)

    def _drive(self, frame: "FrameCoroutine") -> DecodedFrame:
        try:
            return slepian_wolf.drive(frame, self._answers)
        finally:  # else requests of others would be held for this one
            self._parent.send(self._number, (), 1)

    def _answers(self, requests: slepian_wolf.Round) -> Sequence[Bits]:
        """Ask for bits, and leave the core to others until they come."""
        answers = self._parent.answers[requests[0].frame] = SimpleQueue[Sequence[Bits]]()
        self._parent.send(self._number, requests, 1)
        with self._team.core.given(1, self._rank):
            return answers.get()


class _Decoders:
    """Decoders of groups, which are kept for others of the same configuration."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._config = b""
        self._frames: WynerZivDecoder | None = None
        self._idle: list[GroupDecoder] = []

    @contextmanager
    def lent(self, config: bytes) -> "Iterator[GroupDecoder]":
        """Lend one; it does not come back where it fails."""
        decoder = self._taken(config)
        yield decoder
        if config == self._config:
            self._idle.append(decoder)

    def _taken(self, config: bytes) -> "GroupDecoder":
        from decoder.group import GroupDecoder
        from decoder.wyner_ziv import WynerZivDecoder

        with self._lock:
            if config != self._config:
                self._config, self._idle = config, []
                self._frames = WynerZivDecoder(decode_config(config))
            if self._idle:
                return self._idle.pop()
            return GroupDecoder(decode_config(config), self._frames)


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
