"""Messages of the feedback channel and their syntax on the wire."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dvc.bits import decode_varint, encode_varint
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.feedback import _kernels
from dvc.slepian_wolf import KINDS, MAX_RUN_BITS, Part, RequestTable
from dvc.slepian_wolf.requests import NUM_COLUMNS
from dvc.stream import GopRecord, decode_gop, encode_gop

PROTOCOL_VERSION = 11
DECODER_ID_BYTES = 16
"""Length of the random number that identifies a decoder after a lost connection."""
MAX_TOKEN_BYTES = 4096
"""Longest token that a decoder may send."""
MAX_HEADER_BYTES = 2**16
"""Largest mean size of the header of a Wyner-Ziv frame in a `Gop` message."""
MAX_REQUEST_BYTES = 2**16
"""Size of a message of requests beyond which the sender starts another one."""
MAX_ANSWER_BITS = 2**21
"""Largest number of bits that one message may request."""

_MAX_FAILURE_BYTES = 500
_MIN_REQUEST_BYTES = 4
_MAX_POSITION_BYTES = 2  # mean over the positions of a message: an order is a few times as long as its run
_SYNTAX_FAULTS = {
    _kernels.TRUNCATED: "data end within a request",
    _kernels.OVERLONG: "integer is longer than necessary",
    _kernels.TOO_LARGE: "integer is too long",
    _kernels.NOT_INCREASING: "positions do not increase",
}


@dataclass(frozen=True)
class Hello:
    """Decoder to encoder, first on every connection."""

    version: int
    decoder_id: bytes = b""  # random, the same on all connections of a run
    num_groups: int = 0  # groups of pictures that the decoder has written
    token: bytes = b""


@dataclass(frozen=True)
class Welcome:
    """Encoder to decoder, in reply to `Hello`."""

    version: int
    config: bytes = b""  # as `encode_config` writes it


@dataclass(frozen=True)
class NextGop:
    """Decoder to encoder: credit for one more group of pictures."""


@dataclass(frozen=True)
class Gop:
    """Encoder to decoder: a group of pictures without parity."""

    number: int  # from 0
    record: GopRecord  # each Wyner-Ziv payload is the header that the decoder needs before its first request


@dataclass(frozen=True, eq=False)
class ParityRequests:
    """Decoder to encoder: requests for bits of planes."""

    table: RequestTable  # in order of frames


@dataclass(frozen=True)
class ParityAnswers:
    """Encoder to decoder: all bits of the first unanswered message of requests."""

    packed: bytes  # the bits of all requests, padded to a byte with zeros


@dataclass(frozen=True)
class GopDone:
    """Decoder to encoder: a group of pictures is written."""

    number: int


@dataclass(frozen=True)
class End:
    """Encoder to decoder: no more groups of pictures follow."""

    num_frames: int  # length of the sequence


@dataclass(frozen=True)
class Finished:
    """Decoder to encoder, last: the whole sequence is written; the encoder confirms it with the same."""


@dataclass(frozen=True)
class Failure:
    """Either direction, last: the sender aborts the run."""

    text: str  # one line


Message = (
    Hello | Welcome | NextGop | Gop | ParityRequests | ParityAnswers | GopDone | End | Finished | Failure
)


def _encode_requests(table: RequestTable) -> bytes:
    """Write requests; frames and increasing numbers are coded as differences."""
    data, previous_frame = bytearray(), 0

    def write(*numbers: int) -> None:
        data.extend(b"".join(map(encode_varint, numbers)))

    for request in table.requests():
        positions, begun = request.positions, request.begun
        first = 16 * request.code + KINDS.index(request.kind)
        first += _kernels.BEGINS * (begun is not None) + _kernels.HAS_POSITIONS * bool(positions)
        write(first, request.frame - previous_frame, request.run, request.count)
        previous_frame = request.frame
        if positions and request.kind == "joint":
            write(len(positions))
        write(*_steps(positions))
        if begun is None:
            continue
        write(len(begun))
        for part, step in zip(begun, _steps([part.offset for part in begun]), strict=True):
            write(step, len(part.planes), *_steps(part.planes), len(part.areas))
            data.extend(part.areas)
    return bytes(data)


def _steps(numbers: Sequence[int]) -> Iterator[int]:
    """Yield the differences of increasing numbers; the first is to -1."""
    return (after - before for before, after in pairwise((-1, *numbers)))


def _decode_requests(payload: bytes) -> ParityRequests:
    data = np.frombuffer(payload, np.uint8)
    rows = np.empty((data.size // _MIN_REQUEST_BYTES + 1, NUM_COLUMNS), np.int64)
    positions = np.empty(data.size, np.int64)
    planes, parts = np.empty(data.size, np.int64), np.empty((data.size // 3 + 1, 5), np.int64)
    num_rows, num_positions, num_bits, num_runs, num_parts, fault = _kernels.parse_requests(
        data, rows, positions, planes, parts
    )
    if fault:
        raise BitstreamError(_SYNTAX_FAULTS[fault])
    runs: list[list[Part]] = [[] for _ in range(num_runs)]
    first = 0
    for run, offset, last, start, stop in parts[:num_parts].tolist():
        runs[run].append(Part(offset, tuple(planes[first:last].tolist()), payload[start:stop]))
        first = last
    return ParityRequests(
        RequestTable(rows[:num_rows], positions[:num_positions], num_bits, tuple(map(tuple, runs)))
    )


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text).strip()


_MAX_BYTES: dict[type[Message], int | None] = {
    Hello: 16 + DECODER_ID_BYTES + MAX_TOKEN_BYTES,
    Welcome: 4096,
    NextGop: 0,
    Gop: None,  # depends on the configuration
    ParityRequests: None,
    ParityAnswers: MAX_ANSWER_BITS // 8,
    GopDone: 5,
    End: 5,
    Finished: 0,
    Failure: _MAX_FAILURE_BYTES,
}
TYPES = tuple(_MAX_BYTES)
"""Message types; the type byte of a message is its index here plus one."""


def max_payload_bytes(message_type: type[Message], config: CodecConfig | None) -> int:
    """Return the size of the largest valid payload of a message."""
    max_bytes = _MAX_BYTES[message_type]
    if max_bytes is not None:
        return max_bytes
    if config is None:
        raise ValueError(f"`config` bounds a {message_type.__name__}, got None")
    if message_type is ParityRequests:
        frame_bits = config.video.num_blocks * len(config.wyner_ziv.max_planes)
        return MAX_REQUEST_BYTES + _MAX_POSITION_BYTES * min(frame_bits * config.gop.length, MAX_RUN_BITS)
    area_px = (config.video.width + 15) * (config.video.height + 15)
    return 4 * area_px + 2**20 + MAX_HEADER_BYTES * config.gop.length


def encode_message(message: Message) -> bytes:
    """Write a message."""
    match message:
        case Hello(version, decoder_id, num_groups, token):
            payload = encode_varint(version) + decoder_id + encode_varint(num_groups) + token
        case Welcome(version, config):
            payload = encode_varint(version) + config
        case NextGop() | Finished():
            payload = b""
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
    return bytes([TYPES.index(type(message)) + 1]) + encode_varint(len(payload)) + payload


def decode_payload(message_type: type[Message], payload: bytes) -> Message:
    """Read the payload of a message."""
    if message_type is ParityRequests:
        return _decode_requests(payload)
    if message_type is Failure:
        return Failure(_one_line(payload.decode(errors="replace")))
    if message_type is ParityAnswers:
        return ParityAnswers(payload)
    if message_type is NextGop or message_type is Finished:
        return message_type()
    number, position = decode_varint(payload, 0)
    message: Message = GopDone(number) if message_type is GopDone else End(number)
    if message_type is Hello:
        message = Hello(number)
        if number == PROTOCOL_VERSION:
            end = position + DECODER_ID_BYTES
            num_groups, last = decode_varint(payload, end)
            message = Hello(number, payload[position:end], num_groups, payload[last:])
    elif message_type is Welcome:
        message = Welcome(number, payload[position:])
    elif message_type is Gop:
        message = Gop(number, decode_gop(payload[position:]))
    elif position != len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes follow the payload")
    return message
