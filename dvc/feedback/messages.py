"""Messages of the feedback channel and their syntax on the wire."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from dvc.bits import decode_varint, encode_varint
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.feedback import _kernels
from dvc.slepian_wolf import KINDS, MAX_RUN_BITS, ParityRequest, Part, RequestTable
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
    requests = table.requests()
    frames = [0, *(request.frame for request in requests)]
    return b"".join(map(_encode_request, requests, frames))


def _encode_request(request: ParityRequest, previous_frame: int) -> bytes:
    """Write a request; its frame is coded as a difference."""
    positions = request.positions
    begun = request.begun
    first = 16 * request.code + KINDS.index(request.kind)
    first += _kernels.BEGINS * (begun is not None) + _kernels.HAS_POSITIONS * bool(positions)
    numbers = [first, request.frame - previous_frame, request.run, request.count]
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
    """Write a part of a run; its frame is coded as a difference."""
    planes = (after - before for before, after in pairwise((-1, *part.planes)))
    numbers = (step, len(part.planes), *planes, len(part.areas))
    return b"".join(map(encode_varint, numbers)) + part.areas


def _decode_hello(payload: bytes) -> Hello:
    version, start = decode_varint(payload, 0)
    if version != PROTOCOL_VERSION:
        return Hello(version)
    end = start + DECODER_ID_BYTES
    num_groups, position = decode_varint(payload, end)
    return Hello(version, payload[start:end], num_groups, payload[position:])


def _decode_welcome(payload: bytes) -> Welcome:
    version, position = decode_varint(payload, 0)
    return Welcome(version, payload[position:])


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
        raise BitstreamError(_SYNTAX_FAULTS[fault])
    runs: list[list[Part]] = [[] for _ in range(num_runs)]
    first = 0
    for run, offset, last, start, stop in parts[:num_parts].tolist():
        runs[run].append(Part(offset, tuple(planes[first:last].tolist()), payload[start:stop]))
        first = last
    return ParityRequests(
        RequestTable(rows[:num_rows], positions[:num_positions], num_bits, tuple(map(tuple, runs)))
    )


def _decode_number(payload: bytes) -> int:
    """Read a payload that is one integer."""
    value, position = decode_varint(payload, 0)
    if position != len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes follow the payload")
    return value


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text).strip()


class _Syntax(NamedTuple):
    """Syntax of the payload of a message."""

    max_bytes: int | None  # None: depends on the configuration
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Message]


_SYNTAX: dict[type[Message], _Syntax] = {
    Hello: _Syntax(
        16 + DECODER_ID_BYTES + MAX_TOKEN_BYTES,
        lambda hello: (
            encode_varint(hello.version) + hello.decoder_id + encode_varint(hello.num_groups) + hello.token
        ),
        _decode_hello,
    ),
    Welcome: _Syntax(4096, lambda welcome: encode_varint(welcome.version) + welcome.config, _decode_welcome),
    NextGop: _Syntax(0, lambda _: b"", lambda _: NextGop()),
    Gop: _Syntax(None, lambda gop: encode_varint(gop.number) + encode_gop(gop.record), _decode_gop_message),
    ParityRequests: _Syntax(None, lambda requests: _encode_requests(requests.table), _decode_requests),
    ParityAnswers: _Syntax(MAX_ANSWER_BITS // 8, lambda answers: answers.packed, ParityAnswers),
    GopDone: _Syntax(
        5, lambda done: encode_varint(done.number), lambda payload: GopDone(_decode_number(payload))
    ),
    End: _Syntax(5, lambda end: encode_varint(end.num_frames), lambda payload: End(_decode_number(payload))),
    Finished: _Syntax(0, lambda _: b"", lambda _: Finished()),
    Failure: _Syntax(
        _MAX_FAILURE_BYTES,
        lambda failure: _one_line(failure.text).encode()[:_MAX_FAILURE_BYTES],
        lambda payload: Failure(_one_line(payload.decode(errors="replace"))),
    ),
}
TYPES = tuple(_SYNTAX)
"""Message types; the type byte of a message is its index here plus one."""


def max_payload_bytes(message_type: type[Message], config: CodecConfig | None) -> int:
    """Return the size of the largest valid payload of a message."""
    max_bytes = _SYNTAX[message_type].max_bytes
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
    payload = _SYNTAX[type(message)].encode(message)
    return bytes([TYPES.index(type(message)) + 1]) + encode_varint(len(payload)) + payload


def decode_payload(message_type: type[Message], payload: bytes) -> Message:
    """Read the payload of a message."""
    return _SYNTAX[message_type].decode(payload)
