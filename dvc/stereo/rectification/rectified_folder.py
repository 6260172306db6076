"""Rectified views as a folder, and what a reconstruction of them says of the original pictures."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.index_files import write_index
from dvc.multiview.camera_array import CameraArray
from dvc.pfm import write_pfm
from dvc.picture_files import write_png
from dvc.stereo.rectification.rectified_array import RectifiedArray
from dvc.stereo.rectification.rectified_space import Rectification
from dvc.stereo.rectification.resampling import metric_depth, to_original_view
from dvc.stereo.surfaces.surface import Reconstruction

INDEX = "rectification.json"
FORMAT, VERSION = "dvc3d rectification", 1
_MAX_SHOWN = 12
_PREVIEW_WIDTH_PX = 1600
_NUM_LINES = 8
_COLOURS = ((0, 255, 255), (255, 255, 0))


def write_rectified(folder: Path, rectified: RectifiedArray) -> None:
    """Write pictures and masks of all views, `views.csv`, `rectification.json` and `preview.png`."""
    rows = ["file,m,n"]
    for view in rectified.array:
        write_png(folder / f"view-{view.name}.png", view.image[:, :, ::-1])
        write_png(folder / f"valid-{view.name}.png", view.seen.astype(np.uint8) * 255)
        rows.append(f"view-{view.name}.png,{view.position.m!r},{view.position.n!r}")
    (folder / "views.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_png(folder / "preview.png", preview(rectified.array))
    write_index(folder / INDEX, FORMAT, VERSION, rectification_index(rectified))


def rectification_index(rectified: RectifiedArray) -> dict[str, Any]:
    """Return the homographies, the range of disparities, and how well views agree."""
    labels, matches = rectified.labels, rectified.matches
    return {
        "disparities": None if labels is None else labels._asdict(),
        "num_matches": None if matches is None else len(matches.disparities),
        "row_rms_px": None if matches is None else matches.rms_px,
        "cameras_refined": rectified.refined,
        "off_plane_px": [float(value) for value in rectified.off_plane_px],
        **rectified.rectification.to_dict(),
    }


def preview(array: CameraArray) -> NDArray[np.uint8]:
    """Draw views beside each other, with lines along which their rows and columns must agree."""
    order = sorted(range(len(array)), key=lambda index: array[index].position[::-1])
    shown = [order[k * len(order) // min(len(order), _MAX_SHOWN)] for k in range(min(len(order), _MAX_SHOWN))]
    across = 2 if len(shown) == 2 else math.ceil(math.sqrt(len(shown)))
    tiles = [_lined(array[index].image[:, :, ::-1]) for index in shown]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % across)
    sheet = np.vstack([np.hstack(tiles[k : k + across]) for k in range(0, len(tiles), across)])
    scale = min(1.0, _PREVIEW_WIDTH_PX / sheet.shape[1])
    return np.asarray(
        cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8
    )


def _lined(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    lined = picture.copy()
    height, width = lined.shape[:2]
    for k in range(1, _NUM_LINES):
        colour = _COLOURS[k % 2]
        lined[k * height // _NUM_LINES] = colour
        lined[::4, k * width // _NUM_LINES] = colour
    return lined


def write_original_views(folder: Path, reconstruction: Reconstruction, rectification: Rectification) -> None:
    """Write the depth of every original picture, and what else rectification has moved."""
    moved = not rectification.is_identity
    pairs = zip(reconstruction.array, reconstruction.surfaces, strict=True)
    for index, (view, surface) in enumerate(pairs):
        disparity = to_original_view(rectification, index, surface.disparity)
        write_pfm(folder / f"depth-{view.name}.pfm", metric_depth(rectification, index, disparity))
        if moved:
            occluded = to_original_view(rectification, index, surface.occluded.astype(np.float32))
            write_pfm(folder / f"original-disparity-{view.name}.pfm", disparity)
            write_png(folder / f"original-occluded-{view.name}.png", (occluded > 0.5).astype(np.uint8) * 255)
