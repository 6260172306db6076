"""Memory of the decoder by the length of a clip: `python -m benchmarks.memory [CLIP] [--frames 50 500]`.

A clip, a name or a video file, is played forwards, backwards, and so on; the decoder runs as a process with
those that it starts. The table has the peak of resident memory of one of them, and of all together, with
shared pages counted for each; below, the ratio of the longest to the shortest clip.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from benchmarks.results.harness import run_module
from benchmarks.speed import MIB, source_of
from dvc.environment import child_environment, python_module
from dvc.errors import DvcError

PERIOD_S = 0.02
"""Interval of the samples."""


class Peak(NamedTuple):
    """The most memory in bytes."""

    process: int  # peak of one process
    tree: int  # peak of all processes together


def processes(pid: int) -> Iterator[int]:
    """Return a process and its running descendants.

    A process that has not loaded its program yet has the memory of its parent, and is not counted.
    """
    yield pid
    with suppress(OSError):
        own = Path(f"/proc/{pid}/cmdline").read_bytes()
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            for child in map(int, children.read_text().split()):
                with suppress(OSError):
                    if Path(f"/proc/{child}/cmdline").read_bytes() != own:
                        yield from processes(child)


def resident_bytes(pid: int) -> tuple[int, int]:
    """Return the resident memory of a process, and its peak; 0 if the process is gone."""
    lines: list[str] = []
    with suppress(OSError):
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    values = dict(line.split(":", 1) for line in lines)
    now, most = (1024 * int(values.get(name, "0").split()[0]) for name in ("VmRSS", "VmHWM"))
    return now, most


def watched(command: Sequence[str]) -> Peak:
    """Run a command to its end, and sample its memory."""
    peak = Peak(0, 0)
    with subprocess.Popen(command, env=child_environment(), stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:
            held = [resident_bytes(pid) for pid in processes(process.pid)]
            highest, total = max(most for _, most in held), sum(now for now, _ in held)
            peak = Peak(max(peak.process, highest), max(peak.tree, total))
            time.sleep(PERIOD_S)
    if process.returncode:
        raise DvcError(f"{' '.join(command)} ended with status {process.returncode}")
    return peak


def decoding(clip: str, num_frames: int, qp: int, jobs: int) -> Peak:
    """Measure the decoder on a number of frames of a clip."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        video = source_of(clip, num_frames, folder)
        run_module("encoder", video, folder / "coded.dvc", "--qp", qp, "--frames", num_frames, "--quiet")
        words = [folder / "coded.dvc", folder / "decoded.mkv", "--jobs", jobs, "--quiet"]
        return watched(python_module("decoder", *words))


def table(peaks: dict[int, Peak]) -> str:
    """Return a line for each length, and one for the ratio of the longest to the shortest."""
    shortest, longest = peaks[min(peaks)], peaks[max(peaks)]
    lines = [f"{'frames':>8} {'a process, MiB':>16} {'all, MiB':>10}"]
    lines += [f"{num:8d} {peak.process / MIB:16.0f} {peak.tree / MIB:10.0f}" for num, peak in peaks.items()]
    ratios = [most / least for most, least in zip(longest, shortest, strict=True)]
    return "\n".join([*lines, f"{'ratio':>8} {ratios[0]:16.3f} {ratios[1]:10.3f}"])


def main(words: Sequence[str] | None = None) -> int:
    """Measure all lengths, and print the table."""
    parser = argparse.ArgumentParser("python -m benchmarks.memory", description=__doc__)
    parser.add_argument("clip", nargs="?", metavar="CLIP", default="street")
    parser.add_argument("--frames", type=int, nargs="+", metavar="N", default=[50, 500])
    parser.add_argument("--qp", type=int, default=34)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(words)
    peaks = {num: decoding(options.clip, num, options.qp, options.jobs) for num in sorted(options.frames)}
    print(table(peaks))
    return 0


if __name__ == "__main__":
    sys.exit(main())
