"""Frames of a video by their numbers, one in memory at a time."""

from collections.abc import Iterator
from pathlib import Path

from dvc.errors import VideoError
from dvc.files import Closing
from dvc.video.frames import Frame, VideoReader
from dvc.video.readers import open_video


class FrameLookup(Closing):
    """Finds frames of a file or a folder; in rising order each is decoded once."""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._reader: VideoReader | None = None
        self._frames: Iterator[Frame] = iter(())
        self._next = 0
        self._last: tuple[int, Frame] | None = None

    def __call__(self, number: int) -> Frame:
        """Return a frame by its number from 0."""
        if self._last is not None and self._last[0] == number:
            return self._last[1]
        if self._reader is None or number < self._next:
            self.close()
            self._reader = open_video(self._path, start=number)
            self._frames, self._next = iter(self._reader), number
        for frame in self._frames:
            self._next += 1
            if self._next > number:
                self._last = number, frame
                return frame
        raise VideoError(f"{self._path} has no frame {number}")

    def close(self) -> None:
        """Close the video."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
