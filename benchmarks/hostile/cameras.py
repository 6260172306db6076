"""Files of cameras: JSON, Middlebury's calibration and COLMAP models, and their reader."""

import json
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.hostile.files import Files
from dvc.geometry.camera_files import load_cameras

_NAMES = "a.png", "b.png"
_PICTURE = np.zeros((120, 160), np.uint8)
_MATRIX = [[150.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]]
_CAMERAS = [
    {"file": name, "K": _MATRIX, "R": np.eye(3).tolist(), "t": [-float(k), 0.0, 0.0], "distortion": [0.02]}
    for k, name in enumerate(_NAMES)
]
_MIDDLEBURY = """cam0=[150 0 80; 0 150 60; 0 0 1]
cam1=[150 0 82; 0 150 60; 0 0 1]
doffs=2.0
baseline=193.0
width=160
height=120
ndisp=64
"""
_COLMAP = {
    "cameras.txt": "1 SIMPLE_RADIAL 160 120 150 80.5 60.5 0.02\n",
    "images.txt": "1 1 0 0 0 0 0 0 1 a.png\n80 60 1\n2 1 0 0 0 -1 0 0 1 b.png\n82 60 1\n",
    "points3D.txt": "1 0.5 0.25 7 0 0 0 0.1 1 0 2 0\n",
    "rigs.txt": "1 1 CAMERA 1\n",
    "frames.txt": "1 1 1 0 0 0 0 0 0 1 CAMERA 1 1\n2 1 1 0 0 0 -1 0 0 1 CAMERA 1 2\n",
}


@cache
def good_cameras() -> tuple[Files, ...]:
    """Return good inputs: the files of each."""
    colmap = {name: text.encode() for name, text in _COLMAP.items()}
    json_file = json.dumps({"cameras": _CAMERAS, "points": [[0.5, 0.25, 7.0]]}).encode()
    return {"cameras.json": json_file}, {"calib.txt": _MIDDLEBURY.encode()}, colmap


def read_cameras(folder: Path) -> bool:
    """Read cameras; tell whether they are finite."""
    paths = list(folder.iterdir())
    views = load_cameras(paths[0] if len(paths) == 1 else folder, _NAMES, [_PICTURE] * len(_NAMES))
    matrices = [(view.K, view.R, view.t) for view in views.cameras]
    return all(np.isfinite(matrix).all() for camera in matrices for matrix in camera)
