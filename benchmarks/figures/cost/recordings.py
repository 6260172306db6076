"""Long recordings without feedback: memory, time to the first group on the disk, and kills at any moment."""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures.cost.rate_cost import AREA
from benchmarks.figures.harness import Figure, Measured, Setting, clip_source, run_module, there_and_back
from dvc.errors import BitstreamError, DvcError
from dvc.stream import StreamReader
from dvc.video import Frame, open_video

CLIP = "box"
FEW_FRAMES, MANY_FRAMES = 50, 5000
MOST_GROWTH = 1.10
NUM_STARTS, MOST_START_S = 9, 1.0
NUM_KILLS, KILLED_FRAMES, KILLED_SIZE = 20, 100, (96, 80)


def _frames(num_frames: int) -> list[Frame]:
    with open_video(clip_source(CLIP).path, num_frames=num_frames) as reader:
        return list(reader)


def _bytes_of(frame: Frame) -> bytes:
    return b"".join(plane.tobytes() for plane in (frame.luma, *(frame.chroma or ())))


def _start(folder: Path, size: tuple[int, int]) -> "subprocess.Popen[bytes]":
    """Start an encoder that reads raw frames from a pipe."""
    options = ["--size", f"{size[0]}x{size[1]}", "--frame-rate", "30", "--no-feedback", "--quiet"]
    command = [sys.executable, "-m", "encoder", "-", str(folder / "recording.dvc"), *options]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)


def _feed(process: "subprocess.Popen[bytes]", frames: Iterator[Frame]) -> None:
    assert process.stdin is not None
    for frame in frames:
        process.stdin.write(_bytes_of(frame))
    process.stdin.flush()


def _peak_bytes(process: "subprocess.Popen[bytes]") -> int:
    lines = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def _peak_of(frames: list[Frame], count: int) -> int:
    """Encode so many frames; return the most memory that the process had."""
    with tempfile.TemporaryDirectory() as folder, _start(Path(folder), frames[0].luma.shape[::-1]) as process:
        _feed(process, there_and_back(frames, count))
        peak = _peak_bytes(process)
        _, said = process.communicate()
        if process.returncode != 0:
            raise DvcError(f"the encoder ended with status {process.returncode}: {said.decode()[-300:]}")
        return peak


def memory(setting: Setting, _clip: str) -> Measured:
    """Feed frames of a clip, forward and backward again and again, through a pipe to the encoder."""
    frames = _frames(FEW_FRAMES)
    few, many = (_peak_of(frames, setting.choose(count, 20)) for count in (FEW_FRAMES, MANY_FRAMES))
    values = {"peak_bytes": {"few": few, "many": many}, "num_frames": [FEW_FRAMES, MANY_FRAMES]}
    text = f"{many / few:.3f} ({many / 2**20:.0f} over {few / 2**20:.0f} MiB)"
    return Measured(text, many / few <= MOST_GROWTH, values)


def _num_finished(folder: Path) -> tuple[int, bool]:
    """Count the frames in finished groups of what is left of a recording; tell whether the rest is named."""
    for path in folder.glob("recording.dvc*"):
        try:
            with StreamReader(path, unfinished=True) as reader:
                return sum(record.num_frames for record in reader), reader.missing is not None
        except BitstreamError:
            return 0, True
    return 0, True


def _cpu_s(process: "subprocess.Popen[bytes]") -> float:
    fields = Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _first_group_s(frames: list[Frame]) -> tuple[float, float]:
    """Start an encoder, feed it, and return the time until a group is on the disk, and the processor time."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        with _start(Path(folder), frames[0].luma.shape[::-1]) as process:
            _feed(process, iter(frames[:1]))
            while _num_finished(Path(folder))[0] == 0:
                time.sleep(0.001)
            taken_s, cpu_s = time.perf_counter() - started, _cpu_s(process)
            process.communicate()
    return taken_s, cpu_s


def first_group(setting: Setting, _clip: str) -> Measured:
    """Start the encoder with compiled code on disk, and wait for the first group in the file."""
    frames = _frames(2)
    _first_group_s(frames)
    times = sorted(_first_group_s(frames) for _ in range(setting.choose(NUM_STARTS, 1)))
    taken_s, cpu_s = times[0]
    text = f"{taken_s:.2f} s ({cpu_s:.2f} s of processor time)"
    return Measured(text, taken_s <= MOST_START_S, {"seconds_and_cpu_s": times})


def _cropped(frame: Frame, size: tuple[int, int]) -> Frame:
    width, height = size
    left, top = (
        (whole - part) // 4 * 2 for whole, part in zip((frame.width, frame.height), size, strict=True)
    )
    planes = [frame.luma[top : top + height, left : left + width]]
    for plane in frame.chroma or ():
        planes.append(plane[top // 2 : (top + height) // 2, left // 2 : (left + width) // 2])
    luma, *chroma = planes
    return Frame(luma, (chroma[0], chroma[1]) if chroma else None)


def _killed(folder: Path, frames: list[Frame], fed: int, later_s: float) -> bool:
    """Kill an encoder some time after it was fed frames; tell whether what it leaves is as it must be."""
    with _start(folder, KILLED_SIZE) as process:
        _feed(process, iter(frames[:fed]))
        time.sleep(later_s)
        os.kill(process.pid, signal.SIGKILL)
    finished, named = _num_finished(folder)
    if not finished:
        return True
    (left,) = folder.glob("recording.dvc*")
    run_module("decoder", [left, folder / "v.y4m", "--unfinished", "--quiet"])
    with open_video(folder / "v.y4m") as reader:
        return named and sum(1 for _ in reader) == finished


def kills(setting: Setting, _clip: str) -> Measured:
    """Kill an encoder at random moments while it records, and decode what is left each time."""
    frames = [_cropped(frame, KILLED_SIZE) for frame in _frames(KILLED_FRAMES)]
    draw = random.Random(0)
    good, count = 0, setting.choose(NUM_KILLS, 2)
    for _ in range(count):
        with tempfile.TemporaryDirectory() as folder:
            fed, later_s = draw.randrange(1, len(frames)), draw.uniform(0.0, 2.0)
            good += _killed(Path(folder), frames, fed, later_s)
    return Measured(f"{good} of {count}", good == count, {"num_kills": count, "num_good": good})


FIGURES = (
    Figure(
        AREA,
        "recording-memory",
        f"memory of the encoder process, {MANY_FRAMES:,} CIF frames over {FEW_FRAMES}, --no-feedback",
        "equal within 10 %",
        memory,
    ),
    Figure(
        AREA,
        "first-group",
        "from the start of dvc-encode to the first group on the disk, compiled code at hand",
        "≤ 1 s",
        first_group,
    ),
    Figure(
        AREA,
        "kills",
        f"kill -9 of dvc-encode at {NUM_KILLS} random moments",
        "every finished group decodes, the rest is named",
        kills,
        programs=("decoder",),
    ),
)
"""The figures of this module."""
