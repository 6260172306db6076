"""Ways of the two ends to each other: addresses, and protection by TLS and a shared token inside it."""

import contextlib
import hashlib
import hmac
import socket
import ssl
import time
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path

from dvc.errors import ConfigError, ConnectionLostError, FeedbackError, NobodyListensError, UntrustedError
from dvc.feedback.messages import MAX_TOKEN_BYTES
from dvc.feedback.transport import DEFAULT_TIMEOUT_S, Connection, Readable, format_address
from dvc.files import Closing

MIN_TOKEN_BYTES = 16
"""Length of the shortest token that is accepted."""
_FINGERPRINT_DIGITS = 64
_RETRY_S = 0.1
_BACKLOG = 128


@dataclass(frozen=True)
class Protection:
    """Protection of one end of a connection.

    Attributes
    ----------
    tls : SSLContext or None
        Certificate of the encoder, or trusted authorities of the decoder; None: plain TCP.
    token : bytes
        Shared secret, see `read_token`; empty without one. It is only sent inside TLS.
    fingerprint : bytes or None
        SHA-256 of the certificate that the encoder must have.
    insecure : bool
        Whether plain TCP is allowed beyond this machine.
    """

    tls: ssl.SSLContext | None = None
    token: bytes = b""
    fingerprint: bytes | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if self.token and self.tls is None:
            raise ConfigError(
                "--token-file requires TLS: --tls-cert (encoder), --tls-ca or --fingerprint (decoder)"
            )

    def check_exposure(self, host: str) -> None:
        """Refuse plain TCP with a numerical address of another machine, unless it is allowed."""
        if self.tls is None and not self.insecure and not ip_address(host.partition("%")[0]).is_loopback:
            raise ConfigError(f"{host} is on a network: TLS or --insecure is required")

    def accepts(self, token: bytes) -> bool:
        """Return whether a decoder sent the right token, in constant time."""
        return hmac.compare_digest(token, self.token)

    def wrap(self, peer: socket.socket, host: str | None = None) -> socket.socket:
        """Return a connected socket inside TLS, before its handshake; `host` is the name of the encoder."""
        if self.tls is None:
            return peer
        return self.tls.wrap_socket(peer, host is None, do_handshake_on_connect=False, server_hostname=host)

    def check_certificate(self, peer: socket.socket) -> None:
        """Refuse an encoder with another certificate than the one with the fingerprint."""
        if self.fingerprint is not None and isinstance(peer, ssl.SSLSocket):
            certificate = peer.getpeercert(True) or b""
            if not hmac.compare_digest(hashlib.sha256(certificate).digest(), self.fingerprint):
                raise UntrustedError("the certificate of the other side has another fingerprint")


def encoder_context(certificate: str | Path, key: str | Path | None = None) -> ssl.SSLContext:
    """Return the TLS settings of an encoder: its chain of certificates, and its key if it is separate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.num_tickets = 0
    try:
        context.load_cert_chain(certificate, key, password=_refuse_password)
    except ssl.SSLError as err:
        raise ConfigError(f"{certificate}: no certificate with its key: {err.reason or err}") from err
    return context


def decoder_context(authorities: str | Path | None) -> ssl.SSLContext:
    """Return the TLS settings of a decoder: trusted authorities, or None if only a fingerprint is checked."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    if authorities is None:
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        return context
    try:
        context.load_verify_locations(authorities)
    except ssl.SSLError as err:
        raise ConfigError(f"{authorities}: no certificates: {err.reason or err}") from err
    return context


def _refuse_password() -> str:
    raise ConfigError("a key with a password is not supported")


def parse_fingerprint(text: str) -> bytes:
    """Read the SHA-256 of a certificate: 64 hexadecimal digits, with or without colons, or openssl's line."""
    digits = text.rpartition("=")[2].strip().replace(":", "")
    if len(digits) != _FINGERPRINT_DIGITS or not all(digit in "0123456789abcdefABCDEF" for digit in digits):
        raise ConfigError(f"a fingerprint is {_FINGERPRINT_DIGITS} hexadecimal digits, got {text[:80]!r}")
    return bytes.fromhex(digits)


