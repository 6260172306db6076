"""Long live runs: the link is lost, and memory and lost frames are printed."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.hostile import soak
from tests.clips import moving_texture, write_clip


@pytest.mark.slow
def test_a_run_that_is_away_half_of_the_time_counts_what_it_loses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = write_clip(tmp_path / "clip.y4m", moving_texture(6, 48, 64))
    words = ["--clip", clip, "--frames", 60, "--rate", 20, "--cut-every", 1, "--away", "--codec", "2d"]
    assert soak.main([*map(str, words), "--out", str(tmp_path)]) == 0
    frames, connections, memory = capsys.readouterr().out.splitlines()
    counts = re.fullmatch(r"frames: 60 played, (\d+) decoded, (\d+) left out in \d+ gap\(s\)", frames)
    assert counts is not None
    assert int(counts[1]) + int(counts[2]) == 60
    assert re.match(r"connections: \d+ lost, \d", connections)
    assert re.search(r"encoder: at most \d+ MiB .*; decoder \d+, \d+", memory)


def test_memory_of_child_processes_counts() -> None:
    hold = "x = bytearray(200 << 20); x[::4096] = b'x' * len(x[::4096]); print(flush=True); input()"
    start = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {hold!r}])"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", start], **pipes) as process:
        assert process.stdout.readline() == b"\n"
        assert 200 < soak.resident_mib(process.pid) < 260
        process.communicate(b"\n")
    assert soak.resident_mib(2**22 + 1) == 0
