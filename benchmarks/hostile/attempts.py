"""Who must bear mutations: the decoder of a stream, and both ends of a live run."""

import io
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from benchmarks.hostile.depth_images import try_depth_images
from benchmarks.hostile.layered_pieces import try_pieces
from benchmarks.hostile.material import Luma, decoded_groups, live_run, material, serve, tracked_material
from benchmarks.hostile.mutations import mutate, mutate_record, mutate_tracks, record_spans
from benchmarks.hostile.pictures import try_pictures
from dvc.errors import BitstreamError, FeedbackError
from dvc.stream import StreamReader
from dvc.stream.records import RecordType


def try_tracked(codec: str, number: int, allocated: bool = False) -> str:
    """Decode a mutation of a stream with tracks or points; most damage these."""
    stream, groups = tracked_material(codec, allocated)
    rng = np.random.default_rng(number)
    damaged = mutate_record(stream, rng) if number % 4 == 0 else mutate_tracks(stream, rng)
    return _judged(stream, damaged, groups)


def try_stream(stream: bytes, groups: list[list[Luma]], number: int) -> str:
    """Decode a mutation of a stream."""
    rng = np.random.default_rng(number)
    damaged = mutate(stream, rng) if number % 2 else mutate_record(stream, rng)
    return _judged(stream, damaged, groups)


def _judged(stream: bytes, damaged: bytes, groups: list[list[Luma]]) -> str:
    """Decode a damaged stream; groups before the damage must be those of the good one."""
    same = next((i for i, (a, b) in enumerate(zip(stream, damaged, strict=False)) if a != b), len(damaged))
    gops = [end for kind, _, end in record_spans(stream) if kind == RecordType.GOP]
    intact = sum(end <= same for end in gops)
    done, outcome = 0, "decoded"
    try:
        with StreamReader(io.BytesIO(damaged)) as reader:
            for (group, _), expected in zip(decoded_groups(reader), groups, strict=False):
                if done < intact and not all(map(np.array_equal, group, expected)):
                    return "an undamaged group decodes to other frames"
                done += 1
    except BitstreamError:
        outcome = "refused"
    return outcome if done >= intact else f"an undamaged group is lost: {done} of {intact} decoded"


class _Replay:
    """A connection whose peer sends what was recorded, and then goes away."""

    def __init__(self, chunks: Sequence[bytes]) -> None:
        self._chunks = iter(chunks)

    def send(self, data: bytes) -> None:
        """Throw away."""

    def has_received(self) -> bool:
        """Let the encoder send all that it may."""
        return False

    def receive(self) -> bytes:
        for chunk in self._chunks:
            if chunk:
                return chunk
        raise FeedbackError("the other side closed the connection")


def try_encoder(number: int) -> str:
    """Let the encoder of a live run receive a mutation of what it once received."""
    made, rng = material(), np.random.default_rng(number)
    damaged = list(made.to_encoder)
    place = int(rng.integers(len(damaged)))
    match number % 8:
        case 0:
            damaged.insert(place, damaged[int(rng.integers(len(damaged)))])
        case 1:
            del damaged[place]
        case _:
            damaged[place] = mutate(damaged[place], rng)
    try:
        serve(made.frames, made.config, _Replay(damaged))
    except FeedbackError:
        return "refused"
    return "decoded"


def try_decoder(number: int) -> str:
    """Let the decoder of a live run, with many requests in flight, receive a mutation of what was sent."""
    made, rng = material(), np.random.default_rng(number)
    place, passed = int(rng.integers(1, len(made.to_encoder))), [b""]

    def _change(data: bytes) -> bytes:
        passed.append(data)
        if len(passed) != place + 1:
            return data
        match number % 8:
            case 0:
                return data + passed[int(rng.integers(len(passed)))]
            case 1:
                return b""
            case _:
                return mutate(data, rng)

    failure, _ = live_run(made.frames, made.config, (_change, lambda data: data))
    if failure is not None and not isinstance(failure, BitstreamError | FeedbackError):
        raise failure
    return "decoded" if failure is None else "refused"


def kinds() -> dict[str, Callable[[int], str]]:
    """Return what can be mutated."""
    return {
        "buffered": lambda number: try_stream(material().buffered, material().groups, number),
        "punctured": lambda number: try_stream(material().punctured, material().groups, number),
        "allocated": _try_allocated,
        "tracks": partial(try_tracked, "3d-te"),
        "points": partial(try_tracked, "3d-td"),
        "anchors": partial(try_tracked, "3d-te", allocated=True),
        "to-decoder": try_decoder,
        "to-encoder": try_encoder,
        "pictures": try_pictures,
        "depth-images": try_depth_images,
        "layers": try_pieces,
    }


def _try_allocated(number: int) -> str:
    made = material(allocated=True)
    stream = made.buffered if number % 4 < 2 else made.punctured
    return try_stream(stream, made.groups, number)
