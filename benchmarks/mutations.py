"""What hostile input is made of: good streams and messages, their mutations, and who must bear them."""

import io
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.bits import decode_varint, encode_varint
from dvc.config import (
    CodecConfig,
    GopConfig,
    KeyFrameConfig,
    VideoConfig,
    WynerZivConfig,
    side_information_for,
    tracks_for,
)
from dvc.errors import BitstreamError, FeedbackError
from dvc.stream import GopRecord, StreamReader, StreamWriter
from dvc.stream.records import CRC_BYTES, MAGIC, RecordType, record_crc
from dvc.video import Frame

PATIENCE_S = 20
"""How long one end of a recorded live run waits for the other."""
Luma = NDArray[np.uint8]


@dataclass(frozen=True)
class Material:
    """A short sequence and everything that is made of it.

    Attributes
    ----------
    frames : list of Frame
        The sequence.
    config : CodecConfig
        Configuration of the encoder.
    buffered, punctured : bytes
        Both forms of the stream.
    groups : list of list of ndarray
        Luma of the decoded frames of each group of pictures.
    to_decoder, to_encoder : list of bytes
        Bytes that each end of a live run received, one entry per time that the other end sent some.
    """

    frames: list[Frame]
    config: CodecConfig
    buffered: bytes
    punctured: bytes
    groups: list[list[Luma]]
    to_decoder: list[bytes]
    to_encoder: list[bytes]


