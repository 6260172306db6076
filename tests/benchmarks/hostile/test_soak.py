"""The soak of live runs: it loses the link, and tells what both ends hold and lose."""

import re
from pathlib import Path

import pytest

from benchmarks.hostile import soak
from tests.clips import moving_texture, write_clip


@pytest.mark.slow
def test_a_run_that_is_away_half_of_the_time_loses_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All frames are decoded, and memory and disk are told."""
    clip = write_clip(tmp_path / "clip.y4m", moving_texture(6, 48, 64))
    words = ["--clip", clip, "--frames", 60, "--rate", 20, "--cut-every", 1, "--away", "--codec", "2d"]
    assert soak.main([*map(str, words), "--out", str(tmp_path)]) == 0
    frames, connections, memory, spool = capsys.readouterr().out.splitlines()
    assert frames == "frames: 60 played, 60 decoded, 0 left out in 0 gap(s), [] lost"
    assert re.match(r"connections: \d+ lost, \d", connections)
    assert re.search(r"encoder: at most \d+ MiB .*; decoder \d+, \d+", memory)
    assert spool.startswith("spool: at most ")
    assert not (tmp_path / "spool").exists()
