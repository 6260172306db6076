"""Damage to streams and to their parts."""

import io
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dvc.bits import decode_varint, encode_varint
from dvc.config import MAX_GOP_LENGTH, MAX_POINTS
from dvc.config.sections import MAX_AREA_PX
from dvc.feedback.messages import TYPES
from dvc.limits import MAX_SIDE_PX
from dvc.stream import RecordType, StreamReader, StreamWriter
from dvc.stream.records import CRC_BYTES, MAGIC, encode_configuration, frame_record, record_crc

Change = Callable[[bytes, np.random.Generator], bytes]


def record_spans(stream: bytes) -> list[tuple[int, int, int]]:
    """Find the records of a good stream."""
    spans, position = [], len(MAGIC) + 1
    while position < len(stream):
        size, start = decode_varint(stream, position + 1)
        end = start + size + CRC_BYTES
        spans.append((stream[position], position, end))
        position = end
    return spans


def nearest(streams: Sequence[bytes], damaged: bytes) -> bytes:
    """Return the stream with the longest common beginning with a damaged one."""
    return max(streams, key=lambda stream: num_equal(stream, damaged))


def num_equal(a: bytes, b: bytes) -> int:
    """Count the bytes from the beginning that are the same."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage bytes in one or more of several ways."""
    while True:
        data = _mutated(data, rng)
        if rng.random() < 0.6:
            return data


def _mutated(data: bytes, rng: np.random.Generator) -> bytes:
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
        random_bytes(data, rng),
    )
    return ways[int(rng.integers(len(ways)))]


def random_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return random bytes, up to twice as many."""
    return rng.bytes(int(rng.integers(1, 2 + 2 * min(len(data), 2000))))


def random_message(rng: np.random.Generator) -> bytes:
    """Return a message of a valid type and length with random bytes."""
    payload = rng.bytes(int(2.0 ** rng.uniform(0.0, 11.0)) - 1)
    return bytes([int(rng.integers(1, 1 + len(TYPES)))]) + encode_varint(len(payload)) + payload


def mutate_record(stream: bytes, rng: np.random.Generator) -> bytes:
    """Damage the payload of one record and mend its length and checksum, so that the damage is parsed."""
    kind, begin, end = record_spans(stream)[int(rng.integers(len(record_spans(stream))))]
    size, start = decode_varint(stream, begin + 1)
    payload = mutate(stream[start : start + size], rng)
    head = bytes([kind]) + encode_varint(len(payload))
    return stream[:begin] + head + payload + record_crc(head, payload) + stream[end:]


def mutate_part(stream: bytes, rng: np.random.Generator, change: Change = mutate) -> bytes:
    """Damage a key frame, the tracks or a Wyner-Ziv frame of a group of pictures, and nothing else."""
    with StreamReader(io.BytesIO(stream)) as reader:
        config, form, records = reader.config, reader.form, list(reader)
    number = int(rng.integers(len(records)))
    record, frames = records[number], list(records[number].wyner_ziv)
    parts = [name for name in ("key", "tracks") if getattr(record, name)] + ["wyner_ziv"] * bool(frames)
    part = parts[int(rng.integers(len(parts)))]
    if part == "wyner_ziv":
        chosen = int(rng.integers(len(frames)))
        frames[chosen] = change(frames[chosen], rng)
        records[number] = replace(record, wyner_ziv=tuple(frames))
    elif part == "tracks":
        records[number] = replace(record, tracks=change(record.tracks, rng))
    else:
        records[number] = replace(record, key=change(record.key or b"", rng))
    file = io.BytesIO()
    with StreamWriter(file, config, form) as writer:
        for record in records:
            writer.write_gop(record)
    return file.getvalue()


def enlarge(stream: bytes, rng: np.random.Generator) -> bytes:
    """Declare other sizes of frames and groups and numbers of points in the header, most of them huge."""
    with StreamReader(io.BytesIO(stream)) as reader:
        config, form = reader.config, reader.form
    side = [1, 16, 640, 4096, MAX_SIDE_PX]
    width = int(rng.choice(side))
    height = int(rng.choice([number for number in side if number * width <= MAX_AREA_PX]))
    if rng.random() < 0.8:
        config = replace(config, video=replace(config.video, width=width, height=height))
    if rng.random() < 0.5:
        length = int(rng.choice([1, config.gop.length, MAX_GOP_LENGTH]))
        config = replace(config, gop=replace(config.gop, length=length))
    if rng.random() < 0.5:
        tracks = replace(config.tracks, num_points=int(rng.choice([1, MAX_POINTS])))
        config = replace(config, tracks=replace(tracks, subpixel_bits=int(rng.integers(4))))
    _, begin, end = record_spans(stream)[0]
    header = frame_record(RecordType.CONFIGURATION, encode_configuration(config, form))
    return stream[:begin] + header + stream[end:]