@cache
def material() -> Material:
    """Make the material; this also loads all compiled kernels.

    Returns
    -------
    Material
        The same in every process.
    """
    from encoder.session import EncoderSession

    noise = np.random.default_rng(1).integers(40, 216, (9, 40, 56))
    texture = np.mean([np.roll(plane, (i // 3, i % 3), (0, 1)) for i, plane in enumerate(noise)], axis=0)
    frames = [Frame(texture[t : t + 24, t : t + 32].astype(np.uint8)) for t in range(7)]
    video = VideoConfig(32, 24, 25, 1, luma_only=True)
    config = CodecConfig("2d", video, GopConfig(2), KeyFrameConfig(36), WynerZivConfig.preset(2))
    file = io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    groups, punctured = [], io.BytesIO()
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        writer = StreamWriter(punctured, reader.config, "punctured")
        for group, record in _decoded(reader):
            groups.append(group)
            writer.write_gop(record)
        writer.close()
    to_decoder, to_encoder = _record_live(frames, config)
    return Material(frames, config, file.getvalue(), punctured.getvalue(), groups, to_decoder, to_encoder)


@cache
def tracked_material(codec: str) -> tuple[bytes, list[list[Luma]]]:
    """Make a stream whose groups of pictures carry tracks or points.

    Parameters
    ----------
    codec : str
        ``3d-te`` or ``3d-td``.

    Returns
    -------
    stream : bytes
        Its buffered form.
    groups : list of list of ndarray
        Luma of the decoded frames of each group.
    """
    from encoder.session import EncoderSession

    noise = np.random.default_rng(1).integers(0, 256, (9, 80, 96))
    texture = np.mean([np.roll(plane, (i // 3, i % 3), (0, 1)) for i, plane in enumerate(noise)], axis=0)
    frames = [Frame(texture[t : t + 48, t : t + 64].astype(np.uint8)) for t in range(7)]
    config = CodecConfig(
        codec,
        VideoConfig(64, 48, 25, 1, luma_only=True),
        GopConfig(3, "hierarchical"),
        KeyFrameConfig(36),
        WynerZivConfig.preset(1),
        side_information=side_information_for(codec),
        tracks=tracks_for(codec),
    )
    file = io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        return file.getvalue(), [group for group, _ in _decoded(reader)]


def _decoded(reader: StreamReader) -> Iterator[tuple[list[Luma], GopRecord]]:
    from decoder.session import decode_stream

    for group in decode_stream(reader.config, reader):
        lumas = [frame.decoded.frame.luma for frame in group.wyner_ziv]
        yield [*lumas, group.key.luma], group.record


class _Pipe:
    """One end of a connection within this process; keeps what it received."""

    def __init__(self) -> None:
        self.inbox: queue.Queue[bytes] = queue.Queue()
        self.received: list[bytes] = []
        self.other: _Pipe | None = None

    def send(self, data: bytes) -> None:
        assert self.other is not None
        if data:
            self.other.inbox.put(data)

    def receive(self) -> bytes:
        data = self.inbox.get(timeout=PATIENCE_S)
        self.received.append(data)
        return data


class _Replay:
    """A connection whose peer sends what was recorded, and then goes away."""

    def __init__(self, chunks: Sequence[bytes]) -> None:
        self._chunks = iter(chunks)

    def send(self, data: bytes) -> None:
        """Throw away."""

    def receive(self) -> bytes:
        for chunk in self._chunks:
            if chunk:
                return chunk
        raise FeedbackError("the other side closed the connection")


def _record_live(frames: list[Frame], config: CodecConfig) -> tuple[list[bytes], list[bytes]]:
    ends = _Pipe(), _Pipe()
    ends[0].other, ends[1].other = ends[1], ends[0]
    serving = threading.Thread(target=_serve, args=(frames, config, ends[0]))
    serving.start()
    _decode_live(ends[1])
    serving.join()
    return ends[1].received, ends[0].received


def _serve(frames: list[Frame], config: CodecConfig, connection: Any) -> None:
    from encoder.live import serve
    from encoder.session import EncoderSession

    serve(EncoderSession(config), frames, connection, lambda _: None)


def _decode_live(connection: Any) -> None:
    from decoder.live import LiveSource
    from decoder.session import decode_live

    source = LiveSource(connection)
    for _ in decode_live(source.config, source):
        pass


def record_spans(stream: bytes) -> list[tuple[int, int, int]]:
    """Find the records of a good stream.

    Parameters
    ----------
    stream : bytes
        The stream.

    Returns
    -------
    list of (int, int, int)
        Type, offset of the first byte, and offset behind the last one, of every record.
    """
    spans, position = [], len(MAGIC) + 1
    while position < len(stream):
        size, start = decode_varint(stream, position + 1)
        end = start + size + CRC_BYTES
        spans.append((stream[position], position, end))
        position = end
    return spans


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage bytes in one of the ways that happen, or that somebody thinks of.

    Parameters
    ----------
    data : bytes
        Any number.
    rng : numpy.random.Generator
        Chooses.

    Returns
    -------
    bytes
        Mostly other bytes.
    """
    if not data:
        return rng.bytes(int(rng.integers(1, 9)))
    position = int(rng.integers(len(data)))
    length = int(rng.integers(1, 1 + min(64, len(data) - position)))
    before, here, after = data[:position], data[position : position + length], data[position + length :]
    bit, value = 1 << int(rng.integers(8)), int(rng.choice([0, 1, 127, 128, 255]))
    ways = (
        before + bytes([data[position] ^ bit]) + data[position + 1 :],
        before + bytes([value]) + data[position + 1 :],
        before,
        before + after,
        before + here + here + after,
        before + rng.bytes(length) + after,
        before + rng.bytes(length) + here + after,
        before + b"\xff" * min(length, 6) + after,
    )
    return ways[int(rng.integers(len(ways)))]


def mutate_record(stream: bytes, rng: np.random.Generator) -> bytes:
    """Damage the payload of one record and mend its length and checksum, so that the damage is parsed.

    Parameters
    ----------
    stream : bytes
        A good stream.
    rng : numpy.random.Generator
        Chooses.

    Returns
    -------
    bytes
        The stream with another record.
    """
    kind, begin, end = record_spans(stream)[int(rng.integers(len(record_spans(stream))))]
    size, start = decode_varint(stream, begin + 1)
    payload = mutate(stream[start : start + size], rng)
    head = bytes([kind]) + encode_varint(len(payload))
    return stream[:begin] + head + payload + record_crc(head, payload) + stream[end:]


def mutate_tracks(stream: bytes, rng: np.random.Generator) -> bytes:
    """Damage the tracks or points of one group of pictures, and nothing else.

    Parameters
    ----------
    stream : bytes
        A good stream of `tracked_material`.
    rng : numpy.random.Generator
        Chooses.

    Returns
    -------
    bytes
        The stream with other tracks.
    """
    with StreamReader(io.BytesIO(stream)) as reader:
        config, form, records = reader.config, reader.form, list(reader)
    carriers = [number for number, record in enumerate(records) if record.tracks]
    chosen = carriers[int(rng.integers(len(carriers)))]
    records[chosen] = replace(records[chosen], tracks=mutate(records[chosen].tracks, rng))
    file = io.BytesIO()
    with StreamWriter(file, config, form) as writer:
        for record in records:
            writer.write_gop(record)
    return file.getvalue()


def try_tracked(codec: str, number: int) -> str:
    """Decode a mutation of a stream with tracks or points; most damage these.

    Parameters
    ----------
    codec : str
        As `tracked_material` takes it.
    number : int
        Of the mutation.

    Returns
    -------
    str
        The outcome.
    """
    stream, groups = tracked_material(codec)
    rng = np.random.default_rng(number)
    damaged = mutate_record(stream, rng) if number % 4 == 0 else mutate_tracks(stream, rng)
    return _judged(stream, damaged, groups)


def try_stream(stream: bytes, number: int) -> str:
    """Decode a mutation of a stream.

    Parameters
    ----------
    stream : bytes
        A good stream of `material`.
    number : int
        Of the mutation.

    Returns
    -------
    str
        The outcome.
    """
    rng = np.random.default_rng(number)
    damaged = mutate(stream, rng) if number % 2 else mutate_record(stream, rng)
    return _judged(stream, damaged, material().groups)


def _judged(stream: bytes, damaged: bytes, groups: list[list[Luma]]) -> str:
    """Decode a damaged stream; groups before the damage must be those of the good one."""
    same = next((i for i, (a, b) in enumerate(zip(stream, damaged, strict=False)) if a != b), len(damaged))
    gops = [end for kind, _, end in record_spans(stream) if kind == RecordType.GOP]
    intact = sum(end <= same for end in gops)
    done, outcome = 0, "decoded"
    try:
        with StreamReader(io.BytesIO(damaged)) as reader:
            for (group, _), expected in zip(_decoded(reader), groups, strict=False):
                if done < intact and not all(map(np.array_equal, group, expected)):
                    return "an undamaged group decodes to other frames"
                done += 1
    except BitstreamError:
        outcome = "refused"
    return outcome if done >= intact else f"an undamaged group is lost: {done} of {intact} decoded"


def try_messages(chunks: Sequence[bytes], receive: Callable[[Any], None], number: int) -> str:
    """Let one end of a live run receive a mutation of what it once received.

    Parameters
    ----------
    chunks : sequence of bytes
        What it received.
    receive : callable
        Runs that end on a connection.
    number : int
        Of the mutation.

    Returns
    -------
    str
        The outcome.
    """
    rng = np.random.default_rng(number)
    damaged = list(chunks)
    place = int(rng.integers(len(damaged)))
    match number % 8:
        case 0:
            damaged.insert(place, damaged[int(rng.integers(len(damaged)))])
        case 1:
            del damaged[place]
        case _:
            damaged[place] = mutate(damaged[place], rng)
    try:
        receive(_Replay(damaged))
    except (BitstreamError, FeedbackError):
        return "refused"
    return "decoded"


def kinds() -> dict[str, Callable[[int], str]]:
    """Return what can be mutated.

    Returns
    -------
    dict of str to callable
        Takes the number of a mutation, returns its outcome.
    """
    made = material()
    serve = partial(_serve, made.frames, made.config)
    return {
        "buffered": partial(try_stream, made.buffered),
        "punctured": partial(try_stream, made.punctured),
        "tracks": partial(try_tracked, "3d-te"),
        "points": partial(try_tracked, "3d-td"),
        "to-decoder": partial(try_messages, made.to_decoder, _decode_live),
        "to-encoder": partial(try_messages, made.to_encoder, serve),
    }
