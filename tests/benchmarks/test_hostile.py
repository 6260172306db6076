"""Hostile input: mutations are what they claim, and the outcomes of a few of each kind are good."""

import io
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.hostile import (
    attempts,
    batches,
    depth_images,
    layered_pieces,
    material,
    mutations,
    pictures,
)
from dvc.dibr.depth_image.stream import decode_stream as decode_depth_image
from dvc.dibr.layered.stream import decode_stream as decode_pieces
from dvc.dibr.stream.layers import decode_stream
from dvc.errors import BitstreamError
from dvc.stream import RecordType, StreamReader

NUM_GOPS = 4


def _complaint(stream: bytes) -> str:
    try:
        with StreamReader(io.BytesIO(stream)) as reader:
            list(reader)
    except BitstreamError as err:
        return str(err)
    return ""


def test_records_of_a_stream_are_found() -> None:
    """The records of a stream follow each other without a gap."""
    stream = material.material().buffered
    spans = mutations.record_spans(stream)
    assert [kind for kind, _, _ in spans] == [1, *[RecordType.GOP] * NUM_GOPS, 3]
    assert all(before[2] == after[1] for before, after in pairwise(spans))
    assert spans[-1][2] == len(stream)


def test_mended_records_pass_their_checksums() -> None:
    """Damage with a mended checksum is never refused for its checksum."""
    stream = material.material().punctured
    for seed in range(40):
        damaged = mutations.mutate_record(stream, np.random.default_rng(seed))
        assert "checksum" not in _complaint(damaged)


def test_mended_layers_pass_their_checksums() -> None:
    """Damage of layers with mended checksums reaches the decoders behind them."""
    stream = pictures.good_streams()[0]
    num_whole = 0
    for seed in range(40):
        with suppress(BitstreamError):
            found = decode_stream(pictures.mutate_pictures(stream, np.random.default_rng(seed)))
            num_whole += found.damage is None
    assert num_whole > 20


def test_mended_depth_images_pass_their_checksums() -> None:
    """Damage of parts with mended checksums reaches the decoders behind them; parts are where they are."""
    stream = depth_images.good_streams()[5]
    start, parts = depth_images.parts_of(stream)
    assert stream[start : start + len(parts.edges)] == parts.edges != b""
    num_whole = 0
    for seed in range(40):
        with suppress(BitstreamError):
            damaged = depth_images.mutate_depth_image(stream, np.random.default_rng(seed))
            num_whole += decode_depth_image(damaged).damage is None
    assert num_whole > 20


def test_mended_pieces_pass_their_checksums() -> None:
    """Damage of layers and sprites with mended lengths and checksums reaches the decoders behind them."""
    num_whole = 0
    for number, stream in enumerate(layered_pieces.good_streams()):
        assert decode_pieces(stream).damage is None
        for seed in range(20):
            with suppress(BitstreamError):
                damaged = layered_pieces.mutate_pieces(stream, np.random.default_rng((number, seed)))
                num_whole += decode_pieces(damaged).damage is None
    assert num_whole > 30


def test_mutations_depend_on_their_number_alone() -> None:
    """The same number damages in the same way, others in others."""
    damaged = [mutations.mutate(bytes(range(200)), np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert damaged[0] == damaged[1] != damaged[2]
    assert mutations.mutate(b"", np.random.default_rng(0))


@pytest.mark.parametrize("kind", batches.KINDS)
def test_mutations_do_no_harm(kind: str) -> None:
    """Some mutations of every kind are refused or decoded, and undamaged groups survive."""
    attempt = attempts.kinds()[kind]
    assert {attempt(number) for number in range(8)} <= batches.GOOD


def test_harm_is_told() -> None:
    """A hang, an allocation, a traceback and a lost group are failures."""

    def harm(number: int) -> str:
        if number == 3:
            return "an undamaged group is lost"
        raise (TimeoutError, MemoryError, ZeroDivisionError("by zero"))[number]

    outcomes = {number: batches._outcome(harm, number) for number in range(4)}
    assert outcomes[0].startswith("hang")
    assert outcomes[1].startswith("allocation")
    assert "ZeroDivisionError" in outcomes[2]
    assert set(batches.summary(outcomes)[1]) == {0, 1, 2, 3}


def test_crash_is_narrowed_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a batch that ends its process, only the mutation that does it counts as a crash."""

    def child(_kind: str, first: int, count: int) -> list[str] | str:
        return "crash: status -11" if first <= 5 < first + count else ["refused"] * count

    monkeypatch.setattr(batches, "_child", child)
    counts, failures = batches.summary(batches.run_kind("buffered", 0, 300))
    assert failures == {5: "crash: status -11"}
    assert counts["refused"] == 299
