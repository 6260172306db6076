"""Pipes, devices and addresses as sources: data in pieces, and early ends."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dvc.errors import VideoError
from dvc.video import Frame, create_video, open_video
from dvc.video.sources import SourceClock
from tests.clips import same_frames, write_clip

MakeFrames = Callable[..., list[Frame]]
RAW = {"size": (17, 12), "frame_rate": 25}


@pytest.fixture
def frames(moving_frames: MakeFrames) -> list[Frame]:
    return moving_frames(5, 17, 12)


@pytest.fixture
def raw(frames: list[Frame]) -> bytes:
    return b"".join(plane.tobytes() for frame in frames for plane in (frame.luma, *(frame.chroma or ())))


@pytest.fixture
def y4m(tmp_path: Path, frames: list[Frame]) -> bytes:
    return write_clip(tmp_path / "clip.y4m", frames).read_bytes()


@contextmanager
def fed(path: Path, parts: list[bytes]) -> Iterator[Path]:
    """Write into a named pipe from a thread."""
    os.mkfifo(path)

    def feed() -> None:
        with path.open("wb", buffering=0) as pipe, suppress(BrokenPipeError):
            for part in parts:
                pipe.write(part)

    thread = threading.Thread(target=feed)
    thread.start()
    try:
        yield path
    finally:
        thread.join()


def read(path: Path, parts: list[bytes], **options: Any) -> tuple[list[Frame], str]:
    """Return the frames of a pipe that is fed with parts, and the final error."""
    found: list[Frame] = []
    try:
        with fed(path, parts) as pipe, open_video(pipe, **options) as reader:
            assert reader.info.live
            for frame in reader:
                found.append(frame)
    except VideoError as err:
        return found, str(err)
    return found, ""


def in_pieces(data: bytes, size: int) -> list[bytes]:
    return [data[first : first + size] for first in range(0, len(data), size)]


@pytest.mark.parametrize("piece", [7, 300, 100_000])
def test_frames_come_whole_from_pieces(
    tmp_path: Path, frames: list[Frame], raw: bytes, y4m: bytes, piece: int
) -> None:
    """Raw and y4m frames are those of a file, however the bytes of the pipe are cut."""
    for name, data, options in (
        ("a", raw, RAW),
        ("b", y4m, {}),
        ("c", y4m, {"input_format": "y4m", "size": (17, 12)}),
    ):
        found, problem = read(tmp_path / name, in_pieces(data, piece), **options)
        assert problem == ""
        assert same_frames(found, frames)
        assert all(frame.luma.flags.writeable for frame in found)


def test_part_of_a_pipe_is_read(tmp_path: Path, frames: list[Frame], raw: bytes, y4m: bytes) -> None:
    for name, data, options in (("a", raw, RAW), ("b", y4m, {})):
        found, problem = read(tmp_path / name, [data], start=1, num_frames=2, **options)
        assert problem == ""
        assert same_frames(found, frames[1:3])


@pytest.mark.parametrize("missing", [1, 100])
def test_pipe_that_ends_within_a_frame_is_damaged(
    tmp_path: Path, frames: list[Frame], raw: bytes, y4m: bytes, missing: int
) -> None:
    for name, data, options, words in (
        ("a", raw, RAW, "ends within frame 4"),
        ("b", y4m, {}, "damaged after 4 frames"),
    ):
        found, problem = read(tmp_path / name, [data[:-missing]], **options)
        assert same_frames(found, frames[:4])
        assert words in problem
        assert str(tmp_path / name) in problem


def test_pipes_without_frames_are_refused(tmp_path: Path, raw: bytes) -> None:
    for name, data, options in (
        ("a", b"", RAW),
        ("b", b"", {}),
        ("c", b"text, not a video\n" * 9, {}),
        ("d", raw, {**RAW, "start": 5}),
        ("e", raw, {"size": (17, 12)}),
        ("f", raw, {"input_format": "raw", "frame_rate": 25}),
        ("g", raw, {"input_format": "y4m"}),
    ):
        found, problem = read(tmp_path / name, [data], **options)
        assert found == []
        assert problem.startswith(str(tmp_path / name))


def test_size_change_in_a_pipe_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = [
        cv2.imencode(".jpg", rng.integers(0, 256, (side, side), np.uint8))[1].tobytes()
        for side in (32, 32, 32, 16, 16)
    ]
    found, problem = read(tmp_path / "a", [b"".join(pictures)], input_format="mjpeg")
    assert len(found) == 3
    assert "the picture size changes from 32x32 to 16x16" in problem


def test_devices_are_opened_by_the_name_of_their_kind() -> None:
    with open_video("testsrc", input_format="lavfi", num_frames=2, frame_rate=25) as reader:
        assert reader.info.live
        assert len(list(reader)) == 2
    with pytest.raises(VideoError, match="FFmpeg reads no format"):
        open_video("testsrc", input_format="no such thing")
    with pytest.raises(VideoError, match=r"/dev/video999"):
        open_video("/dev/video999")


def test_clock_of_a_source_tells_of_lost_frames() -> None:
    """Time stamps that run ahead of the frames are noticed; frames without any and jitter are not."""
    clock, rate = SourceClock(), Fraction(4)
    clock.tick(None, rate)
    assert clock.lead_s is None
    for time_s in (7.25, 7.5, 7.75):
        clock.tick(time_s, rate)
    assert clock.lead_s == 0.0
    for time_s in (9.0, None, 9.5, 9.25):
        clock.tick(time_s, rate)
    assert clock.lead_s == 1.0


def test_time_stamps_of_a_pipe_are_compared_with_its_frames(
    tmp_path: Path, moving_frames: MakeFrames
) -> None:
    with create_video(tmp_path / "gap.mkv", (16, 16), 25) as writer:
        for time, frame in zip((0, 1, 52, 53), moving_frames(4, 16, 16), strict=True):
            writer.write(frame, Fraction(time, 25))
    data = (tmp_path / "gap.mkv").read_bytes()
    with (
        fed(tmp_path / "pipe", [data]) as pipe,
        open_video(pipe, input_format="matroska", frame_rate=25) as reader,
    ):
        assert len(list(reader)) == 4
        assert reader.clock.lead_s == pytest.approx(2.0)


@pytest.fixture
def address(tmp_path: Path, y4m: bytes) -> Iterator[str]:
    assert y4m
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    handler.func.log_message = lambda *_: None
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def test_addresses_are_opened(tmp_path: Path, address: str, frames: list[Frame]) -> None:
    with open_video(f"{address}/clip.y4m", timeout_s=30) as reader:
        assert reader.info.live
        assert same_frames(reader, frames)
    (tmp_path / "list.m3u8").write_text(
        f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile://{tmp_path}/clip.y4m\n#EXT-X-ENDLIST\n"
    )
    for name in ("absent.y4m", "list.m3u8"):
        with pytest.raises(VideoError, match=name):
            open_video(f"{address}/{name}", timeout_s=30)
