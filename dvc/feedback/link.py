"""The feedback channel's stream of bytes, which outlives the connections that it takes.

The decoder, which connects, comes back when a connection is lost; the encoder waits for it. Until then what
is sent is kept. Bytes that come are checked, so that what was changed on the way is a lost connection.
"""

import contextlib
import secrets
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any, Final, Protocol, TypeVar

from dvc.errors import (
    DvcError,
    FeedbackError,
    NobodyListensError,
    RefusedError,
    SupersededError,
    UntrustedError,
)
from dvc.feedback.opening import NEW, SESSION_BYTES, Opening, checks, open_stream
from dvc.feedback.protection import Protection
from dvc.feedback.resumable import Checks, ResumableStream
from dvc.feedback.transport import DEFAULT_TIMEOUT_S, Connection, connect
from dvc.files import Closing

MAX_KEPT_BYTES: Final = 2**26
"""Most that is kept of what the other side may have to be sent again."""
SIGN_OF_LIFE_S: Final = 0.25
"""Longest time in which nothing is sent; least patience of the other side is four times as long."""
_RETRY_S: Final = 0.2
_MAX_RETRY_S: Final = 2.0
_ATTEMPT_S: Final = 5.0
"""Time to connect again, after which it is tried anew."""


class Readable(Protocol):
    """What can be waited for."""

    def fileno(self) -> int:
        """Return its file descriptor."""


@dataclass
class LinkCounts:
    """What a link has gone through."""

    num_reconnections: int = 0
    away_s: float = 0.0
    bytes_sent_again: int = 0


