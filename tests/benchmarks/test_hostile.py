"""Hostile input: mutations are of their kinds, and a few of each kind do no harm."""

import io
import os
import resource
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from itertools import pairwise
from multiprocessing import connection as mp_connection
from pathlib import Path
from threading import Event

import numpy as np
import pytest

import benchmarks.hostile.__main__ as main
from benchmarks.hostile import (
    attempts,
    batches,
    depth_streams,
    material,
    mutations,
    workers,
)
from dvc.bits import decode_varint
from dvc.dibr.depth_image.depth_image_stream import decode_stream as decode_depth_image
from dvc.dibr.depth_image.piece_stream import decode_stream as decode_pieces
from dvc.dibr.view_stream import decode_stream
from dvc.errors import BitstreamError
from dvc.feedback.messages import TYPES
from dvc.stream import RecordType, StreamReader

NUM_GOPS = 2
FINDS = Path(__file__).parents[1] / "golden" / "finds"


@pytest.fixture(scope="module", autouse=True)
def _forked() -> Iterator[None]:
    with workers.forked_workers():
        yield


def _complaint(stream: bytes) -> str:
    try:
        with StreamReader(io.BytesIO(stream)) as reader:
            list(reader)
    except BitstreamError as err:
        return str(err)
    return ""


def test_records_of_a_stream_are_found() -> None:
    stream = material.material().buffered
    spans = mutations.record_spans(stream)
    assert [kind for kind, _, _ in spans] == [1, *[RecordType.GOP] * NUM_GOPS, 3]
    assert all(before[2] == after[1] for before, after in pairwise(spans))
    assert spans[-1][2] == len(stream)


def test_mended_records_pass_their_checksums() -> None:
    stream = material.material().punctured
    for seed in range(40):
        damaged = mutations.mutate_record(stream, np.random.default_rng(seed))
        assert "checksum" not in _complaint(damaged)


@pytest.mark.parametrize("kind", ["views", "depth_images", "pieces"])
def test_mended_streams_with_depth_pass_their_checksums(kind: str) -> None:
    """Damage of parts with mended lengths and checksums reaches the decoders behind them."""
    good, change, decode = {
        "views": (depth_streams.good_views, depth_streams.mutate_pictures, decode_stream),
        "depth_images": (
            depth_streams.good_depth_images,
            depth_streams.mutate_depth_image,
            decode_depth_image,
        ),
        "pieces": (depth_streams.good_pieces, depth_streams.mutate_pieces, decode_pieces),
    }[kind]
    stream, num_whole = good()[-3], 0
    assert decode(stream).damage is None
    for seed in range(40):
        with suppress(BitstreamError):
            num_whole += decode(change(stream, np.random.default_rng(seed))).damage is None
    assert num_whole > 20


def test_parts_of_a_depth_image_are_found() -> None:
    stream = depth_streams.good_depth_images()[5]
    start, parts = depth_streams.parts_of(stream)
    assert stream[start : start + len(parts.edges)] == parts.edges != b""


