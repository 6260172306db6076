"""Files of cameras: JSON, Middlebury's calibration and COLMAP models; their mutations, and their reader."""

import json
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.hostile.mutations import mutate
from dvc.calibration.camera_files import load_cameras
from dvc.errors import DvcError

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
_SEPARATOR = b"\0file\0"


def _files() -> tuple[dict[str, bytes], ...]:
    """Return good inputs: the files of each."""
    colmap = {name: text.encode() for name, text in _COLMAP.items()}
    json_file = json.dumps({"cameras": _CAMERAS, "points": [[0.5, 0.25, 7.0]]}).encode()
    return {"cameras.json": json_file}, {"calib.txt": _MIDDLEBURY.encode()}, colmap


def damaged_cameras(number: int) -> bytes:
    """Return files of which one is damaged, one after the other with their names."""
    rng, files = np.random.default_rng(number), dict(_files()[number % 3])
    chosen = sorted(files)[int(rng.integers(len(files)))]
    files[chosen] = mutate(files[chosen], rng)
    return _SEPARATOR.join(name.encode() + b"\0" + data for name, data in files.items())


def try_cameras(damaged: bytes) -> str:
    """Read cameras; what is read is finite."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for part in damaged.split(_SEPARATOR):
            name, _, data = part.partition(b"\0")
            paths.append(Path(folder) / name.decode())
            paths[-1].write_bytes(data)
        source = paths[0] if len(paths) == 1 else Path(folder)
        try:
            views = load_cameras(source, _NAMES, [_PICTURE] * len(_NAMES))
        except DvcError:
            return "refused"
    matrices = [(view.K, view.R, view.t) for view in views.cameras]
    whole = all(np.isfinite(matrix).all() for camera in matrices for matrix in camera)
    return "decoded" if whole else "cameras that are not finite"
