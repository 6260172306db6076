"""The picture of docs/scene.md: the page of a map that is made out of decoded frames."""

from pathlib import Path

import cv2
import numpy as np

from benchmarks.pictures.drawing import scratch_files, write_picture
from benchmarks.results.harness import run_module

PICTURE = Path("docs/scene/map.jpg")
SIZE_PX = 960, 600
QP = "30"
MAX_BYTES = 150_000
_DONE = "['settled', 'failed'].some(state => document.documentElement.classList.contains(state))"


def draw() -> list[Path]:
    """Code the rendered statue in processes, map the decoded frames, and take a picture of the page."""
    from playwright.sync_api import sync_playwright

    from tests import browser

    with scratch_files("statue.mkv", "statue.dvc", "decoded.mkv", "map", "map.png") as files:
        video, stream, decoded, folder, screen = files
        run_module("sequences", "render", "statue", "--out", video)
        run_module("encoder", video, stream, "--qp", QP, "--quiet")
        run_module("decoder", stream, decoded, "--scene", folder)
        with sync_playwright() as playwright:
            started = playwright.chromium.launch(
                executable_path=browser.find(), args=list(browser.GRAPHICS_ARGUMENTS)
            )
            page = started.new_page(viewport={"width": SIZE_PX[0], "height": SIZE_PX[1]})
            page.goto((folder / "index.html").as_uri())
            browser.wait_until(page, _DONE)
            page.screenshot(path=screen, timeout=120_000)
            started.close()
        return [write_picture(PICTURE, np.asarray(cv2.imread(str(screen)), np.uint8), MAX_BYTES)]