class Link(Closing):
    """One end of the channel, of which one thread receives and sends; `session` is its name.

    `patience_s`: how long a lost connection may take to come back, 0 where it ends the link; `reconnect` gets
    another one within so many seconds; without it the other side comes back.
    """

    def __init__(
        self,
        session: bytes,
        timeout_s: float,
        patience_s: float = 0.0,
        reconnect: Callable[[float], Connection] | None = None,
    ) -> None:
        self.session = session
        self._num_reconnections, self._away_s = 0, 0.0
        self._timeout_s, self._patience_s, self._reconnect = timeout_s, patience_s, reconnect
        self._stream = ResumableStream()
        self._connection: Connection | None = None
        self._name = ""
        self._state = threading.Condition()  # for the stream, and for which connection it has
        self._writing = threading.Lock()  # taken before the state
        self._failure: FeedbackError | None = None
        self._reason: FeedbackError | None = None  # why the last connection was lost
        self._lost_s: float | None = time.monotonic()  # since when nothing has come whole
        self._silent_since_s = self._last_sent_s = time.monotonic()
        self._inbox: list[bytes] = []
        self._lost: list[Connection] = []
        self._closed = threading.Event()
        self._leaving = False
        self._woken, self._waking = socket.socketpair()
        self._waking.setblocking(False)

    @property
    def name(self) -> str:
        """Address of the other side."""
        return self._name

    @property
    def counts(self) -> LinkCounts:
        """How often the connection was lost, and what that cost."""
        return LinkCounts(self._num_reconnections, round(self._away_s, 3), self._stream.num_bytes_again)

    # --- connections -----------------------------------------------------------------------------------

    def start(self, connection: Connection, num_received: int, begin: Checks) -> None:
        """Take the first connection."""
        self._take_connection(connection, num_received, begin)
        self._lost_s = None

    def _take_connection(self, connection: Connection, num_received: int, begin: Checks) -> None:
        with self._writing, self._state:
            if self._closed.is_set():
                connection.close_within(0.0)
                return
            self._stream.begin(num_received, begin)
            self._connection, self._name = connection, connection.name
            self._silent_since_s = time.monotonic()
            self._state.notify_all()
        self._push()
        self._wake()

    def resume(self, connection: Connection, asked: Opening) -> None:
        """Go on, as the encoder, with a connection whose decoder asks for it, if it may."""
        with self._state:
            self._stream.check(asked.num_received)
            old = self._connection
        if old is not None:
            old.break_off(FeedbackError(f"the other side has come back as {connection.name}"))
        with self._writing, self._state:
            self._leave(old)
            answer = Opening(self.session, self._stream.num_received)
        connection.talk(lambda peer: peer.sendall(answer.encode()))
        decoder, encoder = checks(asked, answer)
        self._num_reconnections += 1
        self._take_connection(connection, asked.num_received, Checks(encoder, decoder))

    def wait_until_lost(self, at_most_s: float) -> bool:
        """Wait until there is no connection; tell whether there is none."""
        with self._state:
            return self._state.wait_for(
                lambda: self._connection is None or self._connection.is_broken, at_most_s
            )

    def supersede(self) -> None:
        """Give up the other side, since another one has come in its place."""
        self._fail(SupersededError("another decoder has come in place of the one before"))

    def _fail(self, failure: FeedbackError) -> None:
        with self._state:
            self._failure = self._failure or failure
        self._wake()

    def _leave(self, connection: Connection | None) -> None:
        """Have no connection any more."""
        if connection is not None and connection is self._connection:
            self._connection = None
            self._lost.append(connection)
            self._lost_s = self._lost_s or time.monotonic()
            self._state.notify_all()

    def _lose(self, connection: Connection, reason: FeedbackError) -> None:
        """Notice, as the thread that receives, that a connection is of no use any more."""
        connection.break_off(reason)
        with self._state:
            if connection is not self._connection:
                return
            self._leave(connection)
            self._reason = reason
        if not self._patience_s:
            self._fail(reason)
        elif self._reconnect is not None:
            threading.Thread(target=self._come_back, name="reconnecting", daemon=True).start()

    def _come_back(self) -> None:
        """Connect until it is too late; whoever waits for something to receive notices that."""
        while not self._closed.is_set() and (left_s := self._patience_left_s()) > 0.0:
            try:
                self._ask_to_resume(min(left_s, self._timeout_s, _ATTEMPT_S))
                return
            except RefusedError as err:
                self._fail(err)
                return
            except NobodyListensError as err:
                if self._leaving:  # and has all that it could want
                    self._fail(err)
                    return
            except DvcError:  # this time
                pass
            self._closed.wait(_RETRY_S)

    def _ask_to_resume(self, within_s: float) -> None:
        assert self._reconnect is not None
        connection = self._reconnect(_RETRY_S if self._leaving else within_s)
        asked = Opening(self.session, self._stream.num_received)
        answer, begin = connection.talk(lambda peer: open_stream(peer, asked, within_s))
        if answer.session != self.session:
            connection.close_within(0.0)
            raise RefusedError("the encoder goes on with another stream")
        self._num_reconnections += 1
        self._take_connection(connection, answer.num_received, begin)

    def _patience_left_s(self) -> float:
        lost_s = self._lost_s
        return self._patience_s if lost_s is None else lost_s + self._patience_s - time.monotonic()

    # --- bytes -----------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Send bytes; where there is no connection they are kept, until they are too many."""
        if data:
            self._make_room(len(data))
            with self._state:
                self._stream.keep(data)
            self._push()
        self._check()

    def _make_room(self, num_bytes: int) -> None:
        """Wait until so much more may be kept; what comes meanwhile is received later."""
        started_s, num_kept = time.monotonic(), self._stream.num_kept
        while 0 < self._stream.num_kept > MAX_KEPT_BYTES - num_bytes:
            self._inbox.append(self._receive())
            if self._stream.num_kept < num_kept:
                started_s, num_kept = time.monotonic(), self._stream.num_kept
            waited_s = time.monotonic() - started_s
            if waited_s > self._timeout_s + self._patience_s or sum(map(len, self._inbox)) > MAX_KEPT_BYTES:
                raise FeedbackError(f"the other side ({self.name}) does not say to have what was sent")

    def _push(self, sign_of_life: bool = False) -> None:
        """Send what there is to send, if there is a connection."""
        with self._writing:
            while (connection := self._connection) is not None and not connection.is_broken:
                with self._state:
                    pieces = self._stream.pieces(sign_of_life)
                if not pieces:
                    return
                sign_of_life = False
                try:
                    connection.send(pieces)
                except FeedbackError as err:
                    connection.break_off(err)  # what has come already is received all the same
                self._last_sent_s = time.monotonic()

    def receive(self) -> bytes:
        """Wait for something of the other side; it may be a sign of life, which is no bytes."""
        return self._inbox.pop(0) if self._inbox else self._receive()

    def _receive(self) -> bytes:
        self._check()
        while (connection := self._connection) is None:
            self._wait([], False, None)
        try:
            raw = connection.receive()
            with self._state:
                data = self._stream.receive(raw) if connection is self._connection else b""
                if self._stream.damage is not None:
                    connection.break_off(self._stream.damage)  # which is raised the next time
        except FeedbackError as err:
            self._lose(connection, err)
            self._let_go()
            self._check()
            return b""
        self._silent_since_s = time.monotonic()
        if self._lost_s is not None and self._stream.num_pieces:
            self._away_s += self._silent_since_s - self._lost_s
            self._lost_s = None
        if self._stream.is_owing:
            self._push(sign_of_life=True)
        return data

    def has_received(self) -> bool:
        """Say whether there is something to be received at once, if only the end."""
        connection = self._connection
        return bool(self._inbox) or (
            connection is not None and (connection.pending or bool(_readable([connection], 0.0)))
        )

    def fileno(self) -> int:
        """Return the file descriptor of the connection."""
        connection = self._connection
        return self._woken.fileno() if connection is None else connection.fileno()

    def wait(
        self, others: Sequence[Readable] = (), patient: bool = False, at_most_s: float | None = None
    ) -> list[Any]:
        """Wait until something can be received; return which of this link and others are ready.

        `patient`: whether the other side may be silent, since nothing is expected of it.
        """
        if self._inbox:
            return [self, *_readable(list(others), 0.0)]
        return self._wait(others, patient, at_most_s)

    def _wait(self, others: Sequence[Readable], patient: bool, at_most_s: float | None) -> list[Any]:
        """Wait once; return which of others are ready, and this link if its connection is."""
        self._check()
        self._let_go()
        connection, now_s = self._connection, time.monotonic()
        if connection is None:
            left_s = None if self._lost_s is None else max(0.0, self._patience_left_s())
        else:
            if connection.pending:
                return [self, *_readable(list(others), 0.0)]
            left_s = None if patient else max(0.0, self._silent_since_s + self._timeout_s - now_s)
        bounds_s = [bound_s for bound_s in (left_s, at_most_s) if bound_s is not None]
        watched = [self._woken, *others] + [connection] * (connection is not None)
        ready = _readable(watched, min(bounds_s, default=None))
        if self._woken in ready:
            ready.remove(self._woken)
            self._woken.recv(2**12)
            self._check()
        elif not ready and left_s is not None and left_s == min(bounds_s):
            self._end_patience(connection)
        if patient:
            self._silent_since_s = time.monotonic()
        return [self if one is connection else one for one in ready]

    def _end_patience(self, connection: Connection | None) -> None:
        """Notice that nothing has come for too long."""
        if connection is not None:
            self._lose(connection, connection.silence())
        elif self._connection is None:
            reason = self._reason or f"the other side ({self.name}) went away"
            self._fail(FeedbackError(f"{reason}; it has not come back for {self._patience_s:g} s"))
        self._check()

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _let_go(self) -> None:
        """Close what was lost; only who waits for them may."""
        while self._lost:
            self._lost.pop().close_within(0.0)

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            self._waking.send(b"x")

    def keep_alive(self) -> None:
        """Give signs of life from now on, which acknowledge what has come, whatever else this side does."""
        threading.Thread(target=self._give_signs_of_life, name="keep-alive", daemon=True).start()

    def _give_signs_of_life(self) -> None:
        """Say something whenever there was silence for a while."""
        interval_s = min(self._timeout_s / 4, SIGN_OF_LIFE_S)
        while not self._closed.wait(max(self._last_sent_s + interval_s - time.monotonic(), 0.01)):
            if time.monotonic() - self._last_sent_s >= interval_s:
                self._push(sign_of_life=True)
                self._last_sent_s = time.monotonic()  # nor is anything sent where there is no connection

    # --- the end ---------------------------------------------------------------------------------------

    def deliver(self) -> None:
        """Wait until the other side has all that was sent, or nobody is there who wants it."""
        self._leaving = True
        with contextlib.suppress(FeedbackError):
            while self._stream.num_kept:
                self.receive()

    def close(self) -> None:
        """Close the link; what was sent still arrives, if the other side reads it within a second."""
        if self._connection is not None and not self._closed.is_set():
            self._push(sign_of_life=True)
        self._closed.set()
        with self._state:
            connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        self._let_go()
        for end in (self._woken, self._waking):
            end.close()


