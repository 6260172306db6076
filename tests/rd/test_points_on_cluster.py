"""Points on a Dask cluster: two worker processes, of them one is killed; refusals."""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, LocalCluster

from dvc.errors import DvcError
from dvc.rd.__main__ import main
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.originals import CodeVersion, Source, code_version, find_source
from dvc.rd.rd_results import POINTS_FOLDER
from dvc.rd.run_points import measure_on_worker, run_points
from dvc.rd.specification import Point, Task
from tests.rd.made_up import write_noise

QPS = (28, 38, 48)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_noise(tmp_path_factory.mktemp("clip") / "clip.mkv")


@pytest.fixture(scope="module")
def workers() -> Iterator[LocalCluster]:
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
    ) as started:
        yield started


def _points(clip: Path) -> list[Point]:
    return [Point(str(clip), "2d", None, str(qp), 1, proof=False) for qp in QPS]


def _results(folder: Path) -> list[dict[str, Any]]:
    """Return results without entries that differ from run to run."""
    found = [
        json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / POINTS_FOLDER).iterdir())
    ]
    for data in found:
        del data["times"], data["date"]
        del data["totals"]["decode_s"]
    return found


def _kill_a_busy_worker(client: Client, folder: Path) -> int:
    """Kill the process of a worker that is measuring, once something is there; return its process id."""
    pids = client.run(os.getpid)
    deadline = time.monotonic() + 100
    while time.monotonic() < deadline:
        busy = [worker for worker, keys in client.processing().items() if keys]
        if busy and list((folder / POINTS_FOLDER).glob("*.json")):
            os.kill(pids[busy[0]], signal.SIGKILL)
            return int(pids[busy[0]])
        time.sleep(0.01)
    raise TimeoutError("no worker was busy")


def test_a_killed_worker_changes_nothing(clip: Path, workers: LocalCluster, tmp_path: Path) -> None:
    """A worker process dies while it measures: its points run again, with the same results."""
    run_points(_points(clip), tmp_path / "local", tmp_path, jobs=2)
    folder, address = tmp_path / "cluster", workers.scheduler_address
    summaries = []
    sweep = threading.Thread(
        target=lambda: summaries.append(run_points(_points(clip), folder, tmp_path, cluster=address))
    )
    with Client(address, set_as_default=False) as client:
        sweep.start()
        killed = _kill_a_busy_worker(client, folder)
        sweep.join()
        client.wait_for_workers(2, timeout=60)
        assert killed not in client.run(os.getpid).values()
    (summary,) = summaries
    assert (summary.num_measured, summary.failures) == (len(QPS), [])
    assert _results(folder) == _results(tmp_path / "local")
    pictures = [
        sorted(p.name for p in (root / "pictures").iterdir()) for root in (folder, tmp_path / "local")
    ]
    assert pictures[0] == pictures[1] != []
    again = run_points(_points(clip), folder, tmp_path, cluster=address)
    assert (again.num_measured, again.num_skipped) == (0, len(QPS))


def test_a_failing_point_on_a_cluster(clip: Path, workers: LocalCluster, tmp_path: Path) -> None:
    """A point that fails on a worker is reported with its reason, and the other points are measured."""
    points = [Point(str(clip), "2d", None, "40", 1, start=99), _points(clip)[-1]]
    summary = run_points(points, tmp_path, tmp_path, cluster=workers.scheduler_address)
    assert summary.num_measured == 1
    assert "cannot start at frame 99" in summary.failures[0][1]


def test_workers_with_other_code_are_refused(
    clip: Path, workers: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = CodeVersion("0", "f" * 32)
    monkeypatch.setattr("dvc.rd.run_points.code_version", lambda: other)
    with pytest.raises(DvcError, match="has another version of the code"):
        run_points(_points(clip), tmp_path, tmp_path, cluster=workers.scheduler_address)
    assert list((tmp_path / POINTS_FOLDER).iterdir()) == []


def test_an_original_that_is_another_one_is_refused(clip: Path, tmp_path: Path) -> None:
    """A worker measures nothing on a file of other contents, or on none, and nothing with other code."""
    source = find_source(str(clip), tmp_path, ProcessGroup())
    point = _points(clip)[0]
    other = Task(point, Source(source.name, source.path, "0" * 32), code_version())
    with pytest.raises(DvcError, match="the worker has another file of this name"):
        measure_on_worker(other)
    gone = Point("nowhere.mkv", "2d", None, "40", 1)
    with pytest.raises(DvcError, match="neither a file nor a sequence"):
        measure_on_worker(Task(gone, Source("nowhere", tmp_path / "nowhere.mkv", "0"), code_version()))
    with pytest.raises(DvcError, match="the worker has another version"):
        measure_on_worker(Task(point, source, CodeVersion("0", "0")))


def test_a_cluster_that_is_not_there(
    clip: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvc.dask_cluster.CONNECT_S", 0.2)
    arguments = ["run", str(clip), "--gop", "1", "--key-qp", "40", "--out", str(tmp_path), "--dask"]
    assert main([*arguments, "tcp://127.0.0.1:1"]) == 2
    assert main([*arguments, "no address"]) == 2
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main([*arguments, "tcp://127.0.0.1:1"]) == 2
    first, second, third = capfd.readouterr().err.splitlines()
    assert "no Dask scheduler answers at 'tcp://127.0.0.1:1'" in first
    assert "no Dask scheduler answers at 'no address'" in second
    assert "pip install 'dvc3d[dask]'" in third
