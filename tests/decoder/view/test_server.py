"""The page of a run: in a browser while a command decodes, and what its server refuses."""

import http.client
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

import encoder
from decoder.view import decoding_view
from decoder.view.decoding_view import HOST, ViewServer
from dvc.config import Qp, VideoConfig, codec_config
from dvc.errors import ConfigError
from dvc.geometry.cameras import PixelFrame
from dvc.video import Frame
from tests.decoder.view.test_decoding_view import picture
from tests.scenes_3d import render

TIMEOUT_MS = 60_000
HOSTILE = "<script>window.stolen = 1</script>.dvc"


@pytest.fixture
def served() -> Iterator[ViewServer]:
    """Serve three frames of a stream with a hostile name."""
    with ViewServer() as page:
        view = page.show(codec_config(VideoConfig(32, 16, 25, 1)), HOSTILE, 3, lambda: 5)
        view.add(picture(0, key=True), 0)
        view.add(picture(1), 1)
        view.add(picture(2), 1)
        yield page


def until(page: Page, condition: str) -> None:
    """Wait until a page is in a state; its policy lets it evaluate nothing by itself."""
    for _ in range(TIMEOUT_MS // 50):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(condition)


def asked(page: ViewServer, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(page.name, timeout=30)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    status, content = answer.status, answer.read()
    connection.close()
    return status, content


def test_what_is_served(served: ViewServer) -> None:
    assert served.address == f"http://{served.name}/"
    assert [asked(served, path)[0] for path in ("/", "/state?after=-1", "/pictures/1/depth.jpg")] == [200] * 3
    for path in (
        "/state",
        "/state?after=x",
        "/pictures/9/depth.jpg",
        "/pictures/1/other.jpg",
        "/../x",
        "/view.js",
    ):
        assert asked(served, path)[0] == 404
    assert asked(served, "/", Host="example.org")[0] == 403
    assert asked(served, "/state?after=-1", method="POST")[0] == 501
    assert asked(served, "/")[0] == 200


def test_few_are_answered_at_a_time(served: ViewServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding_view, "REQUEST_TIMEOUT_S", 0.5)
    with ViewServer() as page:
        silent = [socket.create_connection(tuple(page.name.split(":")), timeout=30) for _ in range(20)]  # type: ignore[arg-type]
        assert all(one.recv(1) == b"" for one in silent)
        assert asked(page, "/")[0] == 200
        for one in silent:
            one.close()


def test_a_port_that_is_taken(served: ViewServer) -> None:
    with pytest.raises(ConfigError, match=f"cannot serve a page on {HOST}"):
        ViewServer(int(served.name.split(":")[1]))


def test_page_in_a_browser(browser: Browser, served: ViewServer) -> None:
    page = browser.new_page(viewport={"width": 1200, "height": 1400})
    logged: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: logged.append(message.text))
    page.on("pageerror", lambda error: logged.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(served.address, timeout=TIMEOUT_MS)
    until(page, "document.querySelectorAll('#bits rect').length > 3")
    assert page.text_content("h1") == HOSTILE
    assert "3 of 3 frames" in (page.text_content("#progress") or "")
    assert "5 requests in flight" in (page.text_content("#progress") or "")
    loaded = "[...document.images].filter((image) => image.complete && image.naturalWidth > 0).length"
    until(page, f"{loaded} === 4")
    assert page.locator("#path circle").count() == 2
    page.locator("#frame").fill("0")
    until(page, f"{loaded} === 1")
    assert "key frame" in (page.text_content("#told") or "")
    assert not page.is_checked("#follow")
    assert page.evaluate("window.stolen") is None
    assert logged == []
    assert [url for url in requests if not url.startswith((served.address, "data:"))] == []
    page.close()


def test_a_command_is_watched(browser: Browser, tmp_path: Path) -> None:
    size = (176, 144)
    frames = [Frame(render(time, PixelFrame(*size))[0]) for time in np.linspace(0.0, 1.0, 5)]
    stream, video = tmp_path / "stream.dvc", tmp_path / "decoded.y4m"
    encoder.encode(frames, codec_config(VideoConfig(*size, 25, 1, luma_only=True), quality=Qp(34)), stream)
    words = [sys.executable, "-m", "decoder", str(stream), str(video), "--view", "--quiet"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as command:
        assert command.stderr is not None
        found = re.search(r"watch at (http://127\.0\.0\.1:\d+/)", command.stderr.readline())
        assert found is not None
        page = browser.new_page()
        page.goto(found[1], timeout=TIMEOUT_MS)
        page.locator("#progress", has_text="all decoded").wait_for(timeout=TIMEOUT_MS)
        assert "stays until Ctrl-C" in command.stderr.readline()
        assert video.stat().st_size > 5 * 176 * 144
        assert page.locator("#totals tr").count() == 5
        page.close()
        command.send_signal(signal.SIGINT)
        assert command.wait(timeout=60) == 0
