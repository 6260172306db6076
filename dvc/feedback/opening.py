"""How a connection begins: the decoder names the stream that goes on, or none; the encoder answers.

Both say how much of the stream they have. An encoder that does not let a decoder in says why.
"""

import struct
import time
import zlib
from dataclasses import dataclass
from typing import Final

from dvc.errors import FeedbackError, RefusedError, UntrustedError
from dvc.feedback import authentication
from dvc.feedback.protected_socket import Peer, read_exactly
from dvc.feedback.resumable import Checks

GREETING: Final = b"DV3D link 1\n"
SESSION_BYTES: Final = 16
NEW: Final = bytes(SESSION_BYTES)
"""In place of a session: from a decoder, that it has none; from an encoder, that it does not let it in."""
MAX_REASON_BYTES: Final = 500
_BODY: Final = struct.Struct(f">{SESSION_BYTES}sQ")
_CHECKSUM_BYTES: Final = 4
_PURPOSE: Final = "an opening"
_TLS_HANDSHAKE: Final = b"\x16"  # how a client of TLS begins


@dataclass(frozen=True)
class Opening:
    """What one end says first."""

    session: bytes
    num_received: int = 0  # bytes of the other side; of a refusal, bytes of the reason that follows

    def encode(self) -> bytes:
        """Write it."""
        said = GREETING + _BODY.pack(self.session, self.num_received)
        return said + zlib.crc32(said).to_bytes(_CHECKSUM_BYTES, "big")


def _what_is_spoken(said: bytes) -> str:
    """Tell what a side wants that begins otherwise: up to its first byte that is another."""
    if authentication.GREETING.startswith(said):
        return "the other side wants a token, and this one has none"
    if said == _TLS_HANDSHAKE:
        return "the other side wants TLS, and this one has no certificate"
    return "the other side speaks another protocol"


def read_opening(peer: Peer, deadline_s: float) -> Opening:
    """Read what the other side says first; byte by byte up to where it can only be this."""
    said = b""
    for number in GREETING:
        said += read_exactly(deadline_s, peer, 1, _PURPOSE)
        if said[-1] != number:
            raise UntrustedError(_what_is_spoken(said))
    body = read_exactly(deadline_s, peer, _BODY.size, _PURPOSE)
    check = read_exactly(deadline_s, peer, _CHECKSUM_BYTES, _PURPOSE)
    if zlib.crc32(said + body).to_bytes(_CHECKSUM_BYTES, "big") != check:
        raise FeedbackError("what came was changed on the way")
    return Opening(*_BODY.unpack(body))


def open_stream(peer: Peer, own: Opening, within_s: float) -> tuple[Opening, Checks]:
    """Say as the decoder which stream is to go on; return the encoder's answer."""
    deadline_s = time.monotonic() + within_s
    peer.sendall(own.encode())
    answer = read_opening(peer, deadline_s)
    if answer.session == NEW:
        size = min(answer.num_received, MAX_REASON_BYTES)
        reason = read_exactly(deadline_s, peer, size, "a reason").decode(errors="replace")
        raise RefusedError(f"the encoder does not let this decoder in: {' '.join(reason.split())}")
    return answer, checks(own, answer)


def refuse(peer: Peer, reason: str) -> None:
    """Say to a decoder why it is not let in."""
    text = reason.encode()[:MAX_REASON_BYTES]
    peer.sendall(Opening(NEW, len(text)).encode() + text)


def checks(decoder: Opening, encoder: Opening) -> Checks:
    """Return what the checksums of the decoder begin with; of the encoder, it is the other way round."""
    both = zlib.crc32(decoder.encode() + encoder.encode())
    return Checks(zlib.crc32(b"decoder", both), zlib.crc32(b"encoder", both))
