"""Recordings as segments: names, and real processes that are killed, starved, stopped and out of room."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest

from dvc import cli
from dvc.errors import BitstreamError, ConfigError, VideoError
from dvc.stream import StreamReader
from dvc.video import Frame
from encoder.frame_queue import InputFrames
from encoder.segments import segment_names
from tests.clips import moving_texture, raw_bytes
from tests.waiting import wait_until

SIZE = (48, 32)
NUM_FRAMES, PER_SEGMENT = 23, 10
CODING = ("--codec", "2d", "--wz-q", "1", "--segment", PER_SEGMENT / 25, "--quiet")
RAW = ("--size", "48x32", "--frame-rate", "25")
PATIENCE_S = 120


@pytest.mark.parametrize(
    ("output", "name"),
    [
        ("day-%04d.dvc", "day-0012.dvc"),
        ("%d.dvc", "12.dvc"),
        ("a%03db.c.dvc", "a012b.c.dvc"),
        ("day.dvc", "day-0012.dvc"),
        ("day", "day-0012"),
        ("%d/day.dvc", "day-0012.dvc"),
    ],
)
def test_names_of_segments(output: str, name: str) -> None:
    assert segment_names(output).path(12) == Path(output).with_name(name)


@pytest.mark.parametrize("output", ["%d-%d.dvc", "%s.dvc", "%04x.dvc", "100%.dvc", "%4d.dvc"])
def test_names_without_one_number_are_refused(output: str) -> None:
    with pytest.raises(ConfigError, match="need one number"):
        segment_names(output)


def test_existing_segments_are_found(tmp_path: Path) -> None:
    for name in ("a-0003.dvc", "a-0010.dvc.part", "a-0003.dvc.part", "b-0020.dvc", "a-x.dvc", "a-0030.dvcx"):
        (tmp_path / name).touch()
    found = segment_names(str(tmp_path / "a.dvc")).existing()
    assert {number: path.name for number, path in found.items()} == {
        3: "a-0003.dvc.part",
        10: "a-0010.dvc.part",
    }


def test_frames_before_a_failure_are_given() -> None:
    """A source that fails ends the frames, and the failure is raised when it is asked for."""

    def source() -> Iterator[Frame]:
        yield Frame(np.zeros((2, 2), np.uint8))
        raise VideoError("gone")

    frames = InputFrames(source())
    assert len(list(frames)) == 1
    assert list(frames) == []
    with pytest.raises(VideoError, match="gone"):
        frames.raise_end()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_frames(number: signal.Signals) -> None:
    """A signal while a frame is worked on lets it be finished, one while a frame is awaited ends the wait."""
    for waiting in (False, True):

        def source(waiting: bool = waiting) -> Iterator[Frame]:
            for index in count():
                if waiting and index:
                    signal.raise_signal(number)
                yield Frame(np.zeros((2, 2), np.uint8))

        frames, given = InputFrames(source()), []
        with cli.stopping_at_signals(frames.stop):
            for frame in frames:
                given.append(frame)
                if not waiting:
                    signal.raise_signal(number)
        assert len(given) == 1
        with pytest.raises(KeyboardInterrupt):
            frames.raise_end()


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return moving_texture(NUM_FRAMES, SIZE[1], SIZE[0])


def start(folder: Path, *arguments: object, **options: object) -> "subprocess.Popen[bytes]":
    """Start an encoder that reads from a pipe."""
    command = [sys.executable, "-m", "encoder", "-", folder / "day-%04d.dvc", *CODING, *arguments]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return cast("subprocess.Popen[bytes]", subprocess.Popen([*map(str, command)], **pipes, **options))


def finish(process: "subprocess.Popen[bytes]", data: bytes = b"") -> tuple[int, list[str]]:
    """Let an encoder end, and return its status and what it says."""
    try:
        _, stderr = process.communicate(data, timeout=PATIENCE_S)
    finally:
        process.kill()
    return process.returncode, stderr.decode().splitlines()


def feed(process: "subprocess.Popen[bytes]", data: bytes) -> None:
    pipe = cast("BinaryIO", process.stdin)
    pipe.write(data)
    pipe.flush()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if ".y4m" not in path.name)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, frames: list[Frame]) -> Path:
    """Return the folder of a recording that nothing happened to."""
    folder = tmp_path_factory.mktemp("undisturbed")
    status, lines = finish(start(folder, *RAW, "--json", folder / "report.json"), raw_bytes(frames))
    assert (status, [line for line in lines if "behind" not in line]) == (0, [])
    return folder


def test_segments_hold_all_frames(undisturbed: Path) -> None:
    report = json.loads((undisturbed / "report.json").read_text())
    assert names(undisturbed) == ["day-0000.dvc", "day-0001.dvc", "day-0002.dvc", "report.json"]
    assert [(row["name"], row["frames"]) for row in report["segments"]] == [
        ("day-0000.dvc", 10),
        ("day-0001.dvc", 10),
        ("day-0002.dvc", 3),
    ]
    assert report["frames"] == NUM_FRAMES
    assert report["behind_s"] >= 0.0
    for row in report["segments"]:
        path = undisturbed / row["name"]
        assert path.stat().st_size == row["stream_bytes"]
        with StreamReader(path) as reader:
            assert reader.index.num_frames == row["frames"]


def num_finished(path: Path) -> int:
    """Return how many groups of pictures of a segment are finished."""
    try:
        with StreamReader(path, unfinished=True) as reader:
            return len(reader.index.entries)
    except BitstreamError:  # not even the first
        return 0


def processor_s(process: "subprocess.Popen[bytes]") -> float:
    """Return the processor time that a process has taken."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_encoder_waits_for_a_stalled_pipe_until_it_is_stopped(
    tmp_path: Path, frames: list[Frame], undisturbed: Path
) -> None:
    """It takes no processor time, what is finished can be read, and a signal finishes the segment."""
    process = start(tmp_path, *RAW)
    half_a_frame = len(raw_bytes(frames[:1])) // 2
    feed(process, raw_bytes(frames[:14])[:-half_a_frame])
    part = tmp_path / "day-0001.dvc.part"
    wait_until(lambda: part.exists() and num_finished(part) == 2, process.poll)
    before = processor_s(process)
    time.sleep(0.3)
    assert processor_s(process) - before < 0.1
    process.send_signal(signal.SIGINT)
    status, lines = finish(process)
    assert status == 130
    assert lines[-1] == "dvc-encode: interrupted"
    assert names(tmp_path) == ["day-0000.dvc", "day-0001.dvc"]
    with StreamReader(tmp_path / "day-0001.dvc") as reader:
        assert reader.index.num_frames == 3
        end = reader.index.entries[-1].offset + reader.index.entries[-1].size
    whole = (undisturbed / "day-0001.dvc").read_bytes()
    assert whole.startswith((tmp_path / "day-0001.dvc").read_bytes()[:end])


