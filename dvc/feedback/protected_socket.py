"""Sockets that change what passes through them."""

import socket
import time
from abc import ABC, abstractmethod

from dvc.errors import FeedbackError, PeerClosedError

MAX_READ_BYTES = 2**18


class ProtectedSocket(ABC):
    """Like a socket; what came must be opened before it is read, which may take more than has come."""

    def __init__(self, peer: "Peer") -> None:
        self._peer = peer
        self._opened = b""

    @property
    def pending(self) -> bool:
        """Whether there is something that has left the socket, but was not read."""
        return bool(self._opened) or (isinstance(self._peer, ProtectedSocket) and self._peer.pending)

    def recv(self, max_bytes: int) -> bytes:
        """Return what has come, waiting until something can be opened; nothing where the peer has ended."""
        while not self._opened:
            data = self._peer.recv(MAX_READ_BYTES)
            if not data:
                return b""
            self._opened = self._open(data)
        data, self._opened = self._opened[:max_bytes], self._opened[max_bytes:]
        return data

    @abstractmethod
    def send(self, data: "bytes | memoryview") -> int:
        """Send some of the data; return how much."""

    @abstractmethod
    def _open(self, data: bytes) -> bytes:
        """Take in what came, and return what can be opened."""

    def sendall(self, data: bytes) -> None:
        """Send data."""
        rest = memoryview(data)
        while rest:
            rest = rest[self.send(rest) :]

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._peer.fileno()

    def settimeout(self, timeout_s: float | None) -> None:
        """Wait no longer than this."""
        self._peer.settimeout(timeout_s)

    def shutdown(self, how: int) -> None:
        """End one direction."""
        self._peer.shutdown(how)

    def close(self) -> None:
        """Close the socket."""
        self._peer.close()


Peer = socket.socket | ProtectedSocket


def read_before(deadline_s: float, peer: Peer, max_bytes: int, purpose: str) -> bytes:
    """Read at least a byte before a deadline of the monotonic clock; `purpose` is for messages."""
    while (left_s := deadline_s - time.monotonic()) > 0:
        peer.settimeout(left_s)
        try:
            data = peer.recv(max_bytes)
        except TimeoutError:
            continue
        if not data:
            raise PeerClosedError(f"the other side closed the connection in place of {purpose}")
        return data
    raise FeedbackError(f"the other side takes too long with {purpose}")


def read_exactly(deadline_s: float, peer: Peer, count: int, purpose: str) -> bytes:
    """Read so many bytes and no more."""
    data = b""
    while len(data) < count:
        data += read_before(deadline_s, peer, count - len(data), purpose)
    return data