def read_token(path: str | Path) -> bytes:
    """Read a token from a file; white space around it is ignored.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    bytes
        From 16 to 4096 of them.

    Raises
    ------
    ConfigError
        If the file holds no such token.
    OSError
        If it cannot be read.
    """
    with Path(path).open("rb") as file:
        token = file.read(MAX_TOKEN_BYTES + 1).strip()
    if not MIN_TOKEN_BYTES <= len(token) <= MAX_TOKEN_BYTES:
        raise ConfigError(f"{path}: a token has from {MIN_TOKEN_BYTES} to {MAX_TOKEN_BYTES} bytes")
    return token


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
        If it is not such an address.
    """
    host, colon, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        colon = ""
    if not colon or not port.isascii() or not port.isdigit() or len(port) > 5 or int(port) > 65535:
        raise ConfigError(f"an address must be HOST:PORT with a port up to 65535, got {text[:80]!r}")
    return host or "localhost", int(port)


class Listener(Closing):
    """A port that waits for peers.

    Parameters
    ----------
    listening : socket
        A bound and listening socket.
    """

    def __init__(self, listening: socket.socket) -> None:
        self._socket = listening
        listening.setblocking(False)
        self.host, self.port = listening.getsockname()[:2]
        self.name = format_address((self.host, self.port))

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    def accept(self, protection: Protection, timeout_s: float = DEFAULT_TIMEOUT_S) -> Connection:
        """Accept a peer that has connected; its TLS handshake takes place when it is received from."""
        peer, _ = self._socket.accept()
        try:
            peer.setblocking(False)
            return Connection(protection.wrap(peer), timeout_s)
        except OSError as err:
            peer.close()
            raise ConnectionLostError(f"the other side went away: {err.strerror or err}") from err

    def close(self) -> None:
        """Stop listening; a thread that waits for a peer notices it."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def listen(host: str = "localhost", port: int = 0) -> Listener:
    """Open a port.

    Parameters
    ----------
    host : str
        Address of this machine to listen on; the loopback by default.
    port : int
        0 for any free one, see `Listener.port`.

    Returns
    -------
    Listener
        The port.

    Raises
    ------
    FeedbackError
        If the address is not available.
    """
    try:
        family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        return Listener(socket.create_server((host, port), family=family, backlog=_BACKLOG))
    except (OSError, ValueError) as err:
        raise FeedbackError(
            f"cannot listen on {format_address((host, port))}: {getattr(err, 'strerror', None) or err}"
        ) from err


@dataclass(frozen=True)
class Dialler:
    """Way of a decoder to its encoder."""

    host: str
    port: int
    protection: Protection = field(default_factory=Protection)
    timeout_s: float = DEFAULT_TIMEOUT_S

    @property
    def name(self) -> str:
        """Address of the encoder."""
        return format_address((self.host, self.port))

    def connect(self, within_s: float, stop: Readable | None = None) -> Connection:
        """Connect to the encoder, and prove its identity; nothing has been sent to it."""
        deadline_s = time.monotonic() + within_s
        try:
            peer = socket.create_connection((self.host, self.port), max(within_s, _RETRY_S))
        except (OSError, ValueError) as err:
            if isinstance(err, ConnectionRefusedError | TimeoutError):
                raise NobodyListensError(f"no program listens on {self.name}") from err
            raise NobodyListensError(
                f"cannot connect to {self.name}: {getattr(err, 'strerror', None) or err}"
            ) from err
        try:
            self.protection.check_exposure(peer.getpeername()[0])
            peer.setblocking(False)
            peer = self.protection.wrap(peer, self.host)
            connection = Connection(peer, self.timeout_s, stop)
            connection.shake_hands(deadline_s - time.monotonic())
            self.protection.check_certificate(peer)
        except BaseException as err:
            peer.close()
            if isinstance(err, OSError):
                raise ConnectionLostError(f"the other side ({self.name}) went away: {err}") from err
            raise
        return connection
