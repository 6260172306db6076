"""Moves the bytes of the feedback channel over TCP: connections, timeouts, nothing else."""

import contextlib
import socket
import time
from collections.abc import Callable
from typing import Any, TypeVar

from dvc.errors import ConfigError, FeedbackError, NobodyListensError, PeerClosedError
from dvc.feedback.protected_socket import Peer, ProtectedSocket
from dvc.feedback.protection import Protection
from dvc.files import Closing

DEFAULT_TIMEOUT_S = 30.0
_CHUNK_BYTES = 2**18
_RETRY_S = 0.1
_BACKLOG = 16
_LINGER_S = 1.0
_LINGER_BYTES = 2**24


Result = TypeVar("Result")
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
        self._failure: FeedbackError | None = None
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
        self._socket = self.talk(lambda peer: protection.applied(peer, within_s))
        self._socket.settimeout(self._timeout_s)

    def talk(self, work: Callable[[Peer], Result]) -> Result:
        """Let something send and receive that comes before all else.

        Parameters
        ----------
        work : callable
            Called with the socket.

        Returns
        -------
        object
            What it returns.

        Raises
        ------
        FeedbackError
            If the peer does not do its part; the connection is closed then.
        """
        try:
            result = work(self._socket)
            self._socket.settimeout(self._timeout_s)
        except (OSError, FeedbackError) as err:
            self.close()
            if isinstance(err, OSError):
                err = self._error("is silent", err)
            raise type(err)(f"{self.name}: {err}") from err
        return result

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
        while rest:
            try:
                rest = rest[self._socket.send(rest[:_CHUNK_BYTES]) :]
            except OSError as err:
                raise self._failure or self._error("takes nothing", err) from err

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
            raise self._failure or self._error("is silent", err) from err
        if not data:
            raise self._failure or PeerClosedError(f"the other side ({self.name}) closed the connection")
        return data

    def break_off(self, reason: FeedbackError) -> None:
        """Let nothing more be sent; who receives what has come already learns the reason after that.

        Parameters
        ----------
        reason : FeedbackError
            What is raised then.
        """
        self._failure = self._failure or reason
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    @property
    def is_broken(self) -> bool:
        """Whether it was broken off."""
        return self._failure is not None

    @property
    def pending(self) -> bool:
        """Whether there are bytes to be received that have left the socket already."""
        return isinstance(self._socket, ProtectedSocket) and self._socket.pending

    def silence(self) -> FeedbackError:
        """Return the error of a peer from which nothing comes.

        Returns
        -------
        FeedbackError
            Not raised.
        """
        return self._error("is silent", TimeoutError())

    def _error(self, silence: str, err: OSError) -> FeedbackError:
        if isinstance(err, TimeoutError):
            return FeedbackError(f"the other side ({self.name}) {silence} for {self._timeout_s:g} s")
        closed = isinstance(err, ConnectionResetError | BrokenPipeError)  # by who has not read all
        kind = PeerClosedError if closed else FeedbackError
        return kind(f"the other side ({self.name}) went away: {err.strerror or err}")

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
        """Stop listening, also where another thread waits for a peer."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


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


def connect(
    host: str, port: int, timeout_s: float = DEFAULT_TIMEOUT_S, silence_timeout_s: float | None = None
) -> Connection:
    """Connect to a peer that listens, or will within the timeout.

    Parameters
    ----------
    host : str
        Name or number of its host.
    port : int
        Its port.
    timeout_s : float
        How long to try, in seconds.
    silence_timeout_s : float, optional
        Patience with a silent peer thereafter, in seconds; the same by default.

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
            return Connection(_open_socket(host, port, _dial), silence_timeout_s or timeout_s)
        except (ConnectionRefusedError, TimeoutError) as err:
            if time.monotonic() + _RETRY_S >= deadline_s:
                raise NobodyListensError(f"nobody listens on {_shown((host, port))}") from err
            time.sleep(_RETRY_S)
        except OSError as err:
            raise NobodyListensError(
                f"cannot connect to {_shown((host, port))}: {err.strerror or err}"
            ) from err


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