def _readable(objects: list[Any], timeout_s: float | None) -> list[Any]:
    return wait(objects, timeout_s)


def welcome(connection: Connection, asked: Opening, timeout_s: float, patience_s: float = 0.0) -> Link:
    """Begin a stream, as the encoder, with a decoder that has none yet."""
    link = Link(secrets.token_bytes(SESSION_BYTES), timeout_s, patience_s)
    answer = Opening(link.session)
    connection.talk(lambda peer: peer.sendall(answer.encode()))
    decoder, encoder = checks(asked, answer)
    link.start(connection, 0, Checks(encoder, decoder))
    return link


Opened = TypeVar("Opened")


def dial(
    host: str,
    port: int,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    protection: Protection | None = None,
    patience_s: float = 0.0,
    lost: Callable[[FeedbackError], None] = lambda _: None,
) -> Link:
    """Connect, as the decoder, to an encoder that listens, or will within the timeout, and begin a stream.

    Where the connection is lost before that, `lost` is told once, and it is tried again for so long.
    """

    def reconnect(within_s: float) -> Connection:
        connection = connect(host, port, within_s, timeout_s)
        connection.protect(protection or Protection(False), within_s)
        return connection

    def attempt(within_s: float) -> tuple[Connection, Opening, Checks]:
        connection = reconnect(within_s)
        return connection, *connection.talk(lambda peer: open_stream(peer, Opening(NEW), within_s))

    connection, answer, begin = _patiently(attempt, timeout_s, patience_s, lost)
    link = Link(answer.session, timeout_s, patience_s, reconnect)
    link.start(connection, 0, begin)
    return link


def _patiently(
    attempt: Callable[[float], Opened],
    timeout_s: float,
    patience_s: float,
    lost: Callable[[FeedbackError], None],
) -> Opened:
    """Try, and try again where a connection is lost, less and less often."""
    first_s, pause_s, within_s = 0.0, _RETRY_S, timeout_s
    while True:
        try:
            return attempt(within_s)
        except (NobodyListensError, RefusedError, UntrustedError):
            raise
        except FeedbackError as err:
            now_s = time.monotonic()
            if not first_s and patience_s:
                lost(err)
            first_s = first_s or now_s
            within_s = min(timeout_s, first_s + patience_s - now_s - pause_s)
            if within_s <= 0.0:
                raise
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, _MAX_RETRY_S)