def test_mutations_depend_on_their_number_alone() -> None:
    damaged = [mutations.mutate(bytes(range(200)), np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert damaged[0] == damaged[1] != damaged[2]
    assert mutations.mutate(b"", np.random.default_rng(0))


def test_random_messages_have_a_type_and_their_length() -> None:
    types = set()
    for seed in range(100):
        message = mutations.random_message(np.random.default_rng(seed))
        size, start = decode_varint(message, 1)
        assert len(message) == start + size
        types.add(message[0])
    assert types == set(range(1, 1 + len(TYPES)))


def test_enlarged_headers_pass_their_checksums() -> None:
    stream = material.material().buffered
    sizes = set()
    for seed in range(40):
        damaged = mutations.enlarge(stream, np.random.default_rng(seed))
        with suppress(BitstreamError), StreamReader(io.BytesIO(damaged)) as reader:
            sizes.add((reader.config.video.width, reader.config.gop.length))
    assert {640, 4096} <= {width for width, _ in sizes}
    assert len(sizes) > 5


@pytest.mark.parametrize("kind", batches.KINDS)
def test_mutations_do_no_harm(kind: str) -> None:
    """Some mutations of every kind are refused or decoded, and undamaged groups survive."""
    chosen = attempts.kinds()[kind]
    for number in range(4):
        assert chosen.outcome(chosen.damaged(number)) in batches.GOOD, number


@pytest.mark.parametrize("name", sorted(f"{path.parent.name}/{path.name}" for path in FINDS.glob("*/*")))
def test_finds_do_no_harm_any_more(name: str) -> None:
    kind, _, _ = name.partition("/")
    assert attempts.kinds()[kind].outcome((FINDS / name).read_bytes()) in batches.GOOD


@pytest.mark.parametrize("codec", ["2d", "3d-te", "3d-td"])
def test_what_is_mutated_is_good(codec: str) -> None:
    made = material.material(codec)
    for stream in (made.buffered, made.punctured):
        good = nullcontext((stream, made.groups)).__enter__
        assert attempts.try_stream(good, stream) == "decoded"


def test_harm_is_told() -> None:

    def harm(damaged: bytes) -> str:
        if damaged == b"3":
            return "an undamaged group is lost"
        raise (batches.TooLong, MemoryError, ZeroDivisionError("by zero"))[int(damaged)]

    kind = attempts.Kind(lambda number: str(number).encode(), harm)
    outcomes = {number: batches.outcome_of(kind, kind.damaged(number)) for number in range(4)}
    assert outcomes[0].startswith("hang")
    assert outcomes[1].startswith("allocation")
    assert "ZeroDivisionError" in outcomes[2]
    assert not batches.GOOD & set(outcomes.values())


def test_time_and_memory_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = attempts.Kind(lambda _: b"", lambda _: str(np.ones(2**30)[-1]), num_pixels=1)
    assert batches.outcome_of(kind, b"").startswith("allocation")
    monkeypatch.setattr(batches, "max_seconds", lambda _: 0.01)
    kind = attempts.Kind(lambda _: b"", lambda _: "refused" * Event().wait(60.0))
    assert batches.outcome_of(kind, b"").startswith("hang")


def test_memory_is_limited_beyond_what_the_process_holds_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """A decoding process may be larger than the one that has it forked, and gets as much beyond that."""
    sizes, limits, most = [2**30, 2**31], list[tuple[int, int]](), 2**20
    monkeypatch.setattr(workers, "address_bytes", lambda: sizes.pop(0))
    monkeypatch.setattr(resource, "getrlimit", lambda _: (2**30 + most, resource.RLIM_INFINITY))
    monkeypatch.setattr(resource, "setrlimit", lambda _, limit: limits.append(limit))
    monkeypatch.setattr(workers.multiprocessing, "get_context", lambda _: threading)
    monkeypatch.setattr(workers.decoder.processes, "serve", lambda _: None)
    monkeypatch.setattr(threading, "Process", threading.Thread, raising=False)
    workers._Child(mp_connection.Pipe()[0])._child.join()
    assert limits == [(2**31 + most, resource.RLIM_INFINITY)]


def test_decoding_processes_are_forked() -> None:
    """A program that is started for each mutation takes a second, and the time limit of a live run."""
    process = workers.decoder.processes.DecodingProcess()
    assert isinstance(process._process, workers._Child)
    process.stop()


def test_a_crash_counts_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mutation that ends its process is a crash, and a new process continues after it."""

    def child(tries: Sequence[batches.Try], _advance: batches.Advance) -> tuple[list[str], str]:
        before = [number for _, number in tries].index(5) if ("colour", 5) in tries else len(tries)
        return ["refused"] * before, "crash: status -11"

    monkeypatch.setattr(batches, "_child", child)
    outcomes = batches.run([("colour", number) for number in range(300)])
    assert outcomes == ["refused"] * 5 + ["crash: status -11"] + ["refused"] * 294


def test_command_tells_outcomes_by_kinds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Mutations that did harm are listed and stored, and the exit status is not 0."""

    def run(tries: Sequence[batches.Try], _advance: batches.Advance) -> list[str]:
        return ["hang" if each == ("cameras", 7) else "refused" for each in tries]

    monkeypatch.setattr(main, "run", run)
    options = ["--kind", "cameras", "--kind", "layers", "--first", "6", "--finds", str(tmp_path)]
    assert main.main([*options, "--count", "3"]) == 2
    assert capsys.readouterr().out == "cameras: 2 refused\n  7: hang\nlayers: 3 refused\n"
    kept = tmp_path / "cameras" / "7.bin"
    assert kept.read_bytes() == attempts.kinds()["cameras"].damaged(7)
    assert list(tmp_path.glob("*/*")) == [kept]
    monkeypatch.undo()
    assert main.main(["--kind", "cameras", "--count", "3"]) == 0
    assert capsys.readouterr().out.startswith("cameras: ")


def test_a_process_that_says_nothing_is_killed() -> None:
    barked = Event()
    watchdog = batches.Watchdog(barked.set)
    watchdog.feed(0.01)
    assert barked.wait(60.0)
    assert watchdog.barked


def test_wrong_indices_are_noticed_only_where_bounds_are_checked(tmp_path: Path) -> None:
    """Kernels with an index out of bounds fail under bounds checks; otherwise a message says so."""
    command = [sys.executable, "-m", "benchmarks.hostile.bounds"]
    checked = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(command, env=checked, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.count("\n")) == (0, 1), done.stderr
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "bounds are not checked" in done.stderr
