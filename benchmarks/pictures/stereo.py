"""Draw surfaces, errors and occlusions for `docs/stereo.md`.

Photographs of the real sets cannot be published here: `docs` only has maps of them.
"""

import json
import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.baselines.opencv_stereo import semi_global_baseline
from benchmarks.pictures.drawing import Picture, write_picture
from benchmarks.results.harness import run_module
from benchmarks.results.stereo import data_folder
from benchmarks.thesis.scenes import PAIRS
from dvc.geometry.camera_array import Reconstruction
from dvc.stereo.evaluation import disparity_error, read_mask
from dvc.stereo.surfaces.surface_folder import read_reconstruction
from dvc.web.drawing import colour_disparity, colour_error, in_rows, with_title

Rows = list[list[float]]
FOLDER = Path("docs") / "stereo"
CALIBRATED = {"sport": 2, "ballet": 2}
"""Sets that are not rectified, and how many maps of each are shown."""


def write_cameras(folder: Path, path: Path) -> list[Path]:
    """Write the cameras of a set as `dvc-stereo` reads them."""
    cameras = {"sport": _sport, "ballet": _ballet, "fern": _fern}[folder.name](folder)
    path.write_text(json.dumps(cameras), encoding="utf-8")
    return sorted(folder.glob("*.png"))


def _sport(folder: Path) -> list[dict[str, Any]]:
    rows = _numbers(folder / "cameras.txt")
    return [{"file": f"Sport{k}.png", "P": rows[3 * k : 3 * k + 3]} for k in range(2)]


def _ballet(folder: Path) -> list[dict[str, Any]]:
    """Rows of these cameras count from the lowest one."""
    rows = _numbers(folder / "cameras.txt")
    return [
        {
            "file": f"color-cam{k}-f000.png",
            **_camera(rows[6 * k : 6 * k + 3], rows[6 * k + 3 : 6 * k + 6]),
            "rows": "bottom-up",
        }
        for k in range(8)
    ]


def _fern(folder: Path) -> dict[str, Any]:
    text = (folder / "cameras.txt").read_text(encoding="utf-8")
    rows = _numbers(folder / "cameras.txt")
    distortion = [float(number) for number in re.findall(r"k1 = ([\d.]+)", text)]
    names = re.findall(r"# (image\d+\.png)", text)
    cameras = [
        {"file": name, **_camera(rows[:3], rows[3 + 3 * k : 6 + 3 * k]), "distortion": distortion}
        for k, name in enumerate(names)
    ]
    return {"cameras": cameras, "points": [row[:3] for row in _numbers(folder / "points3d.txt")]}


def _camera(K: Rows, pose: Rows) -> dict[str, Any]:
    return {"K": K, "R": [row[:3] for row in pose], "t": [row[3] for row in pose]}


def _numbers(path: Path) -> Rows:
    lines = path.read_text(encoding="utf-8").splitlines()
    return [[float(word) for word in line.split()] for line in lines if line and not line.startswith("#")]


def _maps(found: Reconstruction, indices: Sequence[int]) -> Picture:
    low, high = found.labels.lowest, found.labels.highest
    panels = []
    for index in indices:
        view, surface = found.array[index], found.surfaces[index]
        disparity = (
            surface.disparity if view.valid is None else np.where(view.valid, surface.disparity, np.nan)
        )
        panels.append(with_title(colour_disparity(disparity, low, high), view.name))
    return in_rows(panels, len(panels))


def draw_toy() -> list[Path]:
    """Draw the rendered array: views after rectification, their disparities and occlusions."""
    with tempfile.TemporaryDirectory() as scratch:
        source, folder, rectified = (Path(scratch) / name for name in ("toy", "surfaces", "rectified"))
        run_module("sequences", "render", "toy", "--out", source)
        views, cameras = sorted(source.glob("toy-*.png")), ["--cameras", source / "cameras.json"]
        run_module("dvc.stereo", "rectify", *views, *cameras, "--out", rectified, "--quiet")
        run_module("dvc.stereo", "reconstruct", *views, *cameras, "--out", folder, "--quiet")
        found = read_reconstruction(folder)
        preview = cv2.imread(str(rectified / "preview.png"))
    hidden = [
        with_title(surface.occluded.astype(np.uint8) * 255, f"{view.name}: in no other view")
        for view, surface in zip(found.array, found.surfaces, strict=True)
    ]
    rows = [_maps(found, range(len(found.array))), in_rows(hidden, len(hidden))]
    shown = {"toy-rectified": np.asarray(preview, np.uint8), "toy": in_rows(rows, 1)}
    return [write_picture(FOLDER / f"{name}.jpg", picture) for name, picture in shown.items()]


def draw_pairs() -> list[Path]:
    """Draw disparities and errors of the Middlebury pairs, and the errors of StereoSGBM."""
    panels = []
    for name, one in PAIRS.items():
        data = data_folder(name)
        with tempfile.TemporaryDirectory() as scratch:
            words = ["reconstruct", *one.pair_files(data), f"--disparities={one.disparities}"]
            run_module("dvc.stereo", *words, "--out", Path(scratch) / "surfaces", "--quiet")
            found = read_reconstruction(Path(scratch) / "surfaces")
        truth, mask = one.true_disparity(data), read_mask(data / name / "all.png")
        left, right = found.array
        ours = found.surfaces[0].disparity
        theirs = semi_global_baseline(left.image, right.image, one.labels.highest)
        panels.append(with_title(colour_disparity(ours, one.labels.lowest, one.labels.highest), name))
        for title, disparity in (("errors", ours), ("errors of StereoSGBM", theirs)):
            error, counted = disparity_error(disparity, truth, mask)
            bad = 100.0 * float(np.mean(error[counted] > 1.0))
            panels.append(with_title(colour_error(error, counted), f"{title}: {bad:.2f} % bad"))
    return [write_picture(FOLDER / "pairs.jpg", in_rows(panels, 3))]


def draw_calibrated() -> list[Path]:
    """Draw disparities of real pictures that are not rectified."""
    written = []
    for name, count in CALIBRATED.items():
        source = data_folder(name) / name
        with tempfile.TemporaryDirectory() as scratch:
            folder, cameras = Path(scratch) / "surfaces", Path(scratch) / "cameras.json"
            paths = write_cameras(source, cameras)
            words = ["reconstruct", *paths, "--cameras", cameras]
            run_module("dvc.stereo", *words, "--out", folder, "--quiet")
            found = read_reconstruction(folder)
        chosen = [found.array.reference, *(k for k in range(len(found.array)) if k != found.array.reference)]
        written.append(write_picture(FOLDER / f"{name}.jpg", _maps(found, chosen[:count])))
    return written


PICTURES: dict[str, Callable[[], list[Path]]] = {
    "toy": draw_toy,
    "pairs": draw_pairs,
    "calibrated": draw_calibrated,
}
