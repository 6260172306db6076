"""A reconstruction as a folder: pictures and disparities of all views, and `stereo.json` that names them."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from dvc.errors import DvcError
from dvc.geometry.camera_array import ArrayView, CameraArray, LatticePosition, Reconstruction, Surface
from dvc.index_files import Entry, read_index, read_labels, write_index
from dvc.picture_files import read_pfm, read_picture, read_plane, write_pfm, write_png

INDEX = "stereo.json"
FORMAT, VERSION = "dvc3d stereo", 1
MAX_VIEWS = 1 << 15


def write_reconstruction(folder: Path, reconstruction: Reconstruction, jobs: int = 1) -> None:
    """Write `stereo.json` and, of each view, its picture, disparity, occlusions and confidence."""
    array, labels = reconstruction.array, reconstruction.labels

    def _write_view(view: ArrayView, surface: Surface) -> None:
        files = _files(view)
        if view.valid is not None:
            write_png(folder / files["valid"], view.valid.astype(np.uint8) * 255)
        write_png(folder / files["image"], view.image[:, :, ::-1])
        write_pfm(folder / files["disparity"], surface.disparity)
        write_png(folder / files["occluded"], surface.occluded.astype(np.uint8) * 255)
        write_png(folder / files["confidence"], np.rint(surface.confidence * 255).astype(np.uint8))

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(_write_view, array, reconstruction.surfaces))
    height, width = array.shape
    index = {
        "width": width,
        "height": height,
        "disparities": labels._asdict(),
        "reference": array[array.reference].name,
        "views": [{"name": v.name, "m": v.position.m, "n": v.position.n, **_files(v)} for v in array],
        **reconstruction.figures,
    }
    write_index(folder / INDEX, FORMAT, VERSION, index)


def read_reconstruction(folder: str | Path) -> Reconstruction:
    """Read a folder of `write_reconstruction`."""
    index = read_index(Path(folder) / INDEX, FORMAT, VERSION, "dvc-stereo reconstruct")
    labels = read_labels(index.entry("disparities"))
    shape = index.shape()
    views, surfaces = zip(
        *(_read_view(entry, shape) for entry in index.entries("views", MAX_VIEWS)), strict=True
    )
    if len({view.position for view in views}) < len(views):
        index.refuse("two views have one position")
    figures = index.without("format", "version", "width", "height", "disparities", "reference", "views")
    return Reconstruction(CameraArray(views), labels, surfaces, figures)


def _files(view: ArrayView) -> dict[str, str]:
    kinds = {"image": "view-{}.png", "disparity": "disparity-{}.pfm"}
    kinds |= {kind: f"{kind}-{{}}.png" for kind in ("occluded", "confidence")}
    if view.valid is not None:
        kinds["valid"] = "valid-{}.png"
    return {kind: name.format(view.name) for kind, name in kinds.items()}


def _read_view(entry: Entry, shape: tuple[int, int]) -> tuple[ArrayView, Surface]:
    position = LatticePosition(entry.number("m"), entry.number("n"))
    image, disparity = read_picture(entry.file("image")), read_pfm(entry.file("disparity"))
    for kind, size in (("image", image.shape[:2]), ("disparity", disparity.shape)):
        if size != shape:
            raise DvcError(f"{entry.file(kind)}: {size[1]}x{size[0]}, expected {shape[1]}x{shape[0]}")
    if not np.isfinite(disparity).all():
        raise DvcError(f"{entry.file('disparity')}: not finite")
    kinds = ["occluded", "confidence", *(["valid"] if "valid" in entry else [])]
    occluded, confidence, *seen = (read_plane(entry.file(kind), 1, shape) for kind in kinds)
    surface = Surface(disparity, occluded > 127, (confidence / 255.0).astype(np.float32))
    return ArrayView(entry.text("name"), image, position, seen[0] > 127 if seen else None), surface
