"""TLS: what is sent is hidden, and the decoder knows whose encoder it talks to."""

import hashlib
import hmac
import ssl
import threading
import time
from pathlib import Path

from dvc.errors import ConfigError, FeedbackError, UntrustedError
from dvc.feedback.protected_socket import MAX_READ_BYTES, Peer, ProtectedSocket, read_before

_HEX_DIGITS = 64


def encoder_context(certificate: str | Path, key: str | Path | None = None) -> ssl.SSLContext:
    """Return what an encoder proves itself with: a chain of certificates, and its key, if it is elsewhere."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    try:
        context.load_cert_chain(certificate, key, password=_no_password)
    except ssl.SSLError as err:
        raise ConfigError(f"{certificate}: no certificate with its key: {err.reason or err}") from err
    return context


def decoder_context(authorities: str | Path | None) -> ssl.SSLContext:
    """Return what a decoder believes: certificates that these sign; without any, a fingerprint alone."""
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


def parse_fingerprint(text: str) -> bytes:
    """Read the SHA-256 of a certificate: 64 hexadecimal digits, colons or not; or a line of openssl."""
    digits = text.rpartition("=")[2].strip().replace(":", "")
    if len(digits) != _HEX_DIGITS or not all(digit in "0123456789abcdefABCDEF" for digit in digits):
        raise ConfigError(f"a fingerprint is {_HEX_DIGITS} hexadecimal digits, got {text[:80]!r}")
    return bytes.fromhex(digits)


def _no_password() -> str:
    raise ConfigError("a key with a password cannot be used here")


class TlsSocket(ProtectedSocket):
    """A socket whose data are encrypted; `host`: whom the certificate of the other side must be for."""

    def __init__(self, peer: Peer, context: ssl.SSLContext, listening: bool, host: str | None = None) -> None:
        super().__init__(peer)
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        name = None if listening else host
        self._tls = context.wrap_bio(self._incoming, self._outgoing, listening, name)
        self._turn = threading.Lock()  # two threads may send and receive, but not work on the state at once

    def shake_hands(self, within_s: float, fingerprint: bytes | None = None) -> None:
        """Agree on keys; refuse a certificate that is not the one with the fingerprint, if there is one."""
        deadline_s = time.monotonic() + within_s
        while True:
            try:
                self._tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                self._flush()
                self._incoming.write(read_before(deadline_s, self._peer, MAX_READ_BYTES, "TLS"))
            except ssl.SSLError as err:
                self._flush()
                raise UntrustedError(f"no TLS with the other side: {_reason(err)}") from err
        self._flush()
        if fingerprint is not None:
            certificate = self._tls.getpeercert(True) or b""
            if not hmac.compare_digest(hashlib.sha256(certificate).digest(), fingerprint):
                raise UntrustedError("the certificate of the other side has another fingerprint")
        self._opened = self._open(b"")  # data may have come with the last of the handshake

    def _flush(self) -> None:
        data = self._outgoing.read()
        if data:
            self._peer.sendall(data)

    def send(self, data: "bytes | memoryview") -> int:
        """Send some of the data, encrypted; one thread at a time, while another may receive."""
        with self._turn:
            count = self._tls.write(data[:MAX_READ_BYTES])
            encrypted = self._outgoing.read()
        self._peer.sendall(encrypted)
        return count

    def _open(self, data: bytes) -> bytes:
        opened = b""
        with self._turn:
            self._incoming.write(data)
            try:
                while piece := self._tls.read(MAX_READ_BYTES):
                    opened += piece
            except (ssl.SSLWantReadError, ssl.SSLZeroReturnError):
                pass
            except ssl.SSLError as err:
                raise FeedbackError(f"what came was changed on the way: {_reason(err)}") from err
        return opened


def _reason(err: ssl.SSLError) -> str:
    if isinstance(err, ssl.SSLCertVerificationError):
        return str(err.verify_message)
    return (err.reason or str(err)).lower().replace("_", " ")
