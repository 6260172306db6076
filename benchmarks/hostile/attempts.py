"""Kinds of mutated input: streams, messages of live runs, and files of all commands."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import cast

import numpy as np

from benchmarks.hostile import depth_streams, input_files
from benchmarks.hostile.handshakes import damaged_handshake, try_handshake
from benchmarks.hostile.input_files import Files, damaged_files, mutate_text, try_files
from benchmarks.hostile.material import (
    Luma,
    decoded_groups,
    frozen,
    live_run,
    material,
    serve,
    session,
    to_encoder,
)
from benchmarks.hostile.mutations import (
    Change,
    enlarge,
    mutate,
    mutate_part,
    mutate_record,
    num_equal,
    random_bytes,
    random_message,
    record_spans,
)
from benchmarks.hostile.workers import STREAMS
from dvc.errors import BitstreamError, ConnectionLostError, FeedbackError
from dvc.feedback import Connection, DecoderEndpoint, EncoderEndpoint
from dvc.stream import StreamReader
from dvc.stream.records import RecordType
from encoder.acceptor import AcceptedPeer


@dataclass(frozen=True)
class Kind:
    """Something that can be mutated."""

    damaged: Callable[[int], bytes]  # a mutation by its number
    outcome: Callable[[bytes], str]  # runs a mutation and returns its outcome
    num_pixels: int = 32 * 24 * 7  # size of the good input


Good = Callable[[], tuple[bytes, list[list[Luma]]]]
"""A good stream, and luma of its groups of pictures."""


def damaged_stream(good: Good, number: int) -> bytes:
    """Damage a stream: anywhere, below the checksum of a record, or in a part of a group of pictures."""
    stream, rng = good()[0], np.random.default_rng(number)
    way: Change = (mutate, mutate_record, mutate_part, mutate_part)[number % 4]
    return way(stream, rng)


def try_stream(good: Good | None, damaged: bytes, jobs: int = 1) -> str:
    """Decode a damaged stream; groups before the damage must be those of the good one."""
    stream, groups = good() if good is not None else (b"", [])
    same = num_equal(stream, damaged)
    intact = sum(end <= same for kind, _, end in record_spans(stream) if kind == RecordType.GOP)
    done, outcome = 0, "decoded"
    try:
        with StreamReader(io.BytesIO(damaged)) as reader:
            for group, _ in decoded_groups(reader, jobs):
                if done < intact and not all(map(np.array_equal, group, groups[done])):
                    return "an undamaged group decodes to other frames"
                done += 1
    except BitstreamError as err:
        outcome = "refused"
        if "allows more" in str(err):  # for declared sizes, before anything is decoded
            return outcome
    return outcome if done >= intact else f"an undamaged group is lost: {done} of {intact} decoded"


class _Replay:
    """A connection to a peer that sends a recording, and then goes away."""

    def __init__(self, chunks: Sequence[bytes]) -> None:
        self._chunks = iter(chunks)

    def send(self, data: bytes) -> None:
        """Discard data."""

    def close(self) -> None:
        """Do nothing."""

    def receive(self, within_s: float | None = None) -> bytes:
        """Return the next chunk, unless the encoder has more to send."""
        if within_s == 0.0:
            return b""
        for chunk in self._chunks:
            return chunk
        raise ConnectionLostError("the other side closed the connection")


def _changed(chunks: Sequence[bytes], position: int, seed: int, rng: np.random.Generator) -> list[bytes]:
    """Repeat an earlier chunk, drop one, put a random message before one, or damage it."""
    match seed % 8:
        case 0:
            replaced = [chunks[int(rng.integers(len(chunks)))], chunks[position]]
        case 1:
            replaced = []
        case 2 | 3:
            replaced = [random_message(rng), chunks[position]]
        case _:
            replaced = [mutate(chunks[position], rng)]
    return [*chunks[:position], *replaced, *chunks[position + 1 :]]


def try_encoder(codec: str, number: bytes) -> str:
    """Feed the encoder of a live run a mutation of the messages that it once received."""
    seed, chunks = int(number), to_encoder(codec)
    rng = np.random.default_rng(seed)
    damaged = _changed(chunks, int(rng.integers(len(chunks))), seed, rng)
    endpoint = EncoderEndpoint(session(material(codec)).config)
    endpoint.receive(DecoderEndpoint(bytes(16)).bytes_to_send())
    endpoint.send_welcome()
    try:
        serve(material(codec), AcceptedPeer(cast(Connection, _Replay(damaged)), endpoint))
    except FeedbackError:
        return "refused"
    return "decoded"


def try_decoder(codec: str, number: bytes) -> str:
    """Feed the decoder of a live run, with many requests in flight, a mutation of the messages to it."""
    seed, passed = int(number), [b""]
    rng = np.random.default_rng(seed)
    position = int(rng.integers(1, len(to_encoder(codec))))

    def _change(data: bytes) -> bytes:
        passed.append(data)
        if len(passed) != position + 1:
            return data
        return b"".join(_changed(passed, position, seed, rng)[position:])

    failure, _ = live_run(material(codec), (_change, lambda data: data))
    if failure is not None and not isinstance(failure, BitstreamError | FeedbackError):
        raise failure
    return "decoded" if failure is None else "refused"


def _of_stream(good: Good, num_pixels: int, jobs: int = 1) -> Kind:
    return Kind(partial(damaged_stream, good), partial(try_stream, good, jobs=jobs), num_pixels)


def _made(codec: str, form: str, by_qp: bool = False, jobs: int = 1) -> Kind:
    def good() -> tuple[bytes, list[list[Luma]]]:
        made = material(codec, by_qp)
        return getattr(made, form), made.groups

    return _of_stream(good, 7 * (24 * 32 if codec == "2d" else 48 * 64), jobs)


def _live(attempt: Callable[[str, bytes], str], codec: str) -> Kind:
    return Kind(lambda number: str(number).encode(), partial(attempt, codec), 7 * 48 * 64)


def _of_files(
    good: Callable[[], Sequence[Files]], read: Callable[[Path], bool], change: Change = mutate_text
) -> Kind:
    return Kind(lambda number: damaged_files(good(), number, change), partial(try_files, read))


def damaged_payload(number: int) -> bytes:
    """Put random bytes into one part of a frozen stream."""
    paths = sorted(STREAMS.glob("*.dvc"))
    return mutate_part(paths[number % len(paths)].read_bytes(), np.random.default_rng(number), random_bytes)


WAYS = {
    "pictures": (depth_streams.good_views, depth_streams.mutate_pictures, depth_streams.try_pictures),
    "depth-images": (
        depth_streams.good_depth_images,
        depth_streams.mutate_depth_image,
        depth_streams.try_depth_images,
    ),
    "layers": (depth_streams.good_pieces, depth_streams.mutate_pieces, depth_streams.try_pieces),
}
"""Streams with depth: good ones, their damage, and the outcome."""


@cache
def kinds() -> dict[str, Kind]:
    """Return all kinds of input, by name."""
    small, scene = 48 * 32 * 9, 104 * 88 * 7
    return {
        "buffered": _made("2d", "buffered"),
        "punctured": _made("2d", "punctured"),
        "qp": _made("2d", "buffered", by_qp=True),
        "qp-punctured": _made("2d", "punctured", by_qp=True),
        "tracks": _made("3d-te", "buffered"),
        "points": _made("3d-td", "buffered"),
        "predicted": _made("3d-te", "buffered", by_qp=True),
        "no-feedback": _of_stream(partial(frozen, "3d-te-no-feedback"), scene),
        "colour": _of_stream(partial(frozen, "2d-odd-colour-punctured"), small),
        "lossless-keys": _of_stream(partial(frozen, "2d-lossless-keys-buffered"), small),
        "classical": _of_stream(partial(frozen, "2d-classical-buffered"), small),
        "jobs": _made("2d", "buffered", jobs=2),
        "payloads": Kind(damaged_payload, partial(try_stream, None), 144 * 96 * 9),
        "headers": Kind(
            lambda number: enlarge(frozen("2d-qp-buffered")[0], np.random.default_rng(number)),
            partial(try_stream, None),
            1 << 20,
        ),
        "to-decoder": _live(try_decoder, "2d"),
        "to-encoder": _live(try_encoder, "2d"),
        "to-decoder-3d": _live(try_decoder, "3d-te"),
        "to-encoder-3d": _live(try_encoder, "3d-te"),
        **{name: Kind(partial(depth_streams.damaged_of, *ways[:2]), ways[2]) for name, ways in WAYS.items()},
        **{
            name: _of_files(getattr(input_files, f"good_{name}"), getattr(input_files, f"read_{name}"))
            for name in ("cameras", "maps", "folders", "tables", "videos")
        },
        "recordings": _of_files(
            input_files.good_recordings, input_files.read_recordings, input_files.mutate_segment
        ),
        "handshakes": Kind(damaged_handshake, try_handshake),
    }
