"""Sources on this machine's network: videos that PyAV serves, and servers that break off."""

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from io import BytesIO
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
