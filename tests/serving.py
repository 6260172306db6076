"""Sources on this machine's network: videos that PyAV serves, and servers that break off."""

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import BinaryIO, cast

import av
from av.video.stream import VideoStream

from dvc.video import Frame, open_video
from dvc.video.pixels import picture_from_frame
from tests.clips import moving_texture
from tests.waiting import wait_until

_LISTENING = "0A"
SIZE = (64, 48)
FRAME_RATE = 25


def free_port() -> int:
    """Return a port that nobody uses."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def wait_for_listener(port: int, process: subprocess.Popen[str]) -> None:
    """Wait until a process listens at a port, without connecting to it."""

    def _listens() -> bool:
        rows = (line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:])
        return any(row[1].endswith(f":{port:04X}") and row[3] == _LISTENING for row in rows)

    wait_until(_listens, process.poll)


@contextmanager
def sending(output: BinaryIO | str, form: str, times_ms: Sequence[int], **options: str) -> Iterator[None]:
    """Send frames of H.264 that are shown at some times to an address or a file, and then the end."""
    with av.open(output, "w", format=form, options=options) as container:
        stream = cast("VideoStream", container.add_stream("libx264", rate=FRAME_RATE))
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.options = {"tune": "zerolatency", "g": "5"}
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for time_ms, frame in zip(times_ms, moving_texture(len(times_ms), SIZE[1], SIZE[0]), strict=True):
            picture = picture_from_frame(frame, "yuv420p")
            picture.pts, picture.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(picture))
        yield
        container.mux(stream.encode(None))


def send(output: BinaryIO | str, form: str, times_ms: Sequence[int], **options: str) -> None:
    """Send frames as `sending` does."""
    with sending(output, form, times_ms, **options):
        pass


@contextmanager
def http_server(times_ms: Sequence[int]) -> Iterator[str]:
    """Let a process serve a video once by FFmpeg's own HTTP server; give its address."""
    port = free_port()
    address = f"http://127.0.0.1:{port}/camera"
    code = f"from tests.serving import send; send({address!r}, 'fifo', {list(times_ms)}, "
    code += "fifo_format='mpegts', format_opts='listen=1')"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen([sys.executable, "-c", code], text=True, env=environment) as process:
        try:
            wait_for_listener(port, process)
            yield address
        finally:
            process.kill()


@contextmanager
def rtsp_server(times_ms: Sequence[int]) -> Iterator[str]:
    """Serve a video once by RTSP, RTP within the same connection, as cameras do; give its address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        send(f"rtp://127.0.0.1:{receiver.getsockname()[1]}", "rtp", times_ms)
        receiver.setblocking(False)
        packets = []
        with suppress(BlockingIOError):
            while True:
                packets.append(receiver.recv(2**16))
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=_play, args=(server, packets))
        thread.start()
        try:
            yield f"rtsp://127.0.0.1:{server.getsockname()[1]}/camera"
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


def _play(server: socket.socket, packets: Sequence[bytes]) -> None:
    try:
        connection, _ = server.accept()
    except OSError:
        return
    with connection, connection.makefile("rb") as requests:
        for method, number in iter(lambda: _request(requests), None):
            body = _SDP if method == "DESCRIBE" else ""
            head = f"RTSP/1.0 200 OK\r\nCSeq: {number}\r\nSession: 1\r\n{_HEADERS.get(method, '')}"
            connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n{body}".encode())
            if method == "PLAY":
                for packet in packets:
                    connection.sendall(b"$\0" + len(packet).to_bytes(2, "big") + packet)
                return


def _request(requests: BinaryIO) -> tuple[str, str] | None:
    """Read a request: its method and number."""
    lines = list(takewhile(str.strip, map(bytes.decode, iter(requests.readline, b""))))
    if not lines:
        return None
    number = next(line.partition(":")[2].strip() for line in lines if line.startswith("CSeq"))
    return lines[0].split()[0], number


_SDP = "\r\n".join(
    (
        "v=0",
        "o=- 0 0 IN IP4 127.0.0.1",
        "s=camera",
        "t=0 0",
        "m=video 0 RTP/AVP 96",
        "a=rtpmap:96 H264/90000",
        "a=fmtp:96 packetization-mode=1",
        "a=control:streamid=0",
        "",
    )
)
_HEADERS = {
    "OPTIONS": "Public: DESCRIBE, SETUP, PLAY\r\n",
    "DESCRIBE": "Content-Type: application/sdp\r\n",
    "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n",
}


@contextmanager
def broken_server(answer: bytes, *, stalls: bool) -> Iterator[str]:
    """Serve some bytes to all who connect; then close the connection, or be silent."""
    connections: list[socket.socket] = []

    def _serve(server: socket.socket) -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            connection.recv(2**16)
            connection.sendall(answer)
            connections.append(connection)
            if not stalls:
                connection.shutdown(socket.SHUT_RDWR)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=_serve, args=(server,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.getsockname()[1]}/camera"
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()
            for connection in connections:
                connection.close()


def video(form: str, times_ms: Sequence[int]) -> bytes:
    """Return a video as bytes."""
    file = BytesIO()
    send(file, form, times_ms)
    return file.getvalue()


def frames_shown(path: Path) -> list[tuple[Frame, Fraction]]:
    """Read frames of a video, and when they are shown after the first one, in seconds."""
    with open_video(path) as reader:
        frames = list(reader)
    times_s = [frame.time.seconds for frame in frames if frame.time is not None]
    return [(frame, time_s - times_s[0]) for frame, time_s in zip(frames, times_s, strict=True)]
