"""Messages of the feedback channel and their syntax on the wire."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dvc.bits import decode_varint, encode_varint
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.feedback import _kernels
from dvc.slepian_wolf import KINDS, MAX_RUN_BITS, ParityRequest, Part, RequestTable
from dvc.slepian_wolf.requests import NUM_COLUMNS
from dvc.stream import GopRecord, decode_gop, encode_gop

PROTOCOL_VERSION = 10
MAX_HEADER_BYTES = 2**16
"""Most that a Wyner-Ziv frame may cost in a `Gop` message on average, where its parity is not."""

MAX_REQUEST_BYTES = 2**16
"""Bytes of a message of requests from which on a sender begins the next one."""
MAX_ANSWER_BITS = 2**21
"""Most bits that one message may ask for."""

_MAX_FAILURE_BYTES = 500
_MIN_REQUEST_BYTES = 4
_MAX_POSITION_BYTES = 2  # on the average: the orders of a run are a few times as long as their bits
_FAULTS = {
    _kernels.ENDS: "data end within a request",
    _kernels.NEEDLESS: "integer is longer than it need be",
    _kernels.LONG: "integer is too long",
    _kernels.STANDING: "positions do not increase",
}


@dataclass(frozen=True)
class Hello:
    """Decoder to encoder, first: who is there; then encoder to decoder: what will be sent."""

    version: int  # of the protocol
    config: bytes = b""  # as `encode_config` writes it; the encoder's alone
    first_frame: int = 0  # of the sequence, with which this decoder begins; where there is a configuration


@dataclass(frozen=True)
class NextGop:
    """Decoder to encoder: one more group of pictures may be sent."""


@dataclass(frozen=True)
class Gop:
    """Encoder to decoder: a group of pictures without parity."""

    number: int  # from 0
    record: GopRecord  # each Wyner-Ziv payload is what the decoder needs before its first request


@dataclass(frozen=True, eq=False)
class ParityRequests:
    """Decoder to encoder: bits of planes are wanted."""

    table: RequestTable  # in order of frames


@dataclass(frozen=True)
class ParityAnswers:
    """Encoder to decoder: all bits that the first message of requests without an answer wants."""

    packed: bytes  # one request's bits after the other's, filled up to a byte with zeros


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


Message = Hello | NextGop | Gop | ParityRequests | ParityAnswers | GopDone | End | Failure

TYPES: tuple[type[Message], ...] = (
    Hello, NextGop, Gop, ParityRequests, ParityAnswers, GopDone, End, Failure
)  # fmt: skip
"""The type byte of a message is its place here plus one."""

_MAX_PAYLOAD_BYTES: dict[type[Message], int] = {
    Hello: 4096,
    NextGop: 0,
    ParityAnswers: MAX_ANSWER_BITS // 8,
    GopDone: 5,
    End: 5,
    Failure: _MAX_FAILURE_BYTES,
}


def max_payload_bytes(message_type: type[Message], config: CodecConfig | None) -> int:
    """Return the largest payload that a message may have."""
    if message_type in _MAX_PAYLOAD_BYTES:
        return _MAX_PAYLOAD_BYTES[message_type]
    if config is None:
        raise ValueError(f"`config` bounds a {message_type.__name__}, got None")
    if message_type is ParityRequests:
        frame_bits = config.video.num_blocks * len(config.wyner_ziv.max_planes)
        return MAX_REQUEST_BYTES + _MAX_POSITION_BYTES * min(frame_bits * config.gop.length, MAX_RUN_BITS)
    area_px = (config.video.width + 15) * (config.video.height + 15)
    return 4 * area_px + 2**20 + MAX_HEADER_BYTES * config.gop.length


def encode_message(message: Message) -> bytes:
    """Write a message as type, length of the payload, payload; `decode_payload` reads the last."""
    payload = _encode_payload(message)
    return bytes([TYPES.index(type(message)) + 1]) + encode_varint(len(payload)) + payload


def _encode_payload(message: Message) -> bytes:
    payload = b""
    match message:
        case Hello(version, config, first_frame):
            payload = encode_varint(version) + (encode_varint(first_frame) + config) * bool(config)
        case Gop(number, record):
            payload = encode_varint(number) + encode_gop(record)
        case ParityRequests(table):
            payload = _encode_requests(table)
        case ParityAnswers(packed):
            payload = packed
        case GopDone(number) | End(number):
            payload = encode_varint(number)
        case Failure(text):
            payload = _one_line(text).encode()[:_MAX_FAILURE_BYTES]
    return payload


def _encode_requests(table: RequestTable) -> bytes:
    requests = table.requests()
    frames = [0, *(request.frame for request in requests)]
    return b"".join(map(_encode_request, requests, frames))


def _encode_request(request: ParityRequest, frame: int) -> bytes:
    """Write a request that follows one for `frame`."""
    positions = request.positions
    begun = request.begun
    first = 16 * request.code + KINDS.index(request.kind)
    first += _kernels.BEGINS * (begun is not None) + _kernels.HAS_POSITIONS * bool(positions)
    numbers = [first, request.frame - frame, request.run, request.count]
    if positions and request.kind == "joint":
        numbers.append(len(positions))
    numbers += (after - before for before, after in pairwise((-1, *positions)))
    data = b"".join(map(encode_varint, numbers))
    if begun is None:
        return data
    offsets = (-1, *(part.offset for part in begun))
    steps = (after - before for before, after in pairwise(offsets))
    return data + encode_varint(len(begun)) + b"".join(map(_encode_part, steps, begun))


def _encode_part(step: int, part: Part) -> bytes:
    """Write a part of a run, so many frames after the one before."""
    planes = (after - before for before, after in pairwise((-1, *part.planes)))
    numbers = (step, len(part.planes), *planes, len(part.areas))
    return b"".join(map(encode_varint, numbers)) + part.areas


def decode_payload(message_type: type[Message], payload: bytes) -> Message:
    """Read the payload of a message; as `encode_message` writes it."""
    return _DECODERS[message_type](payload)


def _decode_hello(payload: bytes) -> Hello:
    version, position = decode_varint(payload, 0)
    if position == len(payload) or version != PROTOCOL_VERSION:
        return Hello(version)
    first_frame, position = decode_varint(payload, position)
    return Hello(version, payload[position:], first_frame)


def _decode_gop_message(payload: bytes) -> Gop:
    number, position = decode_varint(payload, 0)
    return Gop(number, decode_gop(payload[position:]))


def _decode_requests(payload: bytes) -> ParityRequests:
    data = np.frombuffer(payload, np.uint8)
    rows = np.empty((data.size // _MIN_REQUEST_BYTES + 1, NUM_COLUMNS), np.int64)
    positions = np.empty(data.size, np.int64)
    planes, parts = np.empty(data.size, np.int64), np.empty((data.size // 3 + 1, 5), np.int64)
    num_rows, num_positions, num_bits, num_runs, num_parts, fault = _kernels.parse_requests(
        data, rows, positions, planes, parts
    )
    if fault:
        raise BitstreamError(_FAULTS[fault])
    found: list[list[Part]] = [[] for _ in range(num_runs)]
    first = 0
    for run, offset, last, start, stop in parts[:num_parts].tolist():
        found[run].append(Part(offset, tuple(planes[first:last].tolist()), payload[start:stop]))
        first = last
    runs = tuple(map(tuple, found))
    return ParityRequests(RequestTable(rows[:num_rows], positions[:num_positions], num_bits, runs))


# Payloads without content are empty: their limit is 0 bytes.
_DECODERS: dict[type[Message], Callable[[bytes], Message]] = {
    Hello: _decode_hello,
    NextGop: lambda _: NextGop(),
    Gop: _decode_gop_message,
    ParityRequests: _decode_requests,
    ParityAnswers: ParityAnswers,
    GopDone: lambda payload: GopDone(*_decode_varints(payload, 0, 1)),
    End: lambda payload: End(*_decode_varints(payload, 0, 1)),
    Failure: lambda payload: Failure(_one_line(payload.decode(errors="replace"))),
}


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
