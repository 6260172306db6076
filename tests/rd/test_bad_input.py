"""Failures of sweeps: signals, full disks, missing decoders, results of other sizes."""

import errno
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import astuple
from importlib import util
from pathlib import Path
from typing import Any

import pytest

from dvc.rd import rd_results, run_points
from dvc.rd.__main__ import main
from dvc.rd.child_processes import ProcessGroup, Stopped
from dvc.rd.originals import CodeVersion
from dvc.rd.rd_results import POINTS_FOLDER, PictureFiles, PointResult
from dvc.rd.specification import Point, Task
from tests.rd.made_up import add_result, result_data, write_noise

NO_SPACE = OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two frames of noise, so that even a small stream takes some room."""
    return write_noise(tmp_path_factory.mktemp("clip") / "clip.mkv")


def _command(clip: Path, out: Path, qps: Iterable[int] = (30,)) -> list[str]:
    options = ["--gop", "1", "--key-qp", ",".join(map(str, qps)), "--out", str(out)]
    return [sys.executable, "-m", "dvc.rd", "run", str(clip), *options]


def _leftovers(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_leave_whole_points_and_the_sweep_continues(
    clip: Path, tmp_path: Path, number: signal.Signals
) -> None:
    out = tmp_path / "out"
    with subprocess.Popen(_command(clip, out, range(20, 40)), stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        while not list(out.glob(".running-*")) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(number)
        _, messages = process.communicate(timeout=60)
    assert process.returncode == 130
    assert messages.splitlines()[-1] == "dvc-rd: interrupted"
    measured = [rd_results.read_result(path) for path in (out / POINTS_FOLDER).iterdir()]
    points = [f"{POINTS_FOLDER}/{result.name}.json" for result in measured]
    named = [name for result in measured for name in astuple(result.pictures or PictureFiles())]
    pictures = {name for name in named if isinstance(name, str)}
    assert _leftovers(out) == sorted([*points, *pictures])
    last = subprocess.run(_command(clip, out, [39]), capture_output=True, text=True, check=False)
    assert last.returncode == 0, last.stderr
    assert "1 points: 1 measured, 0 already there, 0 failed" in last.stderr


def test_a_disk_without_room_for_streams(clip: Path, tmp_path: Path) -> None:

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))

    out = tmp_path / "out"
    finished = subprocess.run(
        _command(clip, out), capture_output=True, text=True, check=False, preexec_fn=limit
    )
    assert finished.returncode == 2
    failure, counts = finished.stderr.splitlines()
    assert "failed: " in failure
    assert "File too large" in failure
    assert "0 measured, 0 already there, 1 failed" in counts
    assert _leftovers(out) == []


def test_a_disk_without_room_for_results(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_points, "measure", lambda *_: result_data(60.0, 30.0))
    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", _fail(NO_SPACE))
        points = [Point(str(clip), "2d", None, str(qp), 1) for qp in (30, 31)]
        summary = run_points.run_points(points, tmp_path / "out", tmp_path, jobs=2)
    assert [reason.endswith("No space left on device") for _, reason in summary.failures] == [True, True]
    assert _leftovers(tmp_path / "out") == []
    assert run_points.run_points(points, tmp_path / "out", tmp_path).num_measured == 2


def _fail(error: Exception) -> Callable[..., Any]:
    def failing(*_: object, **__: object) -> None:
        raise error

    return failing


@pytest.mark.parametrize(
    ("target", "value", "reason"),
    [
        ("tempfile.mkdtemp", _fail(NO_SPACE), "No space left on device"),
        ("sys.executable", "/nowhere/python", "cannot start /nowhere/python: No such file or directory"),
        ("dvc.rd.run_points.measure", _fail(KeyError("totals")), "KeyError: 'totals'"),
        # The code was edited while the point was measured.
        ("dvc.rd.run_points.code_version", lambda: CodeVersion("1", "f" * 32), "the code was changed"),
    ],
)
def test_failing_points_have_a_reason_and_no_result(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str, value: object, reason: str
) -> None:
    monkeypatch.setattr(run_points, "measure", lambda *_: result_data(60.0, 30.0))
    monkeypatch.setattr(target, value)
    points = [Point(str(clip), "2d", None, "30", 1)]
    summary = run_points.run_points(points, tmp_path / "out", tmp_path)
    assert [reason in text for _, text in summary.failures] == [True]
    assert _leftovers(tmp_path / "out") == []


def test_a_decoder_that_is_not_installed(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    found = util.find_spec
    monkeypatch.setattr(util, "find_spec", lambda name: None if name == "decoder" else found(name))
    assert main(["run", str(clip), "--out", str(tmp_path / "out")]) == 2
    message = capfd.readouterr().err
    assert message == "dvc-rd: the package 'decoder' is not installed, so that no point can be measured\n"
    assert not (tmp_path / "out").exists()


def test_an_unexpected_error(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:

    def measure(task: Task, *_: object) -> dict[str, Any]:
        if task.point.key_qp == "30":
            raise KeyError("totals")
        return result_data(60.0, 30.0)

    monkeypatch.setattr(run_points, "measure", measure)
    points = [Point(str(clip), "2d", None, qp, 1) for qp in ("30", "31")]
    summary = run_points.run_points(points, tmp_path / "out", tmp_path)
    assert [reason for _, reason in summary.failures] == ["KeyError: 'totals'"]
    assert summary.num_measured == 1


def test_processes_have_one_thread(tmp_path: Path) -> None:
    found = tmp_path / "found"
    numbers = "cv2.getNumThreads(), numba.get_num_threads()"
    code = f"import cv2, numba; print({numbers}, file=open({str(found)!r}, 'w'))"
    ProcessGroup().run([sys.executable, "-c", code])
    assert found.read_text(encoding="utf-8").split() == ["1", "1"]


def test_stopping_processes_that_have_ended() -> None:
    processes = ProcessGroup()
    child = subprocess.Popen([sys.executable, "-c", ""], start_new_session=True)
    child.wait()
    processes._running.add(child.pid)
    processes.stop()
    with pytest.raises(Stopped):
        processes.run([sys.executable, "-c", ""])


def test_sequences_of_several_sizes_in_one_report(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    other = {"name": "clip", "digest": "d2", "width": 32, "height": 16, "frames_per_s": 12.5}
    for number, rate_kbps in enumerate((60.0, 90.0)):
        add_result(tmp_path, f"a{number}", result_data(rate_kbps, 30.0 + number))
        add_result(tmp_path, f"b{number}", result_data(rate_kbps, 31.0 + number, sequence=other))
        add_result(tmp_path, f"c{number}", result_data(rate_kbps, 29.5 + number, codec="h264-intra"))
    add_result(tmp_path, "damaged", {"schema": "dvc3d-rd-point/0"})
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r.md")]) == 0
    text = (tmp_path / "r.md").read_text(encoding="utf-8")
    assert "clip: 64×48" in text
    assert "clip: 32×16" in text
    capfd.readouterr()
    assert main(["compare", str(tmp_path)]) == 0
    assert len(capfd.readouterr().out.splitlines()) == 3


def test_results_that_name_another_schema_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    add_result(tmp_path, "good", result_data(60.0, 30.0))
    add_result(tmp_path, "later", result_data(60.0, 30.0, schema="dvc3d-rd-point/99"))
    assert [type(result) for result in rd_results.read_results(tmp_path)] == [PointResult]
    assert "later.json: not a result of schema" in caplog.text
