"""Records of a stream: framing and checksums, the first record (configuration), and the last (end, index)."""

import os
import zlib
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from itertools import accumulate
from typing import BinaryIO

from dvc.bits import MAX_VARINT_BYTES, decode_varint, encode_varint
from dvc.config import CodecConfig, encode_config
from dvc.errors import BitstreamError

MAGIC = b"DV3D"
FORMAT_VERSION = 2
MAX_RECORD_BYTES = 64 * 2**20
MAX_GOPS = 2**20
CRC_BYTES = 4
SIZE_BYTES = 4
TRAILER_BYTES = SIZE_BYTES + CRC_BYTES
"""Last bytes of a buffered stream: size of the end record, then its checksum."""
_CHUNK_BYTES = 2**20  # largest read before more memory is spent on a record


class RecordType(IntEnum):
    """The first byte of a record."""

    CONFIGURATION = 1
    GOP = 2
    END = 3


class Form(StrEnum):
    """Data of Wyner-Ziv frames in a stream."""

    BUFFERED = "buffered"  # all planes: any parity can be computed
    PUNCTURED = "punctured"  # only the requested bits: the size of the stream is the rate
    NO_FEEDBACK = "no-feedback"  # no data: a decoder shows its predictions


_NAMES = {
    RecordType.CONFIGURATION: "configuration",
    RecordType.GOP: "group of pictures",
    RecordType.END: "end",
}
_MAX_PAYLOAD_BYTES = {
    RecordType.CONFIGURATION: 4096,
    RecordType.GOP: MAX_RECORD_BYTES,
    RecordType.END: 8 * MAX_GOPS,
}
FORMS = dict(enumerate(Form))
"""Forms by the first byte of the configuration record."""


@dataclass(frozen=True)
class RecordPosition:
    """Position of a record, for messages."""

    number: int | None  # 0 is the configuration; None for the last record, if reached from the end
    offset: int  # offset of its first byte in the stream
    type: RecordType | None = None  # type, if known

    def error(self, text: object, kind: Callable[[str], BitstreamError] = BitstreamError) -> BitstreamError:
        """Return an error that names this record."""
        name = f" ({_NAMES[self.type]})" if self.type is not None else ""
        record = "last record" if self.number is None else f"record {self.number}"
        return kind(f"{record}{name} at byte {self.offset}: {text}")


def record_crc(head: bytes, payload: bytes) -> bytes:
    """Return the checksum that ends a record."""
    return zlib.crc32(payload, zlib.crc32(head)).to_bytes(CRC_BYTES, "little")


def frame_record(record_type: RecordType, payload: bytes) -> bytes:
    """Return a payload with its type, length and checksum."""
    head = bytes([record_type]) + encode_varint(len(payload))
    return head + payload + record_crc(head, payload)


def framed_size(payload_size: int) -> int:
    """Return the size of a record."""
    return 1 + len(encode_varint(payload_size)) + payload_size + CRC_BYTES


class StreamEnds(BitstreamError):
    """The stream ends too early; the data before the end are valid."""


