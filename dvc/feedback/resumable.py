"""A stream of bytes in both directions that goes on where it stopped when it gets another connection; no I/O.

On a connection the bytes go in pieces: a head, its checksum and, where there are any, bytes and their
checksum. A checksum is over all that came before on this connection, so that a piece which was changed, left
out, repeated or moved shows, and the connection is given up. What is not acknowledged is kept.
"""

import struct
import zlib
from typing import Final, NamedTuple

from dvc.errors import FeedbackError

MAX_PIECE_BYTES: Final = 2**14
"""Most that is lost with a piece that was damaged."""
MAX_PIECES: Final = 16
"""Pieces that are made at a time."""
MAX_UNTOLD_BYTES: Final = 2**16
"""Received bytes of which the other side is told at once, so that it can let go of them."""
_HEAD: Final = struct.Struct(">HI")
_CHECKSUM_BYTES: Final = 4
_CHANGED: Final = "what came was changed on the way"


class Checks(NamedTuple):
    """What the checksums of a connection begin with, in each direction."""

    sent: int
    received: int


class ResumableStream:
    """One end of the stream; `begin` comes first, and with every further connection."""

    def __init__(self) -> None:
        self.num_received = 0  # bytes of the other side, from the first on
        self.num_bytes_again = 0  # that were put on a connection more than once
        self.num_pieces = 0  # that came whole on this connection
        self.damage: FeedbackError | None = None  # of the piece behind them
        self._kept = bytearray()  # what was sent and not acknowledged
        self._num_acknowledged = 0
        self._num_placed = self._most_placed = 0  # bytes put on this connection, or any
        self._num_told = 0  # received bytes that the other side knows of
        self._raw = bytearray()
        self._sent_check = self._received_check = 0

    @property
    def num_kept(self) -> int:
        """Bytes that the other side may have to be sent again."""
        return len(self._kept)

    @property
    def is_owing(self) -> bool:
        """Whether the other side should be told what has come."""
        return self.num_received - self._num_told > MAX_UNTOLD_BYTES

    def check(self, num_received: int) -> None:
        """Refuse to go on after so many bytes where that cannot be."""
        last = self._num_acknowledged + len(self._kept)
        if not self._num_acknowledged <= num_received <= last:
            raise FeedbackError(
                f"the other side wants to go on after {num_received} bytes, not after"
                f" {self._num_acknowledged} to {last}"
            )

    def begin(self, num_received: int, checks: Checks) -> None:
        """Go on with a new connection, on which the other side says to have received so many bytes."""
        self.check(num_received)
        self._acknowledge(num_received - self._num_acknowledged)
        self._num_placed = num_received
        self.num_bytes_again += self._most_placed - num_received
        self._num_told = self.num_received
        self._raw.clear()
        self._sent_check, self._received_check = checks
        self.num_pieces, self.damage = 0, None

    def _acknowledge(self, count: int) -> None:
        del self._kept[:count]
        self._num_acknowledged += count

    def keep(self, data: bytes) -> None:
        """Take in bytes for the other side."""
        self._kept += data

    def pieces(self, sign_of_life: bool = False) -> bytes:
        """Return some pieces with what is to be sent; without bytes if a sign of life is wanted at least."""
        made: list[bytes] = []
        while len(made) < MAX_PIECES:
            start = self._num_placed - self._num_acknowledged
            data = bytes(self._kept[start : start + MAX_PIECE_BYTES])
            if not data and (made or not sign_of_life):
                break
            made.append(self._piece(data))
            self._num_placed += len(data)
            if not data:
                break
        self._most_placed = max(self._most_placed, self._num_placed)
        return b"".join(made)

    def _piece(self, data: bytes) -> bytes:
        head = _HEAD.pack(len(data), self.num_received - self._num_told)
        self._num_told = self.num_received
        check = zlib.crc32(head, self._sent_check)
        piece = head + check.to_bytes(_CHECKSUM_BYTES, "big")
        if data:
            check = zlib.crc32(data, check)
            piece += data + check.to_bytes(_CHECKSUM_BYTES, "big")
        self._sent_check = check
        return piece

    def receive(self, raw: bytes) -> bytes:
        """Take in what came on the connection; return the bytes of the other side before any damage."""
        self._raw += raw
        received: list[bytes] = []
        try:
            while (data := self._next_piece()) is not None:
                self.num_pieces += 1
                self.num_received += len(data)
                received.append(data)
        except FeedbackError as err:
            self.damage = err
            if not received:
                raise
        return b"".join(received)

    def _next_piece(self) -> bytes | None:
        """Take the bytes of a piece off what came, None if it is not complete."""
        end = _HEAD.size + _CHECKSUM_BYTES
        if len(self._raw) < end:
            return None
        check = self._checked(0, _HEAD.size, self._received_check)
        length, num_acknowledged = _HEAD.unpack_from(self._raw)
        if length > MAX_PIECE_BYTES or num_acknowledged > self._num_placed - self._num_acknowledged:
            raise FeedbackError("the other side breaks the protocol of resumable streams")
        data = b""
        if length:
            start, end = end, end + length + _CHECKSUM_BYTES
            if len(self._raw) < end:
                return None
            check = self._checked(start, start + length, check)
            data = bytes(self._raw[start : start + length])
        del self._raw[:end]
        self._received_check = check
        self._acknowledge(num_acknowledged)
        return data

    def _checked(self, start: int, end: int, check: int) -> int:
        """Compare the checksum behind some of what came."""
        check = zlib.crc32(self._raw[start:end], check)
        if check.to_bytes(_CHECKSUM_BYTES, "big") != self._raw[end : end + _CHECKSUM_BYTES]:
            raise FeedbackError(_CHANGED)
        return check
