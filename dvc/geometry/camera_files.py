"""Cameras from files: JSON, Middlebury's `calib.txt`, COLMAP models; or estimated from the pictures.

JSON is a list of cameras, or an object with the keys ``cameras`` and ``points``. A camera has ``file``
(matched without folder) and either ``K``, ``R``, ``t`` or ``P``; optionally ``distortion`` (k1, k2, p1, p2
or fewer), and ``"rows": "bottom-up"`` if its matrices count rows from the lowest one. ``points`` are points
of the scene, (x, y, z) in the world.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dvc.arrays import Bytes, Floats
from dvc.errors import ConfigError
from dvc.files import read_whole
from dvc.geometry.calibrated_cameras import LARGEST, CalibratedViews, Camera, camera_from_matrices, decomposed
from dvc.geometry.camera_estimation import Features, estimate_cameras, read_model

AUTO = "auto"
"""Value instead of a file that asks for estimated cameras."""
_NOTHING = np.zeros((0, 3))


def load_cameras(
    source: str | Path,
    paths: Sequence[str | Path],
    pictures: Sequence[Bytes],
    features: Sequence[Features] = (),
) -> CalibratedViews:
    """Read the cameras of pictures, or estimate them, from features if these are given."""
    names = [Path(path).name for path in paths]
    sizes = [(picture.shape[1], picture.shape[0]) for picture in pictures]
    if str(source) == AUTO:
        return estimate_cameras(names, pictures, features)
    source = Path(source)
    if source.is_dir():
        return read_model(source, names, sizes)
    try:
        text = read_whole(source).decode()
    except UnicodeDecodeError as err:
        raise ConfigError(f"{source}: not a text file of cameras") from err
    if text.lstrip()[:1] in ("[", "{"):
        return _from_json(source, text, names, sizes)
    if re.match(r"\s*cam0\s*=", text):
        return _from_middlebury(source, text, names, sizes)
    raise ConfigError(f"{source}: not a JSON file, Middlebury's calib.txt or the folder of a COLMAP model")


def _from_json(
    path: Path, text: str, names: Sequence[str], sizes: Sequence[tuple[int, int]]
) -> CalibratedViews:
    try:
        document = json.loads(text)
        entries = document["cameras"] if isinstance(document, dict) else document
        by_name = {Path(entry["file"]).name: entry for entry in entries}
        if len(by_name) < len(entries):
            raise ConfigError(f"{path}: a file is named twice")
        missing = next((name for name in names if name not in by_name), None)
        if missing is not None:
            raise ConfigError(f"{path}: has no camera of {missing}")
        points = document.get("points", []) if isinstance(document, dict) else []
        cameras = [_json_camera(by_name[name], name, size) for name, size in zip(names, sizes, strict=True)]
        array = np.array(points, dtype=np.float64).reshape(len(points), 3)
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError) as err:
        expected = "expected a list of cameras with file, K (3x3), R (3x3), t (3), or file, P (3x4)"
        raise ConfigError(f"{path}: {expected}") from err
    return CalibratedViews(tuple(cameras), array[(np.abs(array) <= LARGEST).all(axis=1)])


def _json_camera(entry: dict[str, Any], name: str, size: tuple[int, int]) -> Camera:
    if "P" in entry:
        K, R, t = decomposed(_matrix(entry["P"], (3, 4)))
    else:
        K, R = _matrix(entry["K"], (3, 3)), _matrix(entry["R"], (3, 3))
        t = _matrix(entry["t"], (3,))
    distortion = [float(value) for value in entry.get("distortion", [])]
    if len(distortion) > 4 or not np.isfinite(distortion).all():
        raise ConfigError(f"camera of {name}: distortion must be at most k1, k2, p1, p2")
    rows = entry.get("rows", "top-down")
    if rows not in ("top-down", "bottom-up"):
        raise ConfigError(f'camera of {name}: rows must be "top-down" or "bottom-up", got {rows!r}')
    if any(distortion) and rows == "bottom-up":
        raise ConfigError(f"camera of {name}: rows counted upwards cannot have a distortion")
    camera = camera_from_matrices(name, K, R, t, size, bottom_up=rows == "bottom-up")
    k1, k2, p1, p2 = (*distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    return replace(camera, distortion=(k1, k2, p1, p2))


def _matrix(values: Any, shape: tuple[int, ...]) -> Floats:
    matrix = np.array(values, dtype=np.float64)
    if matrix.shape != shape:
        raise ValueError(f"shape {matrix.shape}, expected {shape}")
    return matrix


def _from_middlebury(
    path: Path, text: str, names: Sequence[str], sizes: Sequence[tuple[int, int]]
) -> CalibratedViews:
    """Read two rectified cameras; the second is to the right of the first by the baseline."""
    if len(names) != 2:
        raise ConfigError(f"{path}: calibrates two views, left and right; {len(names)} are given")
    values: dict[str, str] = dict(re.findall(r"^\s*(\w+)\s*=\s*(.*?)\s*$", text, flags=re.MULTILINE))
    try:
        intrinsics = [
            _matrix([row.split() for row in values[key].strip("[]").split(";")], (3, 3))
            for key in ("cam0", "cam1")
        ]
        baseline = float(values["baseline"])
        focal, doffs = float(intrinsics[0][0, 0]), float(values["doffs"])
        declared = int(values["width"]), int(values["height"])
        limits = [float(values.get(key, other)) for key, other in (("vmin", "0"), ("vmax", values["ndisp"]))]
    except (KeyError, ValueError, IndexError) as err:
        raise ConfigError(f"{path}: expected cam0, cam1, doffs, baseline, width, height, ndisp") from err
    for name, size in zip(names, sizes, strict=True):
        if size != declared:
            raise ConfigError(f"{name}: {size[0]}x{size[1]}, but {path} is for {declared[0]}x{declared[1]}")
    cameras = [
        camera_from_matrices(name, K, np.eye(3), np.array([-k * baseline, 0.0, 0.0]), size)
        for k, (name, K, size) in enumerate(zip(names, intrinsics, sizes, strict=True))
    ]
    depths = [focal * baseline / (limit + doffs) for limit in limits if limit + doffs > 0.0]
    points = np.array([[0.0, 0.0, depth] for depth in depths]) if len(depths) == 2 else _NOTHING
    return CalibratedViews(tuple(cameras), points)
