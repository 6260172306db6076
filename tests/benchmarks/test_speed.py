"""Speed of decoding: clips that are too short are played on, and a real run prints all figures."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import pytest

from benchmarks import speed
from dvc.video import Frame, create_video, open_video


@pytest.fixture
def clip(tmp_path: Path, moving_frames: Callable[..., list[Frame]]) -> Path:
    """Return a video of three small frames."""
    path = tmp_path / "clip.mkv"
    with create_video(path, (64, 48), Fraction(25)) as writer:
        for frame in moving_frames(3, 64, 48):
            writer.write(frame)
    return path


def test_short_clips_are_played_back_and_forth(clip: Path, tmp_path: Path) -> None:
    assert speed.source_of(str(clip), 3, tmp_path) == clip
    with open_video(clip) as reader, open_video(speed.source_of(str(clip), 6, tmp_path)) as long:
        short = [frame.luma.tobytes() for frame in reader]
        assert [short.index(frame.luma.tobytes()) for frame in long] == [0, 1, 2, 1, 0, 1]


@pytest.mark.slow
def test_a_run_over_a_link_tells_its_figures(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a file and live, the same frames."""
    words = [str(clip), "--frames", "3", "--delay", "0.01", "--bandwidth", "1e6", "--out", str(tmp_path)]
    assert speed.main(words) == 0
    said = capsys.readouterr().out
    assert said.count("the same") == 2
    assert "NOT" not in said
    assert "requests a frame" in said


def test_a_link_has_both(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        speed.main(["box", "--delay", "0.1"])
    assert "--bandwidth" in capsys.readouterr().err
