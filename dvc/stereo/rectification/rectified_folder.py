"""Folder of rectified views, and depth of their original pictures after a reconstruction."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc.arrays import Bytes
from dvc.errors import DvcError
from dvc.geometry.calibrated_cameras import LARGEST, Camera, camera_from_matrices
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition, Reconstruction
from dvc.index_files import Entry, read_index, read_labels, write_index
from dvc.picture_files import read_picture, read_plane, write_pfm, write_png
from dvc.stereo.rectification.camera_lattice import Lattice
from dvc.stereo.rectification.rectified_array import RectifiedArray
from dvc.stereo.rectification.rectified_space import Rectification, metric_depth, to_original_view

INDEX = "rectification.json"
FORMAT, VERSION = "dvc3d rectification", 1
MAX_VIEWS = 1 << 15
_MAX_SHOWN = 12
_PREVIEW_WIDTH_PX = 1600
_NUM_LINES = 8
_COLOURS = ((0, 255, 255), (255, 255, 0))


@dataclass(frozen=True, eq=False)
class RectifiedViews:
    """Rectified views, the disparities to try, and their transformation, also as values of the index."""

    array: CameraArray
    labels: DisparityLabels | None
    rectification: Rectification
    index: dict[str, Any]


def as_views(rectified: RectifiedArray) -> RectifiedViews:
    """Return the result of `read_rectified` for a folder of these views."""
    index = rectification_index(rectified)
    return RectifiedViews(rectified.array, rectified.labels, rectified.rectification, index)


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


def read_rectified(folder: Path) -> RectifiedViews:
    """Read a folder of `write_rectified`."""
    index = read_index(folder / INDEX, FORMAT, VERSION, "dvc-stereo rectify")
    entries = index.entries("views", MAX_VIEWS)
    size = index.shape()[::-1]
    positions = tuple(LatticePosition(entry.number("m"), entry.number("n")) for entry in entries)
    if len(positions) < 2 or len(set(positions)) < len(positions):
        index.refuse("fewer than two views, or two views at one position")
    entry, (x0, y0) = index.entry("lattice"), index.vector("offset_px", 2)
    lattice = Lattice(*(entry.vector(key, 3, LARGEST) for key in ("origin", "v1", "v2")))
    if not lattice.spans_a_plane:
        entry.refuse("the steps 'v1' and 'v2' span no plane")
    rectification = Rectification(
        tuple(_read_camera(entry) for entry in entries),
        lattice,
        positions,
        index.number("focal_length_px", 0.0),
        index.number("middle_disparity"),
        (float(x0), float(y0)),
        index.number("disparity_shift"),
        size,
    )
    stems = [Path(entry.file("file").name).stem for entry in entries]
    views = [_read_view(folder, *named, size) for named in zip(stems, positions, strict=True)]
    labels = None if index.value("disparities") is None else read_labels(index.entry("disparities"))
    return RectifiedViews(
        CameraArray(tuple(views)), labels, rectification, index.without("format", "version")
    )


def _read_camera(entry: Entry) -> Camera:
    size = entry.shape()[::-1]
    K, R, t = entry.matrix("K", 3), entry.matrix("R", 3), entry.vector("t", 3, LARGEST)
    camera = camera_from_matrices(entry.text("file"), K, R, t, size)
    k1, k2, p1, p2 = (float(value) for value in entry.vector("distortion", 4))
    return replace(camera, distortion=(k1, k2, p1, p2))


def _read_view(folder: Path, name: str, position: LatticePosition, size: tuple[int, int]) -> ArrayView:
    path, shape = folder / f"view-{name}.png", size[::-1]
    valid = read_plane(folder / f"valid-{name}.png", 1, shape) > 127
    if not valid.any():
        raise DvcError(f"{path}: has no valid pixel")
    image = read_picture(path)
    if image.shape[:2] != shape:
        raise DvcError(f"{path}: {image.shape[1]}x{image.shape[0]}, expected {size[0]}x{size[1]}")
    return ArrayView(name, image, position, None if valid.all() else valid)


def rectification_index(rectified: RectifiedArray) -> dict[str, Any]:
    """Return the values of the index: homographies, disparities, and the agreement of views."""
    labels, matches = rectified.labels, rectified.matches
    return {
        "disparities": None if labels is None else labels._asdict(),
        "num_matches": None if matches is None else len(matches.disparities),
        "row_rms_px": None if matches is None else matches.rms_px,
        "cameras_refined": rectified.refined,
        "off_plane_px": [float(value) for value in rectified.off_plane_px],
        **rectified.rectification.to_dict(),
    }


def preview(array: CameraArray) -> Bytes:
    """Draw views next to each other, with lines along which their rows and columns must agree."""
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


def _lined(picture: Bytes) -> Bytes:
    lined = picture.copy()
    height, width = lined.shape[:2]
    for k in range(1, _NUM_LINES):
        colour = _COLOURS[k % 2]
        lined[k * height // _NUM_LINES] = colour
        lined[::4, k * width // _NUM_LINES] = colour
    return lined


def write_original_views(folder: Path, reconstruction: Reconstruction, rectification: Rectification) -> None:
    """Write the depth of every original picture, and its disparity and occlusions if it was resampled."""
    resampled = not rectification.is_identity
    pairs = zip(reconstruction.array, reconstruction.surfaces, strict=True)
    for index, (view, surface) in enumerate(pairs):
        disparity = to_original_view(rectification, index, surface.disparity)
        write_pfm(folder / f"depth-{view.name}.pfm", metric_depth(rectification, index, disparity))
        if resampled:
            occluded = to_original_view(rectification, index, surface.occluded.astype(np.float32))
            write_pfm(folder / f"original-disparity-{view.name}.pfm", disparity)
            write_png(folder / f"original-occluded-{view.name}.png", (occluded > 0.5).astype(np.uint8) * 255)
