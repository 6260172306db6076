"""Pipes as sources: bytes as they come, and raw frames of them."""

import io
import os
import select
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from dvc.errors import VideoError
from dvc.files import Closing
from dvc.video.damage import HEAD_BYTES
from dvc.video.frames import Frame, TimeStamp, VideoInfo
from dvc.video.pixels import planar_frame, planar_frame_bytes
from dvc.video.sources import FrameStream, Request

STANDARD_INPUT = "-"


class Pipe(Closing):
    """A pipe that is read in order; a read waits until there is something, however long that takes."""

    def __init__(self, path: Path | str) -> None:
        self.name = "standard input" if str(path) == STANDARD_INPUT else str(path)
        self._num_bytes = 0
        self._head = b""
        try:
            self._file = (
                io.FileIO(0, closefd=False) if str(path) == STANDARD_INPUT else io.FileIO(os.fspath(path))
            )
        except OSError as err:
            raise VideoError(f"{self.name}: cannot be read ({err.strerror})") from err

    def num_bytes(self) -> int | None:
        """Return how many bytes have come."""
        return self._num_bytes

    def head(self) -> bytes:
        """Return the first bytes that came."""
        return self._head

    def read(self, count: int) -> bytes:
        """Read what there is, waiting for it if there is nothing."""
        while (data := self._file.read(count)) is None:  # another process made the pipe non-blocking
            select.select([self._file], [], [])
        self._num_bytes += len(data)
        if len(self._head) < HEAD_BYTES:
            self._head += data[: HEAD_BYTES - len(self._head)]
        return data

    def read_fully(self, count: int) -> bytearray:
        """Read so many bytes."""
        parts = []
        while count > 0 and (part := self.read(count)):
            parts.append(part)
            count -= len(part)
        return bytearray().join(parts)

    def close(self) -> None:
        """Let go of the pipe."""
        self._file.close()


class PipeFeed:
    """A pipe as FFmpeg reads it: its callbacks drop exceptions, which are kept here, and end the bytes."""

    def __init__(self, pipe: Pipe) -> None:
        self._pipe = pipe
        self._error: BaseException | None = None

    def read(self, count: int) -> bytes:
        """Read what there is; nothing after an exception."""
        try:
            return b"" if self._error else self._pipe.read(count)
        except BaseException as err:
            self._error = err
            return b""

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Raise what went wrong while the block read, in place of what FFmpeg made of it."""
        try:
            yield
        except VideoError:
            if self._error is None:
                raise
        if isinstance(self._error, OSError):
            raise VideoError(f"{self._pipe.name}: cannot be read ({self._error.strerror})") from self._error
        if self._error is not None:
            raise self._error


def is_pipe(path: Path) -> bool:
    """Tell whether a name is that of a pipe."""
    mode = path.stat().st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def open_raw_pipe(request: Request, pipe: Pipe) -> FrameStream:
    """Read planar 4:2:0 frames from a pipe; none is waited for before it is asked for."""
    assert request.size is not None
    assert request.frame_rate is not None
    info = VideoInfo(*request.size, request.frame_rate, request.num_frames, live=True)
    end = None if request.num_frames is None else request.start + request.num_frames
    frames = islice(_raw_frames(request, pipe, info), request.start, end)
    return FrameStream(info, frames, pipe.close)


def _raw_frames(request: Request, pipe: Pipe, info: VideoInfo) -> Iterator[Frame]:
    frame_bytes = planar_frame_bytes(info.width, info.height)
    count = 0
    while data := _read(pipe, frame_bytes, count):
        if len(data) < frame_bytes:
            raise VideoError(
                f"{pipe.name}: ends within frame {count}, after {len(data)} of its {frame_bytes} bytes"
                f" (frames before it: {count})"
            )
        frame = planar_frame(np.frombuffer(data, np.uint8), info.width, info.height)
        yield replace(frame, time=TimeStamp.nearest(count / info.frame_rate, info.frame_rate.numerator))
        count += 1
    if count <= request.start:
        raise request.too_short(total=count)


def _read(pipe: Pipe, frame_bytes: int, count: int) -> bytearray:
    try:
        return pipe.read_fully(frame_bytes)
    except OSError as err:
        raise VideoError(f"{pipe.name}: damaged after {count} frames ({err.strerror})") from err
