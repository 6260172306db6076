"""Losses of live runs: frames are the same, and the command prints it."""

from pathlib import Path

import pytest

from benchmarks.hostile import lost_links
from tests.clips import moving_texture, write_clip


@pytest.mark.slow
def test_runs_with_losses_give_the_same_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = write_clip(tmp_path / "clip.y4m", moving_texture(12, 48, 64))
    words = ["--clip", clip, "--frames", 12, "--cut-every", 4, "--codec", "2d", "--faults", 20000]
    assert lost_links.main([*map(str, words), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("uncut: ")
    assert said[1].startswith("same frames and bits; ")


def test_ends_that_do_not_end_well_are_told() -> None:
    process = lost_links.start("encoder", "nothing.mkv", "out.dvc")
    with pytest.raises(SystemExit, match=r"status 2, not 0: .*nothing.mkv"):
        lost_links.check_end(process, 0)
