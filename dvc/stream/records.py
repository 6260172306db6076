"""Framing: how records lie in a stream, their checksums, and the first record, the configuration."""

import zlib
from dataclasses import dataclass
from enum import IntEnum, StrEnum

from dvc.bits import encode_varint
from dvc.config import CodecConfig, decode_config, encode_config
from dvc.errors import BitstreamError

MAGIC = b"DV3D"
FORMAT_VERSION = 2
MAX_RECORD_BYTES = 64 * 2**20
MAX_GOPS = 2**20
CRC_BYTES = 4


class RecordType(IntEnum):
    """The first byte of a record."""

    CONFIGURATION = 1
    GOP = 2
    END = 3


class Form(StrEnum):
    """How much a stream holds of Wyner-Ziv frames."""

    BUFFERED = "buffered"  # all planes, from which any parity is computed
    PUNCTURED = "punctured"  # only the requested bits: the size of the stream is the rate
    NO_FEEDBACK = "no-feedback"  # nothing of Wyner-Ziv frames: a decoder shows its predictions


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
class Place:
    """Position of a record, for messages."""

    number: int | None  # from 0, which is the configuration; None for the last, found from the end
    offset: int  # offset of its first byte in the stream
    type: RecordType | None = None  # type, if known

    def error(self, text: str) -> BitstreamError:
        """Return an error of this record."""
        return BitstreamError(self.message(text))

    def message(self, text: str) -> str:
        """Prefix errors with the name of the record."""
        name = f" ({_NAMES[self.type]})" if self.type is not None else ""
        record = "last record" if self.number is None else f"record {self.number}"
        return f"{record}{name} at byte {self.offset}: {text}"


def check_payload_size(record_type: RecordType, size: int, place: Place) -> None:
    """Refuse a payload that is larger than its type of record allows."""
    limit = _MAX_PAYLOAD_BYTES[record_type]
    if size > limit:
        raise place.error(f"{size} bytes of payload, at most {limit} are allowed")


def record_crc(head: bytes, payload: bytes) -> bytes:
    """Return the checksum that ends a record."""
    return zlib.crc32(payload, zlib.crc32(head)).to_bytes(CRC_BYTES, "little")


def frame_record(record_type: RecordType, payload: bytes) -> bytes:
    """Put type and length before a payload and its checksum behind it."""
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
        raise BitstreamError("a stream has no form of this number; it is buffered, punctured or no-feedback")
    return decode_config(payload[1:]), _FORMS[payload[0]]