class RecordSource:
    """Reads records from a file or a pipe."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.position = 0
        self.size: int | None = None  # size of the whole stream, None for a pipe
        if file.seekable():
            self.size = file.seek(0, os.SEEK_END)
            file.seek(0)

    def seek(self, position: int) -> None:
        """Continue at a position of a file."""
        self.file.seek(position)
        self.position = position

    def read(self, count: int) -> bytes:
        """Read `count` bytes, fewer only at the end of the stream; memory grows with the data that arrive."""
        parts = []
        while count > 0:
            try:
                part = self.file.read(min(count, _CHUNK_BYTES))
            except OSError as err:
                raise BitstreamError(f"cannot read byte {self.position}: {err.strerror or err}") from err
            if not part:
                break
            parts.append(part)
            count -= len(part)
            self.position += len(part)
        return b"".join(parts)

    def read_head(self, number: int | None) -> tuple[RecordPosition, int, bytes]:
        """Return the position of a record, the size of its payload, and the bytes of its type and length."""
        record_at = RecordPosition(number, self.position)
        head = self.read(1)
        if not head:
            raise record_at.error("the stream ends without its end record", StreamEnds)
        try:
            record_at = RecordPosition(number, record_at.offset, RecordType(head[0]))
        except ValueError as err:
            raise record_at.error(f"unknown type {head[0]}") from err
        assert record_at.type is not None
        while len(head) <= MAX_VARINT_BYTES:
            byte = self.read(1)
            head += byte
            if not byte or byte[0] < 0x80:
                break
        try:
            size, _ = decode_varint(head, 1)
        except BitstreamError as err:
            kind = BitstreamError if byte else StreamEnds
            raise record_at.error(f"length: {err}", kind) from err
        limit = _MAX_PAYLOAD_BYTES[record_at.type]
        if size > limit:
            raise record_at.error(f"{size} bytes of payload, at most {limit} are allowed")
        if self.size is not None and size + CRC_BYTES > self.size - self.position:
            left = max(self.size - self.position, 0)
            raise record_at.error(f"{size + CRC_BYTES} bytes promised, {left} left", StreamEnds)
        return record_at, size, head

    def read_record(self, number: int | None) -> tuple[RecordPosition, bytes]:
        """Read the next record and check its CRC-32."""
        record_at, size, head = self.read_head(number)
        payload, crc = self.read(size), self.read(CRC_BYTES)
        if len(payload) < size or len(crc) < CRC_BYTES:
            raise record_at.error("the stream ends within the record", StreamEnds)
        if crc != record_crc(head, payload):
            raise record_at.error("checksum mismatch")
        return record_at, payload


def encode_configuration(config: CodecConfig, form: Form) -> bytes:
    """Write the payload of the configuration record."""
    return bytes([list(Form).index(form)]) + encode_config(config)


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """One GOP record."""

    offset: int  # offset of the record in the stream, in bytes
    size: int  # size of the record, in bytes
    num_frames: int  # frames that it adds


@dataclass(frozen=True)
class StreamIndex:
    """All GOP records of a stream.

    Attributes
    ----------
    num_frames : int
        Number of frames of the stream.
    entries : tuple of IndexEntry
        Position, size and number of frames of each record.
    """

    num_frames: int
    entries: tuple[IndexEntry, ...]

    def first_frame(self, gop: int) -> int:
        """Return the number of the first frame that a GOP adds; both count from 0."""
        return sum(entry.num_frames for entry in self.entries[:gop])

    def gop_of(self, frame: int) -> int:
        """Return the number of the GOP that adds a frame; both count from 0."""
        ends = list(accumulate(entry.num_frames for entry in self.entries))
        if not 0 <= frame < self.num_frames:
            raise ValueError(f"`frame` must be from 0 to {self.num_frames - 1}, got {frame}")
        return bisect_right(ends, frame)


def encode_end(index: StreamIndex, form: Form) -> bytes:
    """Write the payload of the end record; inverse of `decode_end`."""
    payload = encode_varint(index.num_frames)
    if form is not Form.BUFFERED:
        return payload
    parts = [payload, encode_varint(len(index.entries))]
    for entry in index.entries:
        parts += [encode_varint(entry.size), encode_varint(entry.num_frames)]
    payload = b"".join(parts)
    return payload + framed_size(len(payload) + SIZE_BYTES).to_bytes(SIZE_BYTES, "little")


def decode_end(
    payload: bytes, form: Form, first_offset: int, max_gops: int = MAX_GOPS
) -> tuple[int, list[IndexEntry] | None]:
    """Read the payload of the end record; inverse of `encode_end`."""
    num_frames, position = decode_varint(payload, 0)
    entries: list[IndexEntry] | None = None
    if form is Form.BUFFERED:
        count, position = decode_varint(payload, position)
        if count > max_gops:
            raise BitstreamError(f"an index of {count} groups of pictures, at most {max_gops} are possible")
        offset, entries = first_offset, []
        for _ in range(count):
            size, position = decode_varint(payload, position)
            frames, position = decode_varint(payload, position)
            entries.append(IndexEntry(offset, size, frames))
            offset += size
        if sum(entry.num_frames for entry in entries) != num_frames:
            raise BitstreamError("the index does not add up to the number of frames")
        own_size = framed_size(len(payload)).to_bytes(SIZE_BYTES, "little")
        if payload[position : position + SIZE_BYTES] != own_size:
            raise BitstreamError("the size of the record is not restated")
        position += SIZE_BYTES
    if position != len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes are left over")
    return num_frames, entries
