"""The rendered array of two rows of two cameras: surfaces and occlusions against exact depth."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import Figure, Measured, Setting, run_module
from dvc.pfm import read_pfm
from dvc.picture_files import read_picture
from dvc.stereo.rectification.rectified_array import rectified_array
from dvc.stereo.surfaces.folder import read_reconstruction
from sequences.array_views import RenderedView, render_view
from sequences.cameras import back_project, project
from sequences.toy import POSITIONS

AREA = "stereo"
LEAST_WITHIN_PERCENT = 98.0
LEAST_FOUND_PERCENT = 90.0
MOST_ITERATIONS = 5
SAME_DEPTH = 0.02
"""Relative: points that differ by less lie on one surface."""
BORDER_PX = 2
"""Around discontinuities, where a pixel sees two surfaces."""
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def points_of(view: RenderedView) -> Floats:
    """Return where in the world the pixels of a view are."""
    height, width = view.depth.shape
    y, x = np.mgrid[:height, :width]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    return back_project(view.camera, pixels, view.depth.ravel().astype(np.float64))


def seen_by_others(views: list[RenderedView], index: int) -> Mask:
    """Tell which pixels of a view at least one other camera sees."""
    points = points_of(views[index])
    height, width = views[index].depth.shape
    seen = np.zeros(height * width, np.bool_)
    for other in views:
        if other is views[index]:
            continue
        place, depth = project(other.camera, points)
        x, y = np.rint(place).astype(np.int64).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (depth > 0.0)
        there = other.depth[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        seen |= inside & (np.abs(there / depth - 1.0) < SAME_DEPTH)
    return seen.reshape(height, width)


def near_discontinuities(disparity: Floats) -> Mask:
    """Tell which pixels are near a jump of more than one pixel."""
    kernel = np.ones((2 * BORDER_PX + 1, 2 * BORDER_PX + 1), np.uint8)
    plane = disparity.astype(np.float32)
    return np.asarray(cv2.dilate(plane, kernel) - cv2.erode(plane, kernel) > 1.0)


def toy(setting: Setting, clip: str) -> Measured:
    """Reconstruct *toy* from its cameras, and compare every original view with exact depth."""
    del clip
    with tempfile.TemporaryDirectory() as scratch:
        source, folder = Path(scratch) / "toy", Path(scratch) / "surfaces"
        size = ["--size", "160x120"] if setting.quick else []
        run_module("sequences", ["render", "toy", "--out", source, *size])
        paths = sorted(source.glob("toy-*.png"))
        cameras = source / "cameras.json"
        options = ["--cameras", cameras, "--iterations", MOST_ITERATIONS, "--quiet"]
        run_module("dvc.stereo", ["reconstruct", *paths, *options, "--out", folder])
        found = read_reconstruction(folder)
        rectification = rectified_array(paths, cameras).rectification
        height, width = read_picture(paths[0]).shape[:2]
        views = [render_view("toy", index, width, height) for index in range(len(POSITIONS))]
        errors, hidden, marked = [], [], []
        for index, (m, n) in enumerate(POSITIONS):
            number = [path.stem for path in paths].index(f"toy-{m}-{n}")
            truth = rectification.disparities(points_of(views[index])).reshape(height, width)
            counted = ~near_discontinuities(truth)
            errors.append(np.abs(read_pfm(folder / f"original-disparity-toy-{m}-{n}.pfm") - truth)[counted])
            hidden.append(~seen_by_others(views, index)[counted])
            marked.append(
                read_picture(folder / f"original-occluded-{paths[number].stem}.png")[counted][:, 0] > 0
            )
    error, alone, told = (np.concatenate(parts) for parts in (errors, hidden, marked))
    within = 100.0 * float(np.mean(error[~alone] <= found.labels.step))
    recall = 100.0 * float(np.mean(told[alone]))
    precision = 100.0 * float(np.mean(alone[told])) if told.any() else 0.0
    iterations = found.figures.get("iterations")
    text = (
        f"{within:.1f} % within {found.labels.step:g} px; of what one camera alone sees "
        f"{recall:.0f} % found, of what is found {precision:.0f} %; {iterations} iterations"
    )
    values = {"within_percent": within, "recall_percent": recall, "precision_percent": precision}
    return Measured(text, within >= LEAST_WITHIN_PERCENT and recall >= LEAST_FOUND_PERCENT, values)


FIGURES = (
    Figure(
        AREA,
        "toy",
        "toy array of 2x2 cameras, original views against exact depth",
        f"≥ {LEAST_WITHIN_PERCENT:g} % within one label where another camera sees, occlusions found",
        toy,
    ),
)
"""The figure of this module."""
