"""Who may talk: both ends prove that they know a token, without sending it, and seal all that follows.

The decoder, which connects, sends a number that it draws; the encoder answers with one of its own and a
proof, the decoder with its proof: HMAC-SHA256 of the token over both numbers. Proofs of former runs are worth
nothing, since numbers are never the same again. From then on every piece of data has a code by a key of this
run and this direction, over its place among the pieces: what was changed, left out, repeated or moved shows.
"""

import hmac
import secrets
import time
from pathlib import Path
from typing import Final

from dvc.errors import ConfigError, FeedbackError, UntrustedError
from dvc.feedback.protected_socket import Peer, ProtectedSocket, read_exactly

MIN_TOKEN_BYTES: Final = 16
MAX_TOKEN_BYTES: Final = 4096
GREETING: Final = b"DV3D token 1\n"
NONCE_BYTES: Final = 32
PROOF_BYTES: Final = 32
SEAL_BYTES: Final = 16
MAX_PIECE_BYTES: Final = 2**18
_LENGTH_BYTES = 4
_ENCODER, _DECODER = b"encoder proves", b"decoder proves"
_ENCODER_KEY, _DECODER_KEY = b"encoder seals", b"decoder seals"


def read_token(path: str | Path) -> bytes:
    """Read a token from a file; white space around it does not count.

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


def authenticate(peer: Peer, token: bytes, listening: bool, within_s: float) -> "SealedSocket":
    """Prove to a peer that one knows the token, and let it prove the same; `listening`: it has connected."""
    handshake = _as_encoder if listening else _as_decoder
    nonces = handshake(peer, token, time.monotonic() + within_s)
    keys = [_digest(token, name, nonces) for name in (_ENCODER_KEY, _DECODER_KEY)]
    own, other = keys if listening else reversed(keys)
    return SealedSocket(peer, own, other)


def _as_encoder(peer: Peer, token: bytes, deadline_s: float) -> bytes:
    for number in GREETING:  # byte by byte: who says anything else need not say it all
        if _read(peer, 1, deadline_s) != bytes([number]):
            raise UntrustedError("the other side has no token")
    theirs, own = _read(peer, NONCE_BYTES, deadline_s), secrets.token_bytes(NONCE_BYTES)
    nonces = theirs + own
    peer.sendall(own + _digest(token, _ENCODER, nonces))
    if not hmac.compare_digest(_read(peer, PROOF_BYTES, deadline_s), _digest(token, _DECODER, nonces)):
        raise UntrustedError("the other side does not know the token")
    return nonces


def _as_decoder(peer: Peer, token: bytes, deadline_s: float) -> bytes:
    own = secrets.token_bytes(NONCE_BYTES)
    peer.sendall(GREETING + own)
    nonces = own + _read(peer, NONCE_BYTES, deadline_s)
    if not hmac.compare_digest(_read(peer, PROOF_BYTES, deadline_s), _digest(token, _ENCODER, nonces)):
        raise UntrustedError("the other side does not know the token")
    peer.sendall(_digest(token, _DECODER, nonces))
    return nonces


def _read(peer: Peer, count: int, deadline_s: float) -> bytes:
    return read_exactly(deadline_s, peer, count, "a proof that it knows the token")


def _digest(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


class SealedSocket(ProtectedSocket):
    """A socket that seals what it sends, and gives what came unchanged."""

    def __init__(self, peer: Peer, own_key: bytes, other_key: bytes) -> None:
        super().__init__(peer)
        self._own_key, self._other_key = own_key, other_key
        self._num_sent = self._num_received = 0
        self._raw = b""

    def send(self, data: "bytes | memoryview") -> int:
        """Send a piece, all of it."""
        piece = bytes(data[:MAX_PIECE_BYTES])
        head = len(piece).to_bytes(_LENGTH_BYTES, "big")
        self._peer.sendall(head + piece + _seal(self._own_key, self._num_sent, head, piece))
        self._num_sent += 1
        return len(piece)

    def _open(self, data: bytes) -> bytes:
        self._raw += data
        opened = b""
        while len(self._raw) >= _LENGTH_BYTES:
            head = self._raw[:_LENGTH_BYTES]
            end = _LENGTH_BYTES + int.from_bytes(head, "big")
            if end > _LENGTH_BYTES + MAX_PIECE_BYTES:
                raise FeedbackError("what came was changed on the way")
            if len(self._raw) < end + SEAL_BYTES:
                break
            piece, seal = self._raw[_LENGTH_BYTES:end], self._raw[end : end + SEAL_BYTES]
            if not hmac.compare_digest(seal, _seal(self._other_key, self._num_received, head, piece)):
                raise FeedbackError("what came was changed on the way")
            self._num_received += 1
            self._raw, opened = self._raw[end + SEAL_BYTES :], opened + piece
        return opened


def _seal(key: bytes, number: int, head: bytes, piece: bytes) -> bytes:
    return _digest(key, number.to_bytes(8, "big"), head, piece)[:SEAL_BYTES]
