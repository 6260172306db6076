"""Measure chapters 3 and 4 into `results`, and bring to `docs` what their pages of results show.

Photographs of the real sets are not the project's to show: in `docs` there are curves and maps of them, and
views of a rendered scene.
"""

import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.pictures.drawing import Picture, pictures_command, write_picture
from benchmarks.results.harness import run_module
from benchmarks.results.stereo import data_folder
from dvc.dibr.names import OWN_NAMES

PROG = "python -m benchmarks.pictures.dibr"
EXAMPLES = """\
  python -m benchmarks.pictures.dibr               all of them; many minutes
  python -m benchmarks.pictures.dibr --name toy    one
"""
FOLDER = Path("docs") / "dibr"
RESULTS = Path("results") / "dibr"
PLOTS = "3.13", "3.14", "3.15"
PLOTS_OF_MAPS = "4.3", "4.8a-teddy", "4.8b-teddy"
PICTURES_OF_MAPS = "4.6-teddy", "4.7-teddy"
MAP = "teddy"
"""Set whose disparity maps are shown."""


def _chapter(name: str, options: Sequence[object]) -> Path:
    """Measure the chapter on a scene; other codecs are left out."""
    folder = RESULTS / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    run_module("dvc.dibr", "evaluate", *options, "--sets", name, "--no-peers", "--out", folder, "--quiet")
    FOLDER.mkdir(parents=True, exist_ok=True)
    return folder


def _without_first_row(path: Path) -> Picture:
    """Read panels in rows, one for each method, without those of the reference view above them."""
    picture = np.asarray(cv2.imread(str(path)), np.uint8)
    rows = len(OWN_NAMES) + 1
    return picture[-(-picture.shape[0] // rows) :]


def draw_toy() -> list[Path]:
    """Draw levels of resolution and rendered views of the rendered array."""
    folder = _chapter("toy", [])
    written = []
    for number in ("3.9", "3.10", "3.12"):
        picture = np.asarray(cv2.imread(str(folder / f"figure-{number}-toy.png")), np.uint8)
        write_picture(FOLDER / f"toy-{number}.jpg", picture)
        written.append(FOLDER / f"toy-{number}.jpg")
    return written


def draw_set(name: str) -> list[Path]:
    """Draw curves of a real set, and the disparity maps of one."""
    folder = _chapter(name, ["--data", data_folder(name)])
    written = []
    for number in PLOTS:
        shutil.copy(folder / f"figure-{number}-{name}.png", FOLDER / f"figure-{number}-{name}.png")
        written.append(FOLDER / f"figure-{number}-{name}.png")
    if name == MAP:
        maps = FOLDER / f"maps-{name}.jpg"
        write_picture(maps, _without_first_row(folder / f"figure-3.10-{name}.png"))
        written.append(maps)
    return written


def draw_chapter4() -> list[Path]:
    """Draw the curves, coefficients and decoded maps of chapter 4."""
    folder = RESULTS / "chapter4"
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    options = ["--chapter", 4, "--data", data_folder(MAP), "--sets", MAP, "--out", folder, "--quiet"]
    run_module("dvc.dibr", "evaluate", *options)
    FOLDER.mkdir(parents=True, exist_ok=True)
    written = [FOLDER / f"figure-{number}.png" for number in PLOTS_OF_MAPS]
    for path in written:
        shutil.copy(folder / path.name, path)
    for number in PICTURES_OF_MAPS:
        picture = np.asarray(cv2.imread(str(folder / f"figure-{number}.png")), np.uint8)
        write_picture(FOLDER / f"figure-{number}.jpg", picture)
        written.append(FOLDER / f"figure-{number}.jpg")
    return written


PICTURES: dict[str, Callable[[], list[Path]]] = {
    "toy": draw_toy,
    MAP: lambda: draw_set(MAP),
    "chapter4": draw_chapter4,
}


main = pictures_command(PROG, "Draw pictures of docs/dibr.md.", EXAMPLES, PICTURES)

if __name__ == "__main__":
    sys.exit(main())