def test_recording_goes_on_after_what_is_there(tmp_path: Path, frames: list[Frame]) -> None:
    """A second run overwrites nothing and names what an earlier one left; a cut frame is refused by name."""
    (tmp_path / "day-0004.dvc").write_bytes(b"earlier")
    (tmp_path / "day-0006.dvc.part").write_bytes(b"left")
    process = start(tmp_path, *RAW)
    status, lines = finish(process, raw_bytes(frames[:13])[:-100])
    assert status == 3
    assert "day-0006.dvc.part remains from an earlier recording" in lines[0]
    assert lines[-1].startswith("dvc-encode: standard input: damaged after 12 frames (ends within frame 12")
    assert names(tmp_path) == ["day-0004.dvc", "day-0006.dvc.part", "day-0007.dvc", "day-0008.dvc"]
    assert (tmp_path / "day-0004.dvc").read_bytes() == b"earlier"
    with StreamReader(tmp_path / "day-0008.dvc") as reader:
        assert reader.index.num_frames == 2


def test_full_disk_loses_no_finished_group(tmp_path: Path, frames: list[Frame], undisturbed: Path) -> None:
    """A segment that does not fit is one line; the segments before it and its own finished groups stay."""
    process = start(tmp_path, *RAW)
    feed(process, raw_bytes(frames[:PER_SEGMENT]))
    wait_until((tmp_path / "day-0000.dvc").exists, process.poll)
    whole = (undisturbed / "day-0001.dvc").read_bytes()
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (len(whole) // 2, len(whole) // 2))
    status, lines = finish(process, raw_bytes(frames[PER_SEGMENT:]))
    part = tmp_path / "day-0001.dvc.part"
    assert status == 2
    assert lines[-1] == f"dvc-encode: cannot write {part}: File too large"
    assert names(tmp_path) == ["day-0000.dvc", part.name]
    assert part.read_bytes() == whole[: len(whole) // 2]
    assert num_finished(part) > 1
