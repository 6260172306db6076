"""The catalogue and its command: names, files, user material, errors in one line."""

import json
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dvc.errors import ConfigError
from dvc.video import Frame, create_video, open_video
from sequences import catalogue
from sequences.__main__ import main
from sequences.scenery import Description


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a data folder: a described file, user material, the name of a scene, damage, a text."""
    folder = tmp_path / "data"
    folder.mkdir()
    frame = Frame(np.full((18, 22), 90, dtype=np.uint8))
    for name in ("box.mkv", "holiday.y4m", "street.mkv"):
        with create_video(folder / name, (22, 18), Fraction(25)) as writer:
            for _ in range(3):
                writer.write(frame)
    (folder / "broken.mkv").write_bytes(b"not a video")
    (folder / "notes.txt").write_text("x")
    monkeypatch.setenv("DVC_DATA", str(folder))
    return folder


def test_entries_are_scenes_then_files(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file with the name of a scene keeps its suffix, user material is probed, damage is reported."""
    by_name = {entry.name: entry for entry in catalogue.entries()}
    assert list(by_name) == [
        "street",
        "stairway",
        "statue",
        "rounds",
        "box",
        "broken",
        "holiday",
        "street.mkv",
    ]
    assert by_name["box"].about.static == "yes"
    assert (by_name["box"].width, by_name["box"].height, by_name["box"].num_frames) == (22, 18, 3)
    assert by_name["holiday"].about.purpose == "user material"
    assert by_name["holiday"].frame_rate == 25
    assert by_name["broken"].about.shows == "unreadable"
    monkeypatch.setenv("DVC_DATA", str(data / "nowhere"))
    with pytest.raises(ConfigError, match="DVC_DATA"):
        catalogue.entries()


def test_resolve_finds_scenes_names_and_paths(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scene's name wins; a file that exists is itself, or else a stem or file name of the data folder."""
    assert isinstance(catalogue.resolve("street"), Description)
    assert catalogue.resolve("box") == catalogue.resolve("box.mkv") == data / "box.mkv"
    assert catalogue.resolve("street.mkv") == data / "street.mkv"
    assert catalogue.resolve(data / "box.mkv") == data / "box.mkv"
    assert catalogue.resolve(str(tmp_path)) == tmp_path
    (tmp_path / "box.mkv").write_bytes((data / "holiday.y4m").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert catalogue.resolve("box.mkv") == Path("box.mkv")
    assert catalogue.resolve("box") == data / "box.mkv"
    with pytest.raises(ConfigError, match=r"'beach'.*street, .*holiday"):
        catalogue.resolve("beach")


def test_descriptions_fit_the_real_files(shared_sequences: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DVC_DATA", str(shared_sequences))
    entries = [entry for entry in catalogue.entries() if entry.name in catalogue.DESCRIBED]
    assert {entry.name for entry in entries} == set(catalogue.DESCRIBED)
    assert all(entry.num_frames and entry.width in (176, 352) for entry in entries)


def test_list_and_info_write_text_and_json(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    table = capsys.readouterr().out
    assert all(name in table for name in ("street", "stairway", "statue", "box", "holiday"))
    assert main(["list", "--json"]) == 0
    entries = json.loads(capsys.readouterr().out)
    assert entries[0]["name"] == "street"
    assert entries[0]["fps"] == 30.0
    assert {"purpose", "motion", "static", "num_frames", "path"} <= set(entries[0])
    assert main(["info", "statue"]) == 0
    text = capsys.readouterr().out
    assert "352x288" in text
    assert "occlusion" in text
    assert main(["info", str(data / "holiday.y4m"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["width"] == 22


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["info", "beach"], "beach"),
        (["info", "broken"], "broken"),
        (["render", "beach", "--out", "x.mkv"], "street"),
        (["render", "statue", "--out", "x.gif"], ".mkv"),
        (["render", "statue", "--out", "no/such/folder/x.mkv"], "folder"),
        (["render", "statue", "--out", "x.mkv", "--noise", "nan"], "noise"),
        (["render", "statue", "--out", "x.mkv", "--noise", "-1"], "noise"),
        (["render", "statue", "--out", "x.mkv", "--size", "99999x2"], "99999x2"),
    ],
)
def test_wrong_input_is_one_line_and_status_two(
    data: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(data.parent)
    assert main(arguments) == 2
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err.count("\n") == 1
    assert message in streams.err
    assert [path.name for path in data.parent.iterdir()] == ["data"]


@pytest.mark.parametrize(
    "arguments",
    [
        "",
        "dance",
        *(f"render statue{rest}" for rest in ("", " --size 12", " --size 0x8", " --frames 0", " --jobs -2")),
    ],
)
def test_wrong_usage_is_one_line_and_status_two(arguments: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*arguments.split(), *(["--out", "x.mkv"] if "--" in arguments else [])])
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_render_writes_a_video(tmp_path: Path) -> None:
    out = tmp_path / "s.y4m"
    arguments = ["render", "stairway", "--out", str(out), "--size", "24x17", "--frames", "2", "--start", "4"]
    files = ["--depth", str(tmp_path / "d"), "--cameras", str(tmp_path / "c.json")]
    assert main([*arguments, *files, "--noise", "1.5", "--jobs", "2"]) == 0
    with open_video(out) as reader:
        assert reader.info.size == (24, 17)
        assert len(list(reader)) == 2
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == ["0004.pfm", "0005.pfm"]


def test_help_loads_little_and_shows_examples() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sequences", "--help"], capture_output=True, text=True, check=True
    )
    assert "examples:" in done.stdout
    heavy = "numba", "av", "cv2", "numpy"
    probe = f"import sys, sequences.__main__; sys.exit(any(name in sys.modules for name in {heavy}))"
    assert subprocess.run([sys.executable, "-c", probe], check=False).returncode == 0
