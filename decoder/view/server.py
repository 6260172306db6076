"""The server of the page: it answers requests of this machine for the page, figures and pictures."""

import json
import re
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from threading import BoundedSemaphore, Event, Thread
from urllib.parse import urlsplit

from decoder.view.decoding_view import DIFFERENCE_GAIN, KINDS, DecodingView, Facts
from dvc.errors import ConfigError
from dvc.files import Closing
from dvc.web.document import SHARED, asset, render_page

HOST = "127.0.0.1"
MAX_CONNECTIONS = 16
"""Largest number of simultaneous connections; further ones are closed."""
REQUEST_TIMEOUT_S = 10.0
TEMPLATES = resources.files("decoder.view") / "templates"
PICTURE = re.compile(rf"/pictures/([0-9]{{1,9}})/({'|'.join(KINDS)})\.jpg")
STATE = re.compile(r"after=(-1|[0-9]{1,9})")
Response = tuple[str, bytes]


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

    def show(self, facts: Facts, requests_in_flight: Callable[[], int] | None = None) -> DecodingView:
        """Serve a new view, and return it to receive pictures."""
        self._view = DecodingView(facts, requests_in_flight)
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

    def respond(self, path: str) -> Response | None:
        """Return the type and the content of a resource; None if it does not exist."""
        url = urlsplit(path)
        if url.path == "/":
            return "text/html; charset=utf-8", _page().encode()
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


def _page() -> str:
    css, scripts = [asset(SHARED, "base.css"), asset(TEMPLATES, "view.css")], [asset(TEMPLATES, "view.js")]
    return render_page(TEMPLATES, "view.html.j2", css=css, scripts=scripts, served=True, gain=DIFFERENCE_GAIN)
