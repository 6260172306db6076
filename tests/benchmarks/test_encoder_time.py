"""What encoding takes beside x264."""

from pathlib import Path

import pytest

from benchmarks import encoder_time
from tests.clips import moving_texture, write_clip


def test_a_clip_is_compared_at_each_length(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A row for each, and their means."""
    clip = write_clip(tmp_path / "clip.mkv", moving_texture(3, 32, 48))
    assert encoder_time.main([str(clip), "--frames", "3", "5", "--repetitions", "1"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split(":")[0] for row in rows] == [
        "clip, 3 frames",
        "clip, 5 frames",
        "mean, 3 frames",
        "mean, 5 frames",
    ]
    assert all(" of x264-superfast, " in row for row in rows)
    assert rows[0].split(" ms a frame, ")[1] == rows[2].split("frames: ")[1]
