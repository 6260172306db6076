"""Measure chapters 3 and 4 into `results`, and copy figures without photographs to `docs`.

Photographs of the real sets cannot be published here: `docs` has curves and maps of them, and views of a
rendered scene.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.pictures.drawing import write_picture
from benchmarks.results.harness import run_module
from benchmarks.results.stereo import data_folder
from benchmarks.thesis.harness import Method, file_name
from benchmarks.thesis.view_curves import CODERS

FOLDER, RESULTS = Path("docs") / "dibr", Path("results") / "dibr"
MAP = "teddy"
"""Set with disparity maps that are shown."""


def _figures(chapter: int, name: str, *options: object) -> Callable[[str], Path]:
    """Measure a chapter by our methods, and return a function from the number of a figure to its file."""
    words = ["--chapter", chapter, name, *options, "--as", Method.DEFAULT, "--out", RESULTS, "--quiet"]
    run_module("benchmarks.thesis", *words)
    FOLDER.mkdir(parents=True, exist_ok=True)
    folder = RESULTS / f"chapter{chapter}"
    return lambda number: folder / file_name(number, name, Method.DEFAULT)


def _copied(source: Path, target: str) -> Path:
    shutil.copy(source, FOLDER / target)
    return FOLDER / target


def _photograph(source: Path, target: str, num_rows: int = 0) -> Path:
    """Write a picture as JPEG, without the first of its rows of panels if their number is given."""
    picture = np.asarray(cv2.imread(str(source)), np.uint8)
    first = -(-picture.shape[0] // num_rows) if num_rows else 0
    return write_picture(FOLDER / target, picture[first:])


def draw_toy() -> list[Path]:
    """Draw levels of resolution and rendered views of the rendered array."""
    figure = _figures(3, "toy")
    return [_photograph(figure(number), f"toy-{number}.jpg") for number in ("3.9", "3.10", "3.12")]


def draw_set() -> list[Path]:
    """Draw curves and disparity maps of a real set."""
    figure = _figures(3, MAP, "--data", data_folder(MAP))
    plots = [_copied(figure(number), f"figure-{number}-{MAP}.png") for number in ("3.13", "3.14", "3.15")]
    return [*plots, _photograph(figure("3.10"), f"maps-{MAP}.jpg", len(CODERS[Method.DEFAULT]) + 1)]


def draw_chapter4() -> list[Path]:
    """Draw the curves, coefficients and decoded maps of chapter 4."""
    run_module("benchmarks.thesis", "--chapter", 4, "--as", Method.THESIS, "--out", RESULTS, "--quiet")
    signal = RESULTS / "chapter4" / file_name("4.3", "", Method.THESIS)
    written = [_copied(signal, "figure-4.3.png")]
    figure = _figures(4, MAP, "--data", data_folder(MAP))
    written += [_copied(figure(number), f"figure-{number}-{MAP}.png") for number in ("4.8a", "4.8b")]
    return written + [_photograph(figure(number), f"figure-{number}-{MAP}.jpg") for number in ("4.6", "4.7")]


PICTURES: dict[str, Callable[[], list[Path]]] = {
    "toy": draw_toy,
    MAP: draw_set,
    "chapter4": draw_chapter4,
}
