"""TCP connections of the feedback channel, plain or inside TLS: its only module with I/O."""

import contextlib
import select
import socket
import ssl
import time
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import wait
from typing import Any, Protocol

from dvc.errors import ConnectionLostError, UntrustedError
from dvc.files import Closing

DEFAULT_TIMEOUT_S = 30.0
"""Default time after which a silent peer is lost."""
_CHUNK_BYTES = 2**18
_MAX_INBOX_BYTES = 2**24
"""Largest amount of data that is received while data are sent."""
_LINGER_S = 1.0
_LINGER_BYTES = 2**24
_AGAIN = BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError


class Readable(Protocol):
    """Object with a file descriptor that can be waited for."""

    def fileno(self) -> int:
        """Return the file descriptor."""


def format_address(address: Sequence[object]) -> str:
    """Return an address as text, of bounded length."""
    host, port = ascii(address[0])[1:81].removesuffix("'"), address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


class Connection(Closing):
    """A TCP connection to the peer.

    It is open, then broken (by an error, by the peer or by `break_off`), and at last closed.

    Parameters
    ----------
    peer : socket
        A connected socket, which may be inside TLS; it is closed with the connection.
    timeout_s : float
        Time after which a peer that acknowledges or takes nothing is lost, in seconds.
    stop : Readable, optional
        Once it is readable, waiting raises `KeyboardInterrupt`.
    """

    def __init__(
        self, peer: socket.socket, timeout_s: float = DEFAULT_TIMEOUT_S, stop: Readable | None = None
    ) -> None:
        self.timeout_s = timeout_s
        self._socket = peer
        self._failure: ConnectionLostError | None = None
        self._inbox: deque[bytes] = deque()
        self._poll = select.poll()
        self._stop_fd = -1 if stop is None else stop.fileno()
        self._fd = peer.fileno()
        try:
            peer.setblocking(False)
            self.name = format_address(peer.getpeername())
            # The system breaks a connection if the peer acknowledges nothing, even if a process is busy.
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            interval_s = max(1, int(timeout_s / 4))
            limits = {"KEEPIDLE": interval_s, "KEEPINTVL": interval_s, "KEEPCNT": 3}
            for name, value in {**limits, "USER_TIMEOUT": int(1000 * timeout_s)}.items():
                if hasattr(socket, f"TCP_{name}"):
                    peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, f"TCP_{name}"), value)
        except OSError as err:
            peer.close()
            raise ConnectionLostError(f"the other side went away: {err.strerror or err}") from err
        if stop is not None:
            self._poll.register(self._stop_fd, select.POLLIN)

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._fd

    def shake_hands(self, within_s: float) -> None:
        """Finish the TLS handshake of a decoder, if it has TLS."""
        peer, deadline_s = self._socket, time.monotonic() + within_s
        if not isinstance(peer, ssl.SSLSocket):
            return
        while True:
            try:
                return peer.do_handshake()
            except _AGAIN:
                if not self._wait_for(select.POLLIN, deadline_s):
                    raise self.lose("takes too long with TLS") from None
            except (ssl.SSLCertVerificationError, ssl.SSLError) as err:
                if isinstance(err, ssl.SSLEOFError | ssl.SSLZeroReturnError):
                    raise self.lose("closed the connection") from err
                raise UntrustedError(f"no TLS with the other side ({self.name}): {_reason(err)}") from err
            except OSError as err:
                raise self.lose("went away", err) from err

    def send(self, data: bytes, within_s: float | None = None) -> None:
        """Send bytes; the peer must take some within each timeout. Data that come are kept for `receive`."""
        rest = memoryview(data)
        patience_s = self.timeout_s if within_s is None else within_s
        deadline_s = time.monotonic() + patience_s
        while rest:
            self._check()
            try:
                rest = rest[self._socket.send(rest[:_CHUNK_BYTES]) :]
                deadline_s = time.monotonic() + patience_s
            except _AGAIN:
                # The peer may take more only after it has sent something.
                receives = sum(map(len, self._inbox)) < _MAX_INBOX_BYTES
                ready = self._wait_for(select.POLLOUT | (select.POLLIN if receives else 0), deadline_s)
                if not ready:
                    raise self.lose(f"takes nothing for {self.timeout_s:g} s") from None
                if ready & select.POLLIN and (received := self._read()) is not None:
                    self._inbox.append(received)
            except OSError as err:
                raise self.lose("went away", err) from err

    def receive(self, within_s: float | None = None) -> bytes:
        """Wait for at most 256 KiB of the peer; return nothing if none came in time."""
        if self._inbox:
            return self._inbox.popleft()
        deadline_s = None if within_s is None else time.monotonic() + within_s
        while (data := self._read()) is None:
            if not self._wait_for(select.POLLIN, deadline_s):
                return b""
        return data

    def _read(self) -> bytes | None:
        """Return received bytes; None if there are none now."""
        self._check()
        try:
            data = self._socket.recv(_CHUNK_BYTES)
        except _AGAIN:
            return None
        except ssl.SSLError as err:
            raise self.lose(f"sent no valid TLS: {_reason(err)}") from err
        except OSError as err:
            raise self.lose("went away", err) from err
        if not data:
            raise self.lose("closed the connection")
        return data

    def _wait_for(self, events: int, deadline_s: float | None) -> int:
        """Wait for events of the socket; return them, 0 after the deadline."""
        self._poll.register(self._fd, events)
        while True:
            left_s = None if deadline_s is None else deadline_s - time.monotonic()
            if left_s is not None and left_s < 0.0:
                return 0
            ready = dict(self._poll.poll(None if left_s is None else 1e3 * left_s))
            if self._stop_fd in ready:
                raise KeyboardInterrupt
            if self._fd in ready:
                return ready[self._fd] | select.POLLIN * bool(ready[self._fd] & ~events)

    def wait(self, more: Sequence[Readable] = (), within_s: float | None = None) -> list[Any]:
        """Wait until this connection or other objects are readable; return these."""
        pending = isinstance(self._socket, ssl.SSLSocket) and self._socket.pending()
        if self._inbox or pending or self._failure is not None:
            return [self, *wait(list[Any](more), 0.0)]
        objects: list[Any] = [self, *more]
        return wait(objects, within_s)

    def break_off(self, reason: str) -> None:
        """Break the connection, from any thread; the thread that uses it gets an error for this reason."""
        self._failure = self._failure or ConnectionLostError(reason)
        with contextlib.suppress(OSError):
            socket.socket.shutdown(self._socket, socket.SHUT_RDWR)

    def lose(self, fault: str, err: OSError | None = None) -> ConnectionLostError:
        """Break the connection for a fault of the peer, a predicate; return the error."""
        cause = "" if err is None else f": {err.strerror or err}"
        if self._failure is None:
            self._failure = ConnectionLostError(f"the other side ({self.name}) {fault}{cause}")
        return self._failure

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def close(self, linger_s: float = _LINGER_S) -> None:
        """Close the connection; data that were sent still arrive if the peer reads them in time."""
        deadline_s, num_bytes = time.monotonic() + linger_s, 0
        with contextlib.closing(self._socket) as peer, contextlib.suppress(OSError, KeyboardInterrupt):
            if self._failure is not None:
                return
            self._failure = ConnectionLostError("the connection is closed")
            socket.socket.shutdown(peer, socket.SHUT_WR)
            # To close a socket with unread data would reset the connection.
            while num_bytes < _LINGER_BYTES and self._wait_for(select.POLLIN, deadline_s):
                data = socket.socket.recv(peer, _CHUNK_BYTES)
                if not data:
                    break
                num_bytes += len(data)


def _reason(err: ssl.SSLError) -> str:
    if isinstance(err, ssl.SSLCertVerificationError):
        return str(err.verify_message)
    return (err.reason or str(err)).lower().replace("_", " ")
