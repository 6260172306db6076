"""Messages of the feedback channel and their syntax on the wire."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from dvc.bits import BitReader, BitWriter, decode_varint, encode_varint
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.stream import GopRecord, decode_gop, encode_gop
from dvc.turbo import CASCADE, KINDS, ParityRequest

PROTOCOL_VERSION = 3
MAX_HEADER_BYTES = 2**16
"""Most that a Wyner-Ziv frame may cost in a `Gop` message on average, where its parity is not."""

_MAX_FAILURE_BYTES = 500
_MAX_REQUEST_BYTES = 26  # without positions
_MAX_POSITION_BYTES = 2  # on the average: the orders of a plane are a few times as long as their bits


@dataclass(frozen=True)
class Hello:
    """Encoder to decoder, first: what will be sent."""

    version: int  # of the protocol
    config: bytes  # as `encode_config` writes it


@dataclass(frozen=True)
class NextGop:
    """Decoder to encoder: one more group of pictures may be sent."""


@dataclass(frozen=True)
class Gop:
    """Encoder to decoder: a group of pictures without parity."""

    number: int  # from 0
    record: GopRecord  # each Wyner-Ziv payload is what the decoder needs before its first request


@dataclass(frozen=True, eq=False)
class ParityAnswer:
    """Encoder to decoder: the bits that were wanted of a plane."""

    frame: int
    plane: int
    bits: NDArray[np.uint8]  # shape (count,), each element 0 or 1

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, ParityAnswer)
            and (self.frame, self.plane) == (other.frame, other.plane)
            and np.array_equal(self.bits, other.bits)
        )

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True)
class GopDone:
    """Decoder to encoder: nothing more will be asked of a group of pictures."""

    number: int


@dataclass(frozen=True)
class End:
    """Encoder to decoder: there are no more groups of pictures."""

    num_frames: int  # of the sequence


@dataclass(frozen=True)
class Failure:
    """Either way, last: the sender gives up."""

    text: str  # one line


@dataclass(frozen=True)
class KeepAlive:
    """Either way: the sender is at work, and will be for a while."""


# A `ParityRequest` goes from decoder to encoder: bits of a plane are wanted.
Message = Hello | NextGop | Gop | ParityRequest | ParityAnswer | GopDone | End | Failure | KeepAlive
Event = Hello | NextGop | Gop | ParityRequest | ParityAnswer | GopDone | End

TYPES: tuple[type[Message], ...] = (
    Hello, NextGop, Gop, ParityRequest, ParityAnswer, GopDone, End, Failure, KeepAlive
)  # fmt: skip
"""The type byte of a message is its place here plus one."""

_MAX_PAYLOAD_BYTES: dict[type[Message], int] = {
    Hello: 4096,
    NextGop: 0,
    ParityAnswer: 2**18,
    GopDone: 5,
    End: 5,
    Failure: _MAX_FAILURE_BYTES,
    KeepAlive: 0,
}


def max_payload_bytes(message_type: type[Message], config: CodecConfig | None) -> int:
    """Return the largest payload that a message may have.

    Parameters
    ----------
    message_type : type
        One of the message classes.
    config : CodecConfig or None
        The configuration; a `Gop` and a `ParityRequest` need it, which are bounded by the size of frames.

    Returns
    -------
    int
        Bytes.

    Raises
    ------
    ValueError
        If the configuration is needed, but not known.
    """
    if message_type in _MAX_PAYLOAD_BYTES:
        return _MAX_PAYLOAD_BYTES[message_type]
    if config is None:
        raise ValueError(f"`config` bounds a {message_type.__name__}, got None")
    if message_type is ParityRequest:
        by_positions = config.turbo.family == CASCADE
        largest = max(config.video.num_blocks, sum(config.wyner_ziv.max_planes))
        return _MAX_REQUEST_BYTES + (_MAX_POSITION_BYTES * largest if by_positions else 0)
    area_px = (config.video.width + 15) * (config.video.height + 15)
    return 4 * area_px + 2**20 + MAX_HEADER_BYTES * config.gop.length


def encode_message(message: Message) -> bytes:
    """Write a message as type, length of the payload, payload; `decode_payload` reads the last.

    Parameters
    ----------
    message : Message
        The message.

    Returns
    -------
    bytes
        As it goes over the wire.

    Raises
    ------
    TypeError, ValueError
        If a number is out of range, or bits are not an array of bits.
    """
    payload = _encode_payload(message)
    return bytes([TYPES.index(type(message)) + 1]) + encode_varint(len(payload)) + payload


def _encode_payload(message: Message) -> bytes:
    payload = b""
    match message:
        case Hello(version, config):
            payload = encode_varint(version) + config
        case Gop(number, record):
            payload = encode_varint(number) + encode_gop(record)
        case ParityRequest(frame, plane, kind, code, start, count, positions):
            steps = (after - before for before, after in pairwise((-1, *positions)))
            payload = bytes([KINDS.index(kind)]) + _encode_varints(frame, plane, code, start, count, *steps)
        case ParityAnswer(frame, plane, bits):
            writer = BitWriter()
            writer.write(bits)
            payload = _encode_varints(frame, plane, writer.num_bits) + writer.to_bytes()
        case GopDone(number) | End(number):
            payload = encode_varint(number)
        case Failure(text):
            payload = _one_line(text).encode()[:_MAX_FAILURE_BYTES]
    return payload


def decode_payload(message_type: type[Message], payload: bytes) -> Message:
    """Read the payload of a message; as `encode_message` writes it.

    Parameters
    ----------
    message_type : type
        One of the message classes.
    payload : bytes
        The payload.

    Returns
    -------
    Message
        The message; its numbers are not negative, but otherwise unchecked.

    Raises
    ------
    BitstreamError
        If it has not the syntax of its type.
    """
    return _DECODERS[message_type](payload)


def _decode_hello(payload: bytes) -> Hello:
    version, position = decode_varint(payload, 0)
    return Hello(version, payload[position:])


def _decode_gop_message(payload: bytes) -> Gop:
    number, position = decode_varint(payload, 0)
    return Gop(number, decode_gop(payload[position:]))


def _decode_request(payload: bytes) -> ParityRequest:
    if not payload or payload[0] >= len(KINDS):
        raise BitstreamError("unknown kind of bits")
    values: list[int] = []
    position = 1
    while position < len(payload) or len(values) < 5:
        value, position = decode_varint(payload, position)
        values.append(value)
    frame, plane, code, start, count, *steps = values
    if 0 in steps:
        raise BitstreamError("positions do not increase")
    positions = tuple(end - 1 for end in accumulate(steps))
    return ParityRequest(frame, plane, KINDS[payload[0]], code, start, count, positions)


def _decode_answer(payload: bytes) -> ParityAnswer:
    frame, position = decode_varint(payload, 0)
    plane, position = decode_varint(payload, position)
    count, position = decode_varint(payload, position)
    reader = BitReader(payload[position:])
    bits = reader.read(count)
    reader.expect_end()
    return ParityAnswer(frame, plane, bits)


# Payloads without content are empty: their limit is 0 bytes.
_DECODERS: dict[type[Message], Callable[[bytes], Message]] = {
    Hello: _decode_hello,
    NextGop: lambda _: NextGop(),
    Gop: _decode_gop_message,
    ParityRequest: _decode_request,
    ParityAnswer: _decode_answer,
    GopDone: lambda payload: GopDone(*_decode_varints(payload, 0, 1)),
    End: lambda payload: End(*_decode_varints(payload, 0, 1)),
    Failure: lambda payload: Failure(_one_line(payload.decode(errors="replace"))),
    KeepAlive: lambda _: KeepAlive(),
}


def _encode_varints(*values: int) -> bytes:
    return b"".join(encode_varint(value) for value in values)


def _decode_varints(payload: bytes, position: int, count: int) -> list[int]:
    """Read the last `count` integers of a payload."""
    values = []
    for _ in range(count):
        value, position = decode_varint(payload, position)
        values.append(value)
    if position != len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes are left over")
    return values


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text).strip()
