"""A reconstruction as a folder: pictures and disparities of all views, and `stereo.json` that names them."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS, MAX_NUMBER, MIN_STEP, read_picture
from dvc.errors import DvcError
from dvc.multiview.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.pfm import read_pfm, write_pfm
from dvc.stereo.surfaces.surface import Reconstruction, Surface

INDEX = "stereo.json"
VERSION = 1


def write_reconstruction(folder: Path, reconstruction: Reconstruction) -> None:
    """Write `stereo.json` and, of each view, its picture, disparity, occlusions and confidence.

    Parameters
    ----------
    folder : Path
        A folder that exists.
    reconstruction : Reconstruction
        What to write.
    """
    array, labels = reconstruction.array, reconstruction.labels
    for view, surface in zip(array, reconstruction.surfaces, strict=True):
        files = _files(view)
        if view.valid is not None:
            write_png(folder / files["valid"], view.valid.astype(np.uint8) * 255)
        write_png(folder / files["image"], view.image[:, :, ::-1])
        write_pfm(folder / files["disparity"], surface.disparity)
        write_png(folder / files["occluded"], surface.occluded.astype(np.uint8) * 255)
        write_png(folder / files["confidence"], np.rint(surface.confidence * 255).astype(np.uint8))
    height, width = array.shape
    index = {
        "format": "dvc3d stereo",
        "version": VERSION,
        "width": width,
        "height": height,
        "disparities": labels._asdict(),
        "reference": array[array.reference].name,
        "views": [{"name": v.name, "m": v.position.m, "n": v.position.n, **_files(v)} for v in array],
        **reconstruction.figures,
    }
    (folder / INDEX).write_text(json.dumps(index, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_reconstruction(folder: str | Path) -> Reconstruction:
    """Read a folder that `write_reconstruction` has written.

    Parameters
    ----------
    folder : str or Path
        With `stereo.json`.

    Returns
    -------
    Reconstruction
        What it holds.

    Raises
    ------
    DvcError
        If a file is missing, damaged, of another size, or lies outside the folder.
    """
    folder = Path(folder)
    index = _index(folder / INDEX)
    try:
        labels = DisparityLabels(**index["disparities"])
        if not (labels.num_labels in range(1, MAX_LABELS + 1) and labels.step >= MIN_STEP):
            raise DvcError(f"{folder / INDEX}: disparities make no sense")
        if not np.abs(labels[:2]).max() <= MAX_NUMBER:
            raise DvcError(f"{folder / INDEX}: disparities make no sense")
        labels = labels._replace(num_labels=int(labels.num_labels))
        shape = int(index["height"]), int(index["width"])
        pairs = [_read_view(folder, entry, shape) for entry in index["views"]]
    except (KeyError, TypeError, ValueError) as err:
        raise DvcError(f"{folder / INDEX}: not what `dvc-stereo reconstruct` writes") from err
    if not pairs:
        raise DvcError(f"{folder / INDEX}: names no view")
    known = {"format", "version", "width", "height", "disparities", "reference", "views"}
    figures = {key: value for key, value in index.items() if key not in known}
    views, surfaces = zip(*pairs, strict=True)
    if len({view.position for view in views}) < len(views):
        raise DvcError(f"{folder / INDEX}: two views have one position")
    return Reconstruction(CameraArray(tuple(views)), labels, tuple(surfaces), figures)


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture.

    Parameters
    ----------
    path : Path
        File to make.
    picture : ndarray of shape (H, W) or (H, W, 3 or 4), uint8
        Grey levels, or blue, green, red (and opacity).
    """
    done, content = cv2.imencode(".png", picture)
    if not done:
        raise DvcError(f"cannot write {path}")
    path.write_bytes(content.tobytes())


def _files(view: ArrayView) -> dict[str, str]:
    kinds = {"image": "view-{}.png", "disparity": "disparity-{}.pfm"}
    kinds |= {kind: f"{kind}-{{}}.png" for kind in ("occluded", "confidence")}
    if view.valid is not None:
        kinds["valid"] = "valid-{}.png"
    return {kind: name.format(view.name) for kind, name in kinds.items()}


def _index(path: Path) -> dict[str, Any]:
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as err:
        raise DvcError(f"{path}: not a JSON file") from err
    if not isinstance(index, dict) or index.get("format") != "dvc3d stereo":
        raise DvcError(f"{path}: not what `dvc-stereo reconstruct` writes")
    if index.get("version") != VERSION:
        raise DvcError(f"{path}: version {index.get('version')} is not known, only {VERSION}")
    return index


def _read_view(folder: Path, entry: dict[str, Any], shape: tuple[int, int]) -> tuple[ArrayView, Surface]:
    paths = {}
    for kind in ("image", "disparity", "occluded", "confidence", "valid"):
        if kind == "valid" and kind not in entry:
            continue
        name = str(entry[kind])
        if Path(name).name != name:
            raise DvcError(f"{folder / INDEX}: {name} lies outside the folder")
        paths[kind] = folder / name
    position = LatticePosition(float(entry["m"]), float(entry["n"]))
    image, disparity = read_picture(paths["image"]), read_pfm(paths["disparity"])
    occluded, confidence, *seen = (read_picture(path)[:, :, 0] for path in list(paths.values())[2:])
    shapes = [image.shape[:2], disparity.shape, *(plane.shape for plane in (occluded, confidence, *seen))]
    for path, found in zip(paths.values(), shapes, strict=True):
        if found != shape:
            raise DvcError(f"{path}: {found[1]}x{found[0]}, expected {shape[1]}x{shape[0]}")
    if not np.abs(position).max() <= MAX_NUMBER:
        raise DvcError(f"{folder / INDEX}: position {position.m:g},{position.n:g} makes no sense")
    if not np.isfinite(disparity).all():
        raise DvcError(f"{paths['disparity']}: not finite")
    surface = Surface(disparity, occluded > 127, (confidence / 255.0).astype(np.float32))
    valid = seen[0] > 127 if seen else None
    return ArrayView(str(entry["name"]), image, position, valid), surface
