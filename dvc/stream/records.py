"""Records of a stream: framing and checksums, the first record (configuration), and the last (end, index)."""

import zlib
from bisect import bisect_right
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from itertools import accumulate

from dvc.bits import decode_varint, encode_varint
from dvc.config import CodecConfig, decode_config, encode_config
from dvc.errors import BitstreamError

MAGIC = b"DV3D"
FORMAT_VERSION = 2
MAX_RECORD_BYTES = 64 * 2**20
MAX_GOPS = 2**20
CRC_BYTES = 4
SIZE_BYTES = 4
TRAILER_BYTES = SIZE_BYTES + CRC_BYTES
"""Last bytes of a buffered stream: size of the end record, then its checksum."""


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
_FORM_BYTES = {Form.BUFFERED: 0, Form.PUNCTURED: 1, Form.NO_FEEDBACK: 2}
_FORMS = {byte: form for form, byte in _FORM_BYTES.items()}


@dataclass(frozen=True)
class RecordPosition:
    """Position of a record, for messages."""

    number: int | None  # 0 is the configuration; None for the last record, if reached from the end
    offset: int  # offset of its first byte in the stream
    type: RecordType | None = None  # type, if known

    def error(self, text: str) -> BitstreamError:
        """Return an error of this record."""
        return BitstreamError(self.message(text))

    def message(self, text: str) -> str:
        """Return a text after the name of the record."""
        name = f" ({_NAMES[self.type]})" if self.type is not None else ""
        record = "last record" if self.number is None else f"record {self.number}"
        return f"{record}{name} at byte {self.offset}: {text}"


def check_payload_size(record_type: RecordType, size: int, position: RecordPosition) -> None:
    """Refuse a payload that is larger than its type of record allows."""
    limit = _MAX_PAYLOAD_BYTES[record_type]
    if size > limit:
        raise position.error(f"{size} bytes of payload, at most {limit} are allowed")


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


def encode_configuration(config: CodecConfig, form: Form) -> bytes:
    """Write the payload of the configuration record; inverse of `decode_configuration`."""
    return bytes([_FORM_BYTES[form]]) + encode_config(config)


def decode_configuration(payload: bytes) -> tuple[CodecConfig, Form]:
    """Read the payload of the configuration record; inverse of `encode_configuration`."""
    if not payload or payload[0] not in _FORMS:
        raise BitstreamError("unknown form; known are buffered, punctured and no-feedback")
    return decode_config(payload[1:]), _FORMS[payload[0]]


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
) -> tuple[int, tuple[IndexEntry, ...] | None]:
    """Read the payload of the end record; inverse of `encode_end`."""
    num_frames, position = decode_varint(payload, 0)
    entries = None
    if form is Form.BUFFERED:
        entries, position = _decode_entries(payload, position, first_offset, max_gops)
        if sum(entry.num_frames for entry in entries) != num_frames:
            raise BitstreamError("the index does not add up to the number of frames")
        if payload[position : position + SIZE_BYTES] != framed_size(len(payload)).to_bytes(
            SIZE_BYTES, "little"
        ):
            raise BitstreamError("the size of the record is not restated")
        position += SIZE_BYTES
    if position != len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes are left over")
    return num_frames, entries


def _decode_entries(
    payload: bytes, position: int, offset: int, max_gops: int
) -> tuple[tuple[IndexEntry, ...], int]:
    count, position = decode_varint(payload, position)
    if count > max_gops:
        raise BitstreamError(f"an index of {count} groups of pictures, at most {max_gops} are possible")
    entries = []
    for _ in range(count):
        size, position = decode_varint(payload, position)
        num_frames, position = decode_varint(payload, position)
        entries.append(IndexEntry(offset, size, num_frames))
        offset += size
    return tuple(entries), position
