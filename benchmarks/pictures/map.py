"""The picture of docs/scene.md: the page of a map that is made out of decoded frames."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2

from benchmarks.results.harness import run_module

PICTURE = Path("docs/scene/map.jpg")
SIZE_PX = 960, 600
QP = "30"
MAX_BYTES = 150_000


def main(argv: Sequence[str] | None = None) -> int:
    """Code the rendered statue in processes, map the decoded frames, and take a picture of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/map"), help="folder to write, new")
    parser.add_argument("--picture", type=Path, default=PICTURE, help="picture to write")
    arguments = parser.parse_args(argv)
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    video, stream, decoded = (str(folder / name) for name in ("statue.mkv", "statue.dvc", "decoded.mkv"))
    run_module("sequences", "render", "statue", "--out", video)
    run_module("encoder", video, stream, "--qp", QP, "--quiet")
    run_module("decoder", stream, decoded, "--scene", str(folder / "map"))
    _take(folder / "map" / "index.html", arguments.picture)
    print(arguments.picture)
    return 0


def _take(page_path: Path, target: Path) -> None:
    """Open a page in the browser of the tests, and save its picture."""
    from playwright.sync_api import sync_playwright

    from tests import browser

    done = "['settled', 'failed'].some(state => document.documentElement.classList.contains(state))"
    screen = target.with_suffix(".png")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=browser.find(), args=list(browser.GRAPHICS_ARGUMENTS)
        )
        page = started.new_page(viewport={"width": SIZE_PX[0], "height": SIZE_PX[1]})
        page.goto(page_path.absolute().as_uri())
        browser.wait_until(page, done)
        page.screenshot(path=screen, timeout=120_000)
        started.close()
    picture = cv2.imread(str(screen))
    screen.unlink()
    assert picture is not None
    for quality in range(92, 40, -4):
        cv2.imwrite(str(target), picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if target.stat().st_size <= MAX_BYTES:
            break


if __name__ == "__main__":
    sys.exit(main())
