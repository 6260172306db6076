"""Damage to streams and to what they are made of."""

import io
from dataclasses import replace

import numpy as np

from dvc.bits import decode_varint, encode_varint
from dvc.stream import StreamReader, StreamWriter
from dvc.stream.records import CRC_BYTES, MAGIC, record_crc


def record_spans(stream: bytes) -> list[tuple[int, int, int]]:
    """Find the records of a good stream."""
    spans, position = [], len(MAGIC) + 1
    while position < len(stream):
        size, start = decode_varint(stream, position + 1)
        end = start + size + CRC_BYTES
        spans.append((stream[position], position, end))
        position = end
    return spans


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage bytes in one of the ways that happen, or that somebody thinks of."""
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
    """Damage the payload of one record and mend its length and checksum, so that the damage is parsed."""
    kind, begin, end = record_spans(stream)[int(rng.integers(len(record_spans(stream))))]
    size, start = decode_varint(stream, begin + 1)
    payload = mutate(stream[start : start + size], rng)
    head = bytes([kind]) + encode_varint(len(payload))
    return stream[:begin] + head + payload + record_crc(head, payload) + stream[end:]


def mutate_tracks(stream: bytes, rng: np.random.Generator) -> bytes:
    """Damage the tracks or points of one group of pictures, and nothing else."""
    with StreamReader(io.BytesIO(stream)) as reader:
        config, form, records = reader.config, reader.form, list(reader)
    with_tracks = [number for number, record in enumerate(records) if record.tracks]
    chosen = with_tracks[int(rng.integers(len(with_tracks)))]
    records[chosen] = replace(records[chosen], tracks=mutate(records[chosen].tracks, rng))
    file = io.BytesIO()
    with StreamWriter(file, config, form) as writer:
        for record in records:
            writer.write_gop(record)
    return file.getvalue()
