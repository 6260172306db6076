"""Recording from a network and from cameras: what is served on loopback, breaks off, or is absent."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from fractions import Fraction
from pathlib import Path

import av
import pytest

import decoder.__main__
from dvc.errors import VideoError
from dvc.stream import StreamReader
from dvc.video import open_video
from tests.clips import same_frame
from tests.serving import (
    FRAME_RATE,
    SIZE,
    broken_server,
    frames_shown,
    free_port,
    http_server,
    rtsp_server,
    send,
    sending,
    video,
    wait_for_listener,
)

PATIENCE_S = 120
CODING = ("--codec", "2d", "--key-qp", "lossless", "--gop", "1", "--quiet")
CONSTANT_MS = [40 * number for number in range(30)]
JITTER_MS = [40 * number + (number * 7919 % 23 if number % 3 else 0) for number in range(30)]
Server = Callable[[Sequence[int]], AbstractContextManager[str]]
HEAD = b"HTTP/1.1 200 OK\r\nConnection: close\r\n"


def start(folder: Path, source: str, *arguments: object) -> "subprocess.Popen[str]":
    """Begin to record a source as out.dvc."""
    command = [sys.executable, "-m", "encoder", source, "out.dvc", *CODING, *map(str, arguments)]
    root = Path(__file__).parents[2]
    return subprocess.Popen(
        command, cwd=folder, env={"PYTHONPATH": str(root)}, text=True, stderr=subprocess.PIPE
    )


def finish(process: "subprocess.Popen[str]") -> tuple[int, list[str]]:
    try:
        _, stderr = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    return process.returncode, stderr.splitlines()


def decoded_times_ms(folder: Path) -> list[Fraction]:
    assert decoder.__main__.main([str(folder / "out.dvc"), str(folder / "out.mkv"), "--quiet"]) == 0
    return [1000 * time_s for _, time_s in frames_shown(folder / "out.mkv")]


@pytest.mark.parametrize("server", [http_server, rtsp_server])
@pytest.mark.parametrize("times_ms", [CONSTANT_MS, JITTER_MS], ids=["constant", "jitter"])
def test_a_server_is_recorded(tmp_path: Path, times_ms: list[int], server: Server) -> None:
    """All frames that are served come, at their times; RTP does not date the first one."""
    with server(times_ms) as address:
        assert finish(start(tmp_path, address, "--timeout", PATIENCE_S)) == (0, [])
    found = decoded_times_ms(tmp_path)
    check_rtp_times(found, times_ms)
    if server is http_server:
        assert found == times_ms
        with StreamReader(tmp_path / "out.dvc") as reader:
            assert any(record.deviations for record in reader) == (times_ms is JITTER_MS)


@pytest.mark.parametrize("times_ms", [CONSTANT_MS, JITTER_MS], ids=["constant", "jitter"])
def test_rtsp_source_that_connects_is_recorded(tmp_path: Path, times_ms: list[int]) -> None:
    """An encoder that listens takes what is announced and sent to it; RTP does not date the first frame."""
    port = free_port()
    address = f"rtsp://127.0.0.1:{port}/camera"
    process = start(tmp_path, address, "--listen", "--timeout", PATIENCE_S)
    wait_for_listener(port, process)
    send(address, "rtsp", times_ms, rtsp_transport="tcp")
    assert finish(process) == (0, [])
    check_rtp_times(decoded_times_ms(tmp_path), times_ms)


def check_rtp_times(found: Sequence[Fraction], times_ms: Sequence[int]) -> None:
    """Compare times from the second frame on."""
    assert len(found) == len(times_ms)
    sent = [time_ms - times_ms[1] for time_ms in times_ms[1:]]
    assert [time_ms - found[1] for time_ms in found[1:]] == sent


@pytest.mark.parametrize(
    ("answer", "stalls", "problem"),
    [
        (b"", True, "nothing came for 1 s"),
        (HEAD + b"\r\n", True, "nothing came for 1 s"),
        (b"", False, "is not a video that FFmpeg can read"),
        (HEAD + b"\r\n" + bytes(10000), False, "is not a video that FFmpeg can read"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", False, "404 Not Found"),
    ],
    ids=["no answer", "no data", "closed", "zeros", "404"],
)
def test_what_serves_no_video_is_one_line(tmp_path: Path, answer: bytes, stalls: bool, problem: str) -> None:
    with broken_server(answer, stalls=stalls) as address:
        status, lines = finish(start(tmp_path, address, "--timeout", 1 if stalls else PATIENCE_S))
    assert (status, len(lines)) == (2, 1)
    assert lines[0].startswith(f"dvc-encode: {address}: ")
    assert problem in lines[0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("scheme", ["http", "rtsp", "tcp"])
def test_who_is_not_there_is_one_line(tmp_path: Path, scheme: str) -> None:
    address = f"{scheme}://127.0.0.1:{free_port()}/camera"
    for options, problem in (((), "refused"), (("--listen",), "nothing came for 1 s")):
        status, lines = finish(start(tmp_path, address, "--timeout", 1, *options))
        assert (status, len(lines)) == (2, 1)
        assert problem in lines[0]
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(VideoError, match="--listen requires an address to which a source can connect"):
        open_video(tmp_path / "clip.mkv", listen=True)


@pytest.mark.parametrize("stalls", [False, True], ids=["cut", "stalled"])
@pytest.mark.parametrize("segment", [(), ("--segment", "0.4")], ids=["file", "segments"])
def test_frames_before_a_source_breaks_off_are_kept(
    tmp_path: Path, stalls: bool, segment: Sequence[str]
) -> None:
    """A server that ends or falls silent within a frame leaves a whole stream of those before, and a line."""
    whole = video("matroska", CONSTANT_MS)
    answer = HEAD + b"Content-Length: %d\r\n\r\n" % len(whole) + whole[: len(whole) * 2 // 3]
    with broken_server(answer, stalls=stalls) as address:
        status, lines = finish(start(tmp_path, address, "--timeout", 3 if stalls else PATIENCE_S, *segment))
    assert (status, len(lines)) == (3, 1)
    assert lines[0].startswith(f"dvc-encode: {address}: ")
    assert lines[0].endswith("; earlier frames are kept")
    assert ("nothing came for 3 s" in lines[0]) == stalls
    streams = sorted(tmp_path.glob("*.dvc"))
    assert len(list(tmp_path.iterdir())) == len(streams) == (2 if segment else 1)
    decoded = []
    for stream in streams:
        assert decoder.__main__.main([str(stream), str(tmp_path / "out.mkv"), "--quiet"]) == 0
        decoded += [frame for frame, _ in frames_shown(tmp_path / "out.mkv")]
    (tmp_path / "whole.mkv").write_bytes(whole)
    originals = [frame for frame, _ in frames_shown(tmp_path / "whole.mkv")]
    assert 10 < len(decoded) < len(originals)
    assert all(map(same_frame, decoded, originals))


def test_a_source_that_connects_and_falls_silent_is_kept(tmp_path: Path) -> None:
    """RTSP, where FFmpeg takes silence for the end; a frame is whole once the next one begins."""
    port = free_port()
    address = f"rtsp://127.0.0.1:{port}/camera"
    process = start(tmp_path, address, "--listen", "--timeout", 5)
    wait_for_listener(port, process)
    with sending(address, "rtsp", [40 * number for number in range(100)], rtsp_transport="tcp"):
        status, lines = finish(process)
    assert status == 3
    assert lines == [f"dvc-encode: {address}: nothing came for 5 s; earlier frames are kept"]
    assert len(decoded_times_ms(tmp_path)) in (99, 100)


def test_camera_is_recorded(tmp_path: Path) -> None:
    """A loopback camera, where the kernel has one: as many frames as are asked for, at rising times."""
    cameras = sorted(Path("/sys/devices/virtual/video4linux").glob("video*"))
    if not cameras:
        pytest.skip("no virtual camera (/sys/devices/virtual/video4linux): load the module v4l2loopback")
    camera = f"/dev/{cameras[0].name}"
    with av.open(camera, "w", format="v4l2") as container:
        stream = container.add_stream("rawvideo", rate=FRAME_RATE)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        process = start(tmp_path, camera, "--frames", 5)
        while process.poll() is None:
            container.mux(stream.encode(av.VideoFrame(*SIZE, "yuv420p")))
    assert finish(process) == (0, [])
    assert len(decoded_times_ms(tmp_path)) == 5
