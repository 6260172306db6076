"""Page of a decoding run: figures of the latest frames, pictures of fewer, and the server of this machine."""

import json
import re
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from threading import BoundedSemaphore, Event, Lock, Thread
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from decoder.report import DecodedPicture
from dvc.config import CodecConfig
from dvc.errors import ConfigError
from dvc.files import Closing
from dvc.video.pixels import rgb_from_frame
from dvc.web.document import SHARED, asset, render_page
from dvc.web.drawing import colour_disparity

NUM_ROWS = 1000
"""Number of latest frames with figures."""
MAX_PICTURE_PX = 2**24
"""Largest number of pixels in pictures of the latest frames; one frame is always kept."""
DIFFERENCE_GAIN = 4
"""Amplification of differences from the prediction."""
KINDS = ("decoded", "predicted", "difference", "depth")
REPORTED = ("index", "type", "bits", "psnr_y_db", "side_information", "side_information_reason", "decode_s")
"""Fields of a frame's report on the page."""
DEPTH_SHARE = 0.02
"""Share of the nearest and of the farthest pixels with the colours of the ends."""
QUALITY = 88
HOST = "127.0.0.1"
MAX_CONNECTIONS = 16
"""Largest number of simultaneous connections; further ones are closed."""
REQUEST_TIMEOUT_S = 10.0
TEMPLATES = resources.files("decoder.view") / "templates"
PICTURE = re.compile(rf"/pictures/([0-9]{{1,9}})/({'|'.join(KINDS)})\.jpg")
STATE = re.compile(r"after=(-1|[0-9]{1,9})")
Picture = NDArray[np.uint8]


class DecodingView:
    """Figures and pictures for a page; one thread adds, other threads read."""

    def __init__(
        self,
        config: CodecConfig,
        name: str,
        num_frames: int | None,
        requests_in_flight: Callable[[], int] | None = None,
    ) -> None:
        video, key = config.video, config.key
        facts = [f"{video.width}x{video.height} at {float(video.frame_rate):g} Hz", f"codec {config.codec}"]
        facts += [f"side information {config.side_information.method}"]
        facts += ["luma" if video.luma_only else "colour"]
        facts += ["lossless key frames" if key.lossless else f"key frames of QP {key.qp}"]
        rate: dict[str, Any] = {"frame_rate": float(video.frame_rate), "total": num_frames}
        self._facts = {"name": name, "facts": ", ".join(facts), **rate}
        self._requests = requests_in_flight
        self._rows: deque[dict[str, Any]] = deque(maxlen=NUM_ROWS)
        self._pictures: OrderedDict[int, DecodedPicture] = OrderedDict()
        self._num_frames, self._bits = 0, Counter[str]()
        self._finished = False
        self._lock = Lock()

    def add(self, picture: DecodedPicture, group: int) -> None:
        """Add a decoded picture of a group of pictures."""
        row = {name: picture.report[name] for name in REPORTED if name in picture.report}
        centre = None  # camera at infinity
        if picture.camera is not None:
            with suppress(np.linalg.LinAlgError):
                position = -np.linalg.solve(picture.camera[:, :3], picture.camera[:, 3])
                centre = position.tolist() if np.isfinite(position).all() else None
        pixels = picture.frame.width * picture.frame.height
        with self._lock:
            has_depth = picture.inverse_depth is not None
            self._rows.append({**row, "group": group, "centre": centre, "has_depth": has_depth})
            self._pictures[picture.report["index"]] = picture
            while len(self._pictures) > max(MAX_PICTURE_PX // pixels, 1):
                self._pictures.popitem(last=False)
            self._num_frames += 1
            self._bits.update(picture.report["bits"])

    def finish(self) -> None:
        """Mark the run as finished."""
        self._finished = True

    def state(self, after: int) -> dict[str, Any]:
        """Return the figures of the run, and rows of the frames after one."""
        with self._lock:
            return {
                **self._facts,
                "num_frames": self._num_frames,
                "bits": dict(self._bits),
                "finished": self._finished,
                "requests_in_flight": None if self._requests is None else self._requests(),
                "first_picture": next(iter(self._pictures), None),
                "rows": [row for row in self._rows if row["index"] > after],
            }

    def jpeg(self, index: int, kind: str) -> bytes | None:
        """Return a picture of a frame; None if it is not available."""
        import cv2

        with self._lock:
            picture = self._pictures.get(index)
        image = None if picture is None else _image(picture, kind)
        if image is None:
            return None
        return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1])


