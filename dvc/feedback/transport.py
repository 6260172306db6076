"""Moves the bytes of the feedback channel over TCP: connections, timeouts, nothing else."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import wait
from typing import Any, Protocol

from dvc.errors import ConfigError, FeedbackError, PeerClosedError
from dvc.feedback.protected_socket import Peer, ProtectedSocket
from dvc.feedback.protection import Protection
from dvc.files import Closing

DEFAULT_TIMEOUT_S = 30.0
_CHUNK_BYTES = 2**18
_RETRY_S = 0.1
MIN_TIMEOUT_S = 1.0
"""Least patience that a peer should have, since it gets signs of life several times within that."""
_KEEP_ALIVES_PER_TIMEOUT = 4
_BACKLOG = 16
_LINGER_S = 1.0
_LINGER_BYTES = 2**24


class Readable(Protocol):
    """What can be waited for."""

    def fileno(self) -> int:
        """Return its file descriptor."""


_Address = Any  # what `socket` takes for an address depends on the family


def parse_address(text: str) -> tuple[str, int]:
    """Split an address.

    Parameters
    ----------
    text : str
        ``HOST:PORT``; an IPv6 host in brackets, as ``[::1]:5000``; ``:PORT`` means this machine.

    Returns
    -------
    host : str
        Name or number of the host.
    port : int
        From 0 to 65535.

    Raises
    ------
    ConfigError
        If it is no such address.
    """
    host, colon, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        colon = ""
    if not colon or not port.isascii() or not port.isdigit() or len(port) > 5 or int(port) > 65535:
        raise ConfigError(f"an address must be HOST:PORT with a port up to 65535, got {text[:80]!r}")
    return host or "localhost", int(port)


def _shown(address: tuple[object, ...]) -> str:
    host, port = ascii(address[0])[1:81].removesuffix("'"), address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


class Connection(Closing):
    """A TCP connection to the peer.

    Parameters
    ----------
    peer : socket
        A connected socket; closed with the connection.
    timeout_s : float
        Patience with a silent peer, in seconds, in each direction.
    """

    def __init__(self, peer: socket.socket, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        self._socket: Peer = peer
        self._timeout_s = timeout_s
        self._sending = threading.Lock()
        self._last_sent_s = self._silent_since_s = time.monotonic()
        try:
            peer.settimeout(timeout_s)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            address = peer.getpeername()
            self.name, self.host = _shown(address), str(address[0])
        except OSError as err:
            peer.close()
            raise FeedbackError(f"the other side went away: {err.strerror or err}") from err

    def protect(self, protection: Protection, within_s: float) -> None:
        """Protect the connection before anything else is sent or received.

        Parameters
        ----------
        protection : Protection
            How.
        within_s : float
            Time that this may take, in seconds.

        Raises
        ------
        ConfigError
            If there is no protection, and the peer is on a network.
        FeedbackError
            If the peer does not do its part in time; the connection is closed then.
        """
        protection.check_exposure(self.host)
        try:
            self._socket = protection.applied(self._socket, within_s)
            self._socket.settimeout(self._timeout_s)
        except (OSError, FeedbackError) as err:
            self.close()
            reason = self._error("is silent", err) if isinstance(err, OSError) else err
            raise FeedbackError(f"{self.name}: {reason}") from err

    def send(self, data: bytes) -> None:
        """Send bytes.

        Parameters
        ----------
        data : bytes
            Any number.

        Raises
        ------
        FeedbackError
            If the peer went away, or takes nothing for the timeout.
        """
        rest = memoryview(data)
        with self._sending:
            while rest:
                try:
                    rest = rest[self._socket.send(rest[:_CHUNK_BYTES]) :]
                except OSError as err:
                    raise self._error("takes nothing", err) from err
            self._last_sent_s = time.monotonic()

    def receive(self) -> bytes:
        """Wait for bytes of the peer.

        Returns
        -------
        bytes
            At least one, at most 256 KiB.

        Raises
        ------
        FeedbackError
            If the peer went away, or sends nothing for the timeout.
        """
        try:
            data = self._socket.recv(_CHUNK_BYTES)
        except OSError as err:
            raise self._error("is silent", err) from err
        if not data:
            raise PeerClosedError(f"the other side ({self.name}) closed the connection")
        self._silent_since_s = time.monotonic()
        return data

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    def wait(
        self, others: Sequence[Readable] = (), patient: bool = False, at_most_s: float | None = None
    ) -> list[Any]:
        """Wait until something can be received, of the peer or of others.

        Parameters
        ----------
        others : sequence
            What has a file descriptor that can be read then.
        patient : bool, optional
            Whether the peer may be silent, since nothing is expected of it.
        at_most_s : float, optional
            Longest wait, in seconds.

        Returns
        -------
        list
            This connection, if bytes of the peer or its end are there, and those of `others` that are ready.

        Raises
        ------
        FeedbackError
            If the peer is silent for the timeout while something is expected of it.
        """
        if self._is_pending():
            return [self, *_readable(list(others), 0.0)]
        left_s = None if patient else max(0.0, self._silent_since_s + self._timeout_s - time.monotonic())
        bounds_s = [bound_s for bound_s in (left_s, at_most_s) if bound_s is not None]
        try:
            ready = _readable([self, *others], min(bounds_s, default=None))
        except (OSError, ValueError) as err:
            raise FeedbackError(f"the other side ({self.name}) went away: {err}") from err
        if patient:
            self._silent_since_s = time.monotonic()
        elif not ready and left_s == min(bounds_s):
            raise self._error("is silent", TimeoutError())
        return ready

    def has_received(self) -> bool:
        """Say whether there is something to be received at once, if only the end."""
        return self._is_pending() or bool(_readable([self], 0.0))

    def _is_pending(self) -> bool:
        """Say whether there are bytes that have left the socket already."""
        return isinstance(self._socket, ProtectedSocket) and self._socket.pending

    @contextlib.contextmanager
    def kept_alive(self, message: bytes) -> Iterator[None]:
        """Send a message whenever there was silence for a quarter of any peer's patience, while a block runs.

        Parameters
        ----------
        message : bytes
            A whole message that the peer may get between any two others.

        Yields
        ------
        None
            Nothing; what is sent within the block is never cut by the message.
        """
        interval_s = min(self._timeout_s, MIN_TIMEOUT_S) / _KEEP_ALIVES_PER_TIMEOUT
        done = threading.Event()

        def _speak() -> None:
            while not done.wait(max(self._last_sent_s + interval_s - time.monotonic(), 0.01)):
                if time.monotonic() - self._last_sent_s >= interval_s:
                    try:
                        self.send(message)
                    except FeedbackError:  # the block will see it when it next sends or receives
                        return

        thread = threading.Thread(target=_speak, daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()

    def _error(self, silence: str, err: OSError) -> FeedbackError:
        if isinstance(err, TimeoutError):
            return FeedbackError(f"the other side ({self.name}) {silence} for {self._timeout_s:g} s")
        return FeedbackError(f"the other side ({self.name}) went away: {err.strerror or err}")

    def close(self) -> None:
        """Close the connection; what was sent still arrives, if the peer reads it within a second."""
        self.close_within(_LINGER_S)

    def close_within(self, linger_s: float) -> None:
        """Close the connection; what was sent still arrives, if the peer reads it in time.

        Parameters
        ----------
        linger_s : float
            How long the peer has, in seconds.
        """
        deadline_s, num_bytes = time.monotonic() + linger_s, 0
        with contextlib.closing(self._socket), contextlib.suppress(OSError, FeedbackError):
            self._socket.shutdown(socket.SHUT_WR)
            while num_bytes < _LINGER_BYTES and (left_s := deadline_s - time.monotonic()) > 0:
                self._socket.settimeout(left_s)
                data = self._socket.recv(_CHUNK_BYTES)  # closing on unread bytes would cut off the peer
                if not data:
                    break
                num_bytes += len(data)


class Listener(Closing):
    """A port that waits for peers.

    Parameters
    ----------
    listening : socket
        A bound and listening socket.
    """

    def __init__(self, listening: socket.socket) -> None:
        self._socket = listening
        host, port = listening.getsockname()[:2]
        self.host: str = host
        self.port: int = port
        self.name = _shown((host, port))

    def accept(
        self, timeout_s: float | None = None, silence_timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Connection:
        """Wait for a peer; others wait until this is called again, or are refused when it is closed.

        Parameters
        ----------
        timeout_s : float or None
            How long to wait for a peer, in seconds; None for ever.
        silence_timeout_s : float
            Patience with the peer thereafter, in seconds.

        Returns
        -------
        Connection
            The connection.

        Raises
        ------
        FeedbackError
            If nobody connects.
        """
        try:
            self._socket.settimeout(timeout_s)
            while True:
                peer, _ = self._socket.accept()
                with contextlib.suppress(FeedbackError):  # who is gone already was no peer
                    return Connection(peer, silence_timeout_s)
        except TimeoutError as err:
            raise FeedbackError(f"nobody connected to {self.name} within {timeout_s:g} s") from err
        except OSError as err:
            raise FeedbackError(f"cannot accept a connection on {self.name}: {err.strerror or err}") from err

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()


def _readable(objects: list[Any], timeout_s: float | None) -> list[Any]:
    return wait(objects, timeout_s)


def listen(host: str = "localhost", port: int = 0) -> Listener:
    """Open a port.

    Parameters
    ----------
    host : str
        Address of this machine on which to listen; the loopback unless told otherwise.
    port : int
        0 for any free one, see `Listener.port`.

    Returns
    -------
    Listener
        Waiting.

    Raises
    ------
    FeedbackError
        If the address is not to be had.
    """

    def _bind(listening: socket.socket, address: _Address) -> None:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen(_BACKLOG)

    try:
        return Listener(_open_socket(host, port, _bind))
    except OSError as err:
        raise FeedbackError(f"cannot listen on {_shown((host, port))}: {err.strerror or err}") from err


def connect(host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> Connection:
    """Connect to a peer that listens, or will within the timeout.

    Parameters
    ----------
    host : str
        Name or number of its host.
    port : int
        Its port.
    timeout_s : float
        How long to try, and patience with a silent peer thereafter, in seconds.

    Returns
    -------
    Connection
        The connection.

    Raises
    ------
    FeedbackError
        If nobody listens there.
    """
    deadline_s = time.monotonic() + timeout_s

    def _dial(peer: socket.socket, address: _Address) -> None:
        peer.settimeout(max(_RETRY_S, deadline_s - time.monotonic()))
        peer.connect(address)

    while True:
        try:
            return Connection(_open_socket(host, port, _dial), timeout_s)
        except (ConnectionRefusedError, TimeoutError) as err:
            if time.monotonic() + _RETRY_S >= deadline_s:
                raise FeedbackError(f"nobody listens on {_shown((host, port))}") from err
            time.sleep(_RETRY_S)
        except OSError as err:
            raise FeedbackError(f"cannot connect to {_shown((host, port))}: {err.strerror or err}") from err


def _open_socket(host: str, port: int, use: Callable[[socket.socket, _Address], None]) -> socket.socket:
    """Use a new socket with every address that a host name stands for, until one works."""
    failure: OSError = ConnectionRefusedError()
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except ValueError as err:
        raise OSError(0, "not the name of a host") from err
    for family, kind, protocol, _, address in found:
        opened = socket.socket(family, kind, protocol)
        try:
            use(opened, address)
        except OSError as err:
            opened.close()
            failure = err
        else:
            return opened
    raise failure
