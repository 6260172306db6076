"""Memory of decoders and of their child processes."""

import os
import sys
from fractions import Fraction
from pathlib import Path

import pytest

from benchmarks import memory
from benchmarks.memory import Peak, processes, resident_bytes, table, watched
from benchmarks.speed import MIB
from dvc.errors import DvcError
from dvc.video import create_video
from tests.clips import moving_texture

HOLD = "x = bytearray({mib} << 20); x[::4096] = b'x' * len(x[::4096]); import time; time.sleep(1)"
START = "import subprocess, sys; subprocess.run([sys.executable, '-c', {code!r}], check=True)"


def test_memory_of_what_a_command_starts_counts() -> None:
    peak = watched([sys.executable, "-c", START.format(code=HOLD.format(mib=200))])
    assert 200 * MIB < peak.process < 260 * MIB
    assert peak.process < peak.tree < 2 * peak.process


def test_a_command_that_fails_is_no_measurement() -> None:
    with pytest.raises(DvcError, match="ended with status 3"):
        watched([sys.executable, "-c", "raise SystemExit(3)"])


def test_a_process_that_is_gone_has_no_memory() -> None:
    assert resident_bytes(2**22 + 1) == (0, 0)
    assert os.getpid() in list(processes(os.getpid()))
    now, most = resident_bytes(os.getpid())
    assert 0 < now <= most


def test_the_ratio_is_that_of_the_longest_to_the_shortest() -> None:
    lines = table({5: Peak(100 * MIB, 200 * MIB), 50: Peak(110 * MIB, 300 * MIB)}).splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["5", "100", "200"],
        ["50", "110", "300"],
        ["ratio", "1.100", "1.500"],
    ]


def test_two_lengths_of_a_clip_are_decoded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with create_video(tmp_path / "clip.mkv", (48, 32), Fraction(25)) as writer:
        for frame in moving_texture(3, 32, 48):
            writer.write(frame)
    assert memory.main([str(tmp_path / "clip.mkv"), "--frames", "7", "3"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [row[0] for row in rows] == ["3", "7", "ratio"]
    assert all(0 < int(process) <= int(everything) for _, process, everything in rows[:2])
