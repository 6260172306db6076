"""Decoding on a Dask cluster: two worker processes, one of which is killed; order, bounds, refusals."""

import io
import json
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from distributed import Client, LocalCluster

import decoder.__main__ as decoder
from decoder import cluster
from decoder.cluster import GROUPS_PER_THREAD, decode_group, decode_on_cluster
from decoder.group_tasks import DecodedGroup, GroupTask
from dvc.config import DiscoverMatrix, VideoConfig, codec_config
from dvc.errors import BitstreamError, DvcError
from dvc.stream import Form, StreamReader
from dvc.versions import codec_digest, library_versions
from tests import streams
from tests.clips import moving_texture
from tests.waiting import wait_until

CONFIG = codec_config(
    VideoConfig(96, 64, 25, 1), "2d", DiscoverMatrix(4), gop={"length": 3}, key={"qp": 30, "intra_period": 8}
)
NUM_GROUPS = 9
PATIENCE_S = 60


@pytest.fixture(scope="module")
def stream() -> bytes:
    """Return a buffered stream of nine groups, of which some begin a chain of key frames."""
    return streams.encoded(CONFIG, moving_texture(3 * NUM_GROUPS - 2, 64, 96))


@pytest.fixture(scope="module")
def recording(stream: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with that stream as two segments."""
    folder = tmp_path_factory.mktemp("recording")
    for number in (2, 10):
        (folder / f"day-{number}.dvc").write_bytes(stream)
    return folder


@pytest.fixture(scope="module")
def workers() -> Iterator[LocalCluster]:
    """Start a scheduler and two worker processes of one thread each."""
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
    ) as started:
        yield started


def decoded(stream: bytes, client: object) -> Generator[DecodedGroup]:
    """Decode a stream on a cluster, or what stands for one."""
    reader = StreamReader(io.BytesIO(stream))
    return decode_on_cluster(reader.config, reader, cast(Client, client))


def contents(groups: list[DecodedGroup]) -> list[bytes]:
    return [
        pickle.dumps([group.first_index, group.record, *(plane.tobytes() for plane in planes(group))])
        for group in groups
    ]


def planes(group: DecodedGroup) -> Iterator[Any]:
    for frame in group.frames:
        yield from (frame.luma, *(frame.chroma or ()))


def kill_a_worker_at_work(client: Client) -> int:
    """Kill the process of a worker that decodes, or that has something decoded; return its process id."""
    pids = client.run(os.getpid)
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        for held in (client.processing(), client.has_what()):
            if at_work := [worker for worker, keys in held.items() if keys]:
                os.kill(pids[at_work[0]], signal.SIGKILL)
                return int(pids[at_work[0]])
        time.sleep(0.01)
    raise TimeoutError("no worker was at work")


def test_a_killed_worker_changes_nothing(stream: bytes, workers: LocalCluster) -> None:
    expected = contents(streams.decoded(stream, 2))
    killed, found = 0, []
    with Client(workers.scheduler_address, set_as_default=False) as client:
        for group in decoded(stream, client):
            found.append(group)
            if len(found) == 2:
                killed = kill_a_worker_at_work(client)
        client.wait_for_workers(2, timeout=PATIENCE_S)
        assert killed not in client.run(os.getpid).values()
    assert len(found) == NUM_GROUPS
    assert contents(found) == expected


def run(*arguments: object) -> int:
    return decoder.main([*map(str, arguments), "--quiet"])


def report_of(path: Path) -> dict[str, Any]:
    report = cast(dict[str, Any], json.loads(path.read_text()))
    for entry in (report, *report["per_frame"]):
        entry.pop("decode_s", None)
    return report


def test_a_recording_is_decoded_to_the_same_files(
    recording: Path, workers: LocalCluster, tmp_path: Path
) -> None:
    for name, where in (("jobs", ("--jobs", 2)), ("dask", ("--dask", workers.scheduler_address))):
        video, punctured, report = (tmp_path / f"{name}{suffix}" for suffix in (".y4m", ".dvc", ""))
        assert run(recording, video, "--punctured", punctured, "--json", report, *where) == 0
    for suffix in (".y4m", ".dvc"):
        assert (tmp_path / f"dask{suffix}").read_bytes() == (tmp_path / f"jobs{suffix}").read_bytes()
    report = report_of(tmp_path / "dask")
    assert report == report_of(tmp_path / "jobs")
    assert report["frames"] == 2 * (3 * NUM_GROUPS - 2)
    part = (tmp_path / "part.y4m", "--frames", "24:27", "--dask", workers.scheduler_address)
    assert run(recording, *part) == 0
    size = 3 * 96 * 64 // 2 + len(b"FRAME\n")
    whole = (tmp_path / "dask.y4m").read_bytes()
    head = whole.index(b"\n") + 1
    assert (tmp_path / "part.y4m").read_bytes()[head:] == whole[head + 24 * size : head + 27 * size]


def test_what_a_group_ends_with_has_its_place(stream: bytes, workers: LocalCluster) -> None:
    reader = StreamReader(io.BytesIO(stream))
    records = list(reader)
    bad = replace(records[3], wyner_ziv=(records[3].wyner_ziv[0], b""))
    damaged = streams.written(reader.config, [*records[:3], bad, *records[4:]], Form.BUFFERED)
    found: list[int] = []
    with Client(workers.scheduler_address, set_as_default=False) as client:
        groups = decoded(damaged, client)
        with pytest.raises(BitstreamError, match="group of pictures 3: "):
            found.extend(group.first_index for group in groups)
    assert found == [0, 1, 4]


class Kept:
    """A cluster that notes what it is given, and decodes it when it is asked for."""

    class Future:
        def __init__(self, given: tuple[Any, ...]) -> None:
            self.given, self.asked = given, False

        def exception(self, timeout: float) -> None:
            """Say that it went well."""

        def result(self) -> DecodedGroup | Exception:
            self.asked = True
            return decode_group(*self.given)

    def __init__(self, num_threads: int) -> None:
        self.num_threads = num_threads
        self.futures: list[Kept.Future] = []
        self.cancelled: list[Kept.Future] = []
        self.most_open = 0

    def nthreads(self) -> dict[str, int]:
        return {"one": self.num_threads - 1, "other": 1}

    def submit(self, function: object, *given: Any, key: str) -> "Kept.Future":
        assert function is decode_group
        assert key
        self.futures.append(Kept.Future(given))
        self.most_open = max(self.most_open, sum(not future.asked for future in self.futures))
        return self.futures[-1]

    def cancel(self, futures: list["Kept.Future"]) -> None:
        self.cancelled += futures


def test_no_worker_gets_more_than_its_group(stream: bytes) -> None:
    client = Kept(3)
    groups = list(decoded(stream, client))
    assert client.most_open == 3 * GROUPS_PER_THREAD < NUM_GROUPS == len(groups)
    tasks = [future.given[0] for future in client.futures]
    assert [task.number for task in tasks] == list(range(NUM_GROUPS))
    assert {task.record.predicted for task in tasks} == {False, True}
    frame_bytes = 3 * 96 * 64 // 2
    for task, record in zip(tasks, StreamReader(io.BytesIO(stream)), strict=True):
        assert isinstance(task, GroupTask)
        assert task.record == record
        most = len(record.key) + sum(map(len, record.wyner_ziv)) + 2 * frame_bytes + 2000
        assert len(pickle.dumps(task)) < most
    assert {len(future.given) for future in client.futures} == {2}
    assert client.cancelled == []


def test_what_is_given_up_is_cancelled(stream: bytes) -> None:
    client = Kept(1)
    groups = decoded(stream, client)
    next(groups)
    groups.close()
    assert len(client.futures) == GROUPS_PER_THREAD + 1
    assert client.cancelled == client.futures[1:]


def test_a_group_that_nobody_wants_ends(stream: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "POLL_S", 0.0)
    monkeypatch.setattr(cluster, "_is_executing", lambda: lambda: False)
    ended = decode_group(streams.tasks_of(stream)[-1], codec_digest())
    assert isinstance(ended, DvcError)
    assert "was cancelled" in str(ended)


def test_a_worker_with_other_code_decodes_nothing(stream: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    task, digest = streams.tasks_of(stream)[0], codec_digest()
    assert "another version of the code" in str(decode_group(task, "f" * 32))
    assert isinstance(decode_group(task, digest), DecodedGroup)
    monkeypatch.setattr(cluster, "_loaded_digest", lambda: "e" * 32)
    assert isinstance(decode_group(task, digest), DvcError)


def test_an_interrupt_leaves_nothing_on_the_cluster(
    recording: Path, workers: LocalCluster, tmp_path: Path
) -> None:
    arguments = [recording, tmp_path / "o.y4m", "--dask", workers.scheduler_address]
    process = subprocess.Popen(
        [sys.executable, "-m", "decoder", *map(str, arguments)], stderr=subprocess.PIPE, text=True
    )
    with Client(workers.scheduler_address, set_as_default=False) as client:
        wait_until(lambda: any(client.processing().values()))
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, said) == (130, "dvc-decode: interrupted\n")
        wait_until(lambda: not any(client.processing().values()))
        wait_until(lambda: not any(client.has_what().values()))
    assert list(tmp_path.iterdir()) == []


def test_clusters_that_cannot_decode_are_refused(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvc.dask_cluster.CONNECT_S", 0.2)
    monkeypatch.setattr("dvc.dask_cluster.WORKERS_S", 0.2)
    output = tmp_path / "o.y4m"
    assert run(recording, output, "--dask", "tcp://127.0.0.1:1") == 2
    assert run(output, "--connect", "127.0.0.1:1", "--dask", "tcp://127.0.0.1:1") == 2
    with LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty:
        assert run(recording, output, "--dask", empty.scheduler_address) == 2
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run(recording, output, "--dask", "tcp://127.0.0.1:1") == 2
    lines = capfd.readouterr().err.splitlines()
    words = (
        "no Dask scheduler answers at 'tcp://127.0.0.1:1'",
        "--dask excludes --connect",
        "has no workers",
        "pip install 'dvc3d[dask]'",
    )
    assert len(lines) == len(words)
    assert all(word in line for word, line in zip(words, lines, strict=True))
    assert list(tmp_path.iterdir()) == []


def test_workers_with_another_library_are_refused(
    recording: Path,
    workers: LocalCluster,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(library_versions(), "numpy", "99.0")
    assert run(recording, tmp_path / "o.y4m", "--dask", workers.scheduler_address) == 2
    (said,) = capfd.readouterr().err.splitlines()
    assert "has numpy" in said
    assert "not 99.0" in said
    assert list(tmp_path.iterdir()) == []
