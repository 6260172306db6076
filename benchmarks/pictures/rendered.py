"""Pictures of the README and of docs/scene.md: stages of a decoded frame, and the page of a map."""

from pathlib import Path

import cv2
import numpy as np

from benchmarks.pictures.drawing import decoding_stages, scratch_files, write_picture
from benchmarks.results.harness import report_of, run_module

FIRST, MAP = Path("docs/pictures/first.jpg"), Path("docs/scene/map.jpg")
SCENE = ("street", "--frames", "17")
SIZE_PX = 960, 600
QP = "30"
MAX_BYTES = 150_000
_DONE = "['settled', 'failed'].some(state => document.documentElement.classList.contains(state))"


def draw_first() -> list[Path]:
    """Code the rendered street in processes, and draw a frame between two that are decoded before it."""
    with scratch_files("street.mkv", "street.dvc", "decoded.mkv", "predicted.mkv", "report.json") as files:
        video, stream, decoded, predicted, report = files
        run_module("sequences", "render", *SCENE, "--out", video)
        run_module("encoder", video, stream, "--qp", QP, "--quiet")
        outputs = ["--side-information-video", predicted, "--json", report, "--reference", video, "--quiet"]
        run_module("decoder", stream, decoded, *outputs)
        picture = decoding_stages(decoded, predicted, report_of(report)["per_frame"])
    return [write_picture(FIRST, picture, MAX_BYTES)]


def draw_map() -> list[Path]:
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
        return [write_picture(MAP, np.asarray(cv2.imread(str(screen)), np.uint8), MAX_BYTES)]
