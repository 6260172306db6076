"""Sweeps: real processes on a tiny clip; resuming, failing, stopping."""

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dvc.errors import DvcError
from dvc.files import lock
from dvc.metrics import psnr_db
from dvc.rd import originals
from dvc.rd.__main__ import main
from dvc.rd.child_processes import ProcessGroup, Stopped
from dvc.rd.originals import CodeVersion, find_source
from dvc.rd.rd_results import POINTS_FOLDER, read_results
from dvc.rd.run_points import PICTURES_FOLDER, run_points
from dvc.rd.specification import Point, Task
from dvc.video import Frame, create_video, open_video
from tests.rd.made_up import result_data

NUM_FRAMES = 3
POINTS = ("--codec", "2d", "--wz-q", "1", "--anchor", "intra", "--anchor-qp", "40")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write three frames of a texture that moves by a pixel per frame; the last one comes late."""
    path = tmp_path_factory.mktemp("clip") / "clip.mkv"
    rng = np.random.default_rng(3)
    texture = np.kron(rng.integers(60, 190, (16, 18)), np.ones((4, 4))).astype(np.uint8)
    with create_video(path, (64, 48), 25) as writer:
        for index in range(NUM_FRAMES):
            writer.write(Frame(texture[index : index + 48, index : index + 64]), Fraction(index**2, 25))
    return path


@pytest.fixture(scope="module")
def folder(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rd")
    arguments = [str(clip), *POINTS, "--out", str(out)]
    assert main(["run", *arguments]) == 0
    return out


def _contents(folder: Path) -> list[dict[str, Any]]:
    return [
        json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / POINTS_FOLDER).iterdir())
    ]


def test_points_are_measured_by_processes(folder: Path) -> None:
    """A result per point: the rate of the punctured file at the constant rate, a value for every frame."""
    codec, intra = _contents(folder)
    assert (codec["codec"], intra["codec"]) == ("2d", "h264-intra")
    assert codec["totals"]["frames"] == NUM_FRAMES == len(codec["per_frame"])
    num_bytes = codec["proof"]["punctured_bytes"]
    assert codec["totals"]["rate_kbps"] == pytest.approx(8 * num_bytes * 25 / NUM_FRAMES / 1000)
    assert sum(codec["totals"]["bits"].values()) == 8 * num_bytes
    assert codec["sequence"]["name"] == "clip"
    assert not codec["config"]["video"]["luma_only"]
    assert min(codec["totals"]["psnr_yuv_db"], intra["totals"]["psnr_yuv_db"]) > 20
    assert codec["totals"]["duration_s"] == intra["totals"]["duration_s"] < codec["per_frame"][-1]["time_s"]
    assert intra["key"]["qp"] == 40
    assert set(result_data(60.0, 30.0)) <= set(codec)  # made-up results have entries of real ones


def test_pictures_are_saved_with_the_points(folder: Path, clip: Path) -> None:
    """A frame before and after, its prediction and its key frame; the original once for both points."""
    codec, intra = (data["pictures"] for data in _contents(folder))
    assert codec["index"] == intra["index"] == 1
    assert codec["original"] == intra["original"]
    assert intra["predicted"] is intra["key"] is intra["key_index"] is None
    kinds = ("original", "predicted", "decoded", "key")
    names = {codec[name] for name in kinds} | {intra["decoded"]}
    assert {f"{PICTURES_FOLDER}/{path.name}" for path in (folder / PICTURES_FOLDER).iterdir()} == names
    planes = {}
    for name in kinds:
        with open_video(folder / codec[name]) as reader:
            (frame,) = reader
        assert (frame.width, frame.height, frame.chroma) == (64, 48, None)
        planes[name] = frame.luma
    report = _contents(folder)[0]["per_frame"][1]
    assert psnr_db(planes["original"], planes["decoded"]) == pytest.approx(report["psnr_y_db"])
    assert psnr_db(planes["original"], planes["predicted"]) == pytest.approx(report["si_psnr_y_db"])
    with open_video(clip) as reader:
        first = next(iter(reader)).luma
    report = _contents(folder)[0]["per_frame"][0]
    assert codec["key_index"] == 0
    assert psnr_db(first, planes["key"]) == pytest.approx(report["psnr_y_db"])


def test_streams_without_feedback_are_measured_as_they_are(clip: Path, tmp_path: Path) -> None:
    arguments = [str(clip), "--qp", "36", "--no-feedback", "--out", str(tmp_path)]
    assert main(["run", *arguments, "--quiet"]) == 0
    (point,) = _contents(tmp_path)
    assert [command.split()[2] for command in point["commands"]] == ["encoder", "decoder"]
    assert "--no-feedback" in point["commands"][0]
    assert "--punctured" not in point["commands"][1]
    num_bytes = point["proof"]["file_bytes"]
    assert sum(point["totals"]["bits"].values()) == 8 * num_bytes
    assert point["totals"]["rate_kbps"] == pytest.approx(8 * num_bytes * 25 / NUM_FRAMES / 1000)
    times = point["times"]
    assert 0 < times["key_encode_cpu_s"] + times["wz_encode_cpu_s"] < times["coding_cpu_s"]
    assert times["coding_cpu_s"] < times["encode_cpu_s"]


def test_results_name_no_machine_and_nothing_else_stays_behind(folder: Path, clip: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == [PICTURES_FOLDER, POINTS_FOLDER]
    for path in (folder / POINTS_FOLDER).iterdir():
        assert path.suffix == ".json"
        text = path.read_text(encoding="utf-8")
        assert str(clip.parent) not in text
        assert str(folder) not in text


def test_finished_points_are_skipped(folder: Path, clip: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = {path: path.stat().st_mtime_ns for path in (folder / POINTS_FOLDER).iterdir()}
    arguments = [str(clip), *POINTS, "--out", str(folder)]
    assert main(["run", *arguments]) == 0
    assert "0 measured, 2 already there, 0 failed" in capfd.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in (folder / POINTS_FOLDER).iterdir()} == before


def test_failing_point_does_not_stop_the_sweep(
    clip: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    spec = tmp_path / "sweep.toml"
    spec.write_text(
        f'[defaults]\ngop = 1\nkey_qp = "40"\n[[sweep]]\nsequences = ["nowhere.mkv", "{clip}"]\n'
        f'[[sweep]]\nsequences = ["{clip}"]\nstart = 99\n',
        encoding="utf-8",
    )
    assert main(["run", "--spec", str(spec), "--out", str(tmp_path / "out"), "--jobs", "2"]) == 2
    assert "3 points: 1 measured, 0 already there, 2 failed" in capfd.readouterr().err
    assert "'nowhere.mkv' is neither a file nor a sequence" in caplog.text
    assert "cannot start at frame 99" in caplog.text
    assert len(read_results(tmp_path / "out")) == 1


def test_dishonest_rate_is_a_failure(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dvc.rd.run_points.filecmp.cmp", lambda *_, **__: False)
    summary = run_points([Point(str(clip), "2d", None, "40", 1)], tmp_path, tmp_path)
    assert [reason for _, reason in summary.failures] == [
        "a fresh process decodes the punctured stream to other frames"
    ]
    assert list((tmp_path / POINTS_FOLDER).iterdir()) == []


def test_failed_process_is_named_by_its_last_line() -> None:
    processes = ProcessGroup()
    with pytest.raises(DvcError, match=r"^the reason$"):
        processes.run([sys.executable, "-c", "import sys; sys.exit('first\\nthe reason')"])
    with pytest.raises(DvcError, match="ended with status 7"):
        processes.run([sys.executable, "-c", "raise SystemExit(7)"])
    with pytest.raises(DvcError, match=r"^the process was ended by SIGKILL$"):
        processes.run([sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"])
    times = processes.run([sys.executable, "-c", "sum(range(10**6))"])
    assert 0 < times.cpu_s <= times.wall_s + 0.1


def test_interrupted_process_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = []

    def _interrupted(number: int, _: int) -> None:
        numbers.append(number)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "wait4", _interrupted)
    processes = ProcessGroup()
    with pytest.raises(KeyboardInterrupt):
        processes.run([sys.executable, "-c", "import time; time.sleep(600)"])
    with pytest.raises(ProcessLookupError):
        os.kill(numbers[0], 0)
    assert not processes._running


def test_a_scene_is_rendered_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(originals, "catalogue", lambda *_: {"name": "box", "path": None})
    rendered: list[str] = []

    def _render(_: ProcessGroup, command: list[str]) -> None:
        rendered.append(command[-1])
        time.sleep(0.5)
        Path(command[-1]).write_bytes(b"video")

    monkeypatch.setattr(ProcessGroup, "run", _render)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda _: find_source("box", tmp_path, ProcessGroup()), range(3)))
    assert len(rendered) == 1
    assert len(set(found)) == 1
    assert [path.name for path in tmp_path.iterdir()] == [found[0].path.name]
    found[0].path.unlink()
    stopped = ProcessGroup()
    stopped.stop()
    with open(tmp_path / f".{found[0].path.name}.lock", "w") as file:
        lock(file.fileno())
        with pytest.raises(Stopped):
            find_source("box", tmp_path, stopped)


def test_names_of_results_are_safe(clip: Path) -> None:
    strange = clip.with_name("a clip: käse?.mkv")
    os.link(clip, strange)
    source = find_source(str(strange), clip.parent, ProcessGroup())
    name = Task(Point(str(strange), "2d", 1, "auto", 2), source, CodeVersion("1", "0")).name
    assert name.isascii()
    assert not set(name) & set(' /:?*"<>|\\')


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "--out", "x"], "give at least one SEQUENCE"),
        (["run", "clip", "--out", "x", "--wz-q", "9"], "expected numbers from 1 to 8"),
        (["run", "clip", "--out", "x", "--option", "json=3"], "cannot be given as an option"),
        (["run", "--spec", "nowhere.toml", "--out", "x"], "nowhere.toml: No such file"),
        (["run", "clip", "--out", "/dev/null/x", "--wz-q", "1"], "cannot write to /dev/null/x"),
        (["report", "nowhere"], "no results"),
        (["report", "nowhere", "--out", "x.pdf"], "must be a file name that ends with .html or .md"),
        (["compare", "nowhere", "nowhere"], "no results"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], message: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err


def test_help_is_quick_to_load() -> None:
    code = "import sys; sys.argv=['dvc-rd']; import dvc.rd.__main__; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
