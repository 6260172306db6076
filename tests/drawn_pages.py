"""Pages that draw by WebGL, in a browser: opened and watched, what they save, a context that is lost."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page

from dvc.picture_files import read_picture
from tests.browser import wait_until

TIMEOUT_MS = 60_000
MESSAGE = "document.getElementById('message')"
TOLD = f"!{MESSAGE}.hidden && !{MESSAGE}.textContent.startsWith('Unpacking')"
"""Whether a page says something, and not that it is busy."""

Opened = Callable[..., Page]


@contextmanager
def opened_pages(browser: Browser, folder: Path, ready: str, size: tuple[int, int]) -> Iterator[Opened]:
    """Give what opens a page of a folder; at the end none has logged anything or asked for anything."""
    complaints: list[str] = []
    requests: list[str] = []
    contexts = []

    def open_page(name: str, script: str = "", until: str = ready, **options: Any) -> Page:
        viewport = dict(zip(("width", "height"), size, strict=True))
        context = browser.new_context(**{"viewport": viewport, **options})
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        if script:
            page.add_init_script(script)
        page.goto((folder / f"{name}.html").as_uri(), timeout=TIMEOUT_MS)
        wait_until(page, until)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []


def saved_picture(page: Page, by_pointer: bool = False) -> NDArray[np.uint8]:
    """Return the picture that the page saves, shape (H, W, 3); a pointer takes a second to get there."""
    with page.expect_download() as download:
        if by_pointer:
            page.click("#save")
        else:
            page.dispatch_event("#save", "click")
    return read_picture(download.value.path())


def lose_context(page: Page) -> None:
    """Take from a page what it draws with, until it says so; `taken.restoreContext()` gives it back."""
    page.evaluate(
        "window.taken = document.getElementById('view').getContext('webgl2')"
        ".getExtension('WEBGL_lose_context'); taken.loseContext()"
    )
    wait_until(page, TOLD)


def restore_context(page: Page, ready: str) -> None:
    """Give it back, and wait until the page has drawn again and says nothing more."""
    page.evaluate("taken.restoreContext()")
    wait_until(page, f"{ready} && {MESSAGE}.hidden")
