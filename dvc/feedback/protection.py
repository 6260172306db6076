"""Protection of a connection: TLS by certificate or fingerprint, and a shared token inside it."""

import hashlib
import hmac
import socket
import ssl
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from dvc.errors import ConfigError, UntrustedError
from dvc.feedback.messages import MAX_TOKEN_BYTES

MIN_TOKEN_BYTES = 16
"""Length of the shortest token that is accepted."""
_FINGERPRINT_DIGITS = 64


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
