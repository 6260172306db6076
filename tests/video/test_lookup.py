"""Frames by their numbers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dvc.errors import VideoError
from dvc.video import Frame, create_video
from dvc.video.lookup import FrameLookup


@pytest.fixture
def clip(tmp_path: Path, moving_frames: Callable[..., list[Frame]]) -> tuple[Path, list[Frame]]:
    """Write a clip, and return its frames as well."""
    frames = moving_frames(6, 32, 24)
    with create_video(tmp_path / "clip.mkv", (32, 24), 25) as writer:
        for frame in frames:
            writer.write(frame)
    return tmp_path / "clip.mkv", frames


def test_frames_are_found_in_any_order(clip: tuple[Path, list[Frame]]) -> None:
    """Forward, again, and backward."""
    path, frames = clip
    with FrameLookup(path) as frame:
        for number in (0, 1, 1, 4, 5, 2, 0, 5):
            np.testing.assert_array_equal(frame(number).luma, frames[number].luma)


def test_rising_numbers_open_the_video_once(
    clip: tuple[Path, list[Frame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each frame is decoded once; only to go back it is opened again."""
    from dvc.video import lookup

    opened = []
    open_video = lookup.open_video
    monkeypatch.setattr(
        lookup, "open_video", lambda path, start: opened.append(start) or open_video(path, start=start)
    )
    with FrameLookup(clip[0]) as frame:
        for number in (1, 2, 2, 5):
            frame(number)
        assert opened == [1]
        frame(3)
    assert opened == [1, 3]


def test_frames_that_are_not_there(clip: tuple[Path, list[Frame]]) -> None:
    """They are an error that names the video."""
    with FrameLookup(clip[0]) as frame, pytest.raises(VideoError, match=r"clip\.mkv"):
        frame(6)
    with FrameLookup(clip[0]) as frame:
        frame(5)
        with pytest.raises(VideoError, match="has no frame 9"):
            frame(9)