def _image(picture: DecodedPicture, kind: str) -> Picture | None:
    if kind == "decoded":
        frame = picture.frame
        return frame.luma if frame.chroma is None else rgb_from_frame(frame)[:, :, ::-1]
    if kind == "depth" and picture.inverse_depth is not None:
        disparity = picture.inverse_depth.astype(np.float64)
        finite = disparity[np.isfinite(disparity)]
        ends = np.quantile(finite, (DEPTH_SHARE, 1 - DEPTH_SHARE)) if finite.size else (0.0, 1.0)
        return colour_disparity(disparity, float(ends[0]), float(ends[1]))
    if kind == "depth" or picture.predicted is None:
        return None
    if kind == "predicted":
        return picture.predicted
    difference = picture.frame.luma.astype(np.int16) - picture.predicted
    return np.asarray(np.clip(128 + DIFFERENCE_GAIN * difference, 0, 255), np.uint8)


class ViewServer(Closing):
    """Server of a page that shows a view."""

    def __init__(self, port: int = 0) -> None:
        self._view: DecodingView | None = None
        try:
            self._server = _Server((HOST, port), _handler(self))
        except OSError as err:
            raise ConfigError(f"cannot serve a page on {HOST}:{port}: {err.strerror}") from err
        self._thread = Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{self.name}/"

    @property
    def name(self) -> str:
        """Host and port."""
        return f"{HOST}:{self._server.server_port}"

    def show(
        self,
        config: CodecConfig,
        name: str,
        num_frames: int | None,
        requests_in_flight: Callable[[], int] | None = None,
    ) -> DecodingView:
        """Serve a new view, and return it to receive pictures."""
        self._view = DecodingView(config, name, num_frames, requests_in_flight)
        return self._view

    def wait(self) -> None:
        """Continue serving until an interrupt."""
        if self._view is not None:
            self._view.finish()
        Event().wait()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    def respond(self, path: str) -> tuple[str, bytes] | None:
        """Return the type and the content of a resource; None if it does not exist."""
        url = urlsplit(path)
        if url.path == "/":
            scripts = [asset(TEMPLATES, "view.js")]
            css = [asset(SHARED, "base.css"), asset(TEMPLATES, "view.css")]
            page = render_page(
                TEMPLATES, "view.html.j2", css=css, scripts=scripts, served=True, gain=DIFFERENCE_GAIN
            )
            return "text/html; charset=utf-8", page.encode()
        if self._view is None:
            return None
        if url.path == "/state" and (match := STATE.fullmatch(url.query)):
            return "application/json", json.dumps(self._view.state(int(match[1]))).encode()
        if match := PICTURE.fullmatch(url.path):
            jpeg = self._view.jpeg(int(match[1]), match[2])
            return None if jpeg is None else ("image/jpeg", jpeg)
        return None


class _Server(ThreadingHTTPServer):
    """HTTP server with a bounded number of threads."""

    daemon_threads = True

    def __init__(self, *arguments: object) -> None:
        self._free = BoundedSemaphore(MAX_CONNECTIONS)
        super().__init__(*arguments)  # type: ignore[arg-type]

    def process_request(self, request: object, client_address: object) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)  # type: ignore[arg-type]
        else:
            self.shutdown_request(request)  # type: ignore[arg-type]

    def process_request_thread(self, request: object, client_address: object) -> None:
        try:
            super().process_request_thread(request, client_address)  # type: ignore[arg-type]
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore clients that disconnect."""


def _handler(server: ViewServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = REQUEST_TIMEOUT_S

        def do_GET(self) -> None:
            # A page of another origin with a name that resolves to this machine would send that name.
            if self.headers.get("Host") != server.name:
                self.send_error(HTTPStatus.FORBIDDEN)
                return
            response = server.respond(self.path)
            if response is None:
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            kind, content = response
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *arguments: object) -> None:
            """Log nothing: the terminal belongs to the command."""

    return Handler
