"""The calibrations of the real sets that are not rectified, as JSON files of cameras."""

import json
import re
from pathlib import Path


def write_sport(folder: Path, path: Path) -> Path:
    """Write the two projection matrices of *sport*."""
    rows = _numbers(folder / "cameras.txt")
    cameras = [{"file": f"Sport{k}.png", "P": rows[3 * k : 3 * k + 3]} for k in range(2)]
    path.write_text(json.dumps(cameras))
    return path


def write_ballet(folder: Path, path: Path) -> Path:
    """Write the eight cameras of *ballet*, whose rows count from the lowest one."""
    rows = _numbers(folder / "cameras.txt")
    cameras = []
    for index in range(8):
        K, pose = rows[6 * index : 6 * index + 3], rows[6 * index + 3 : 6 * index + 6]
        matrices = {"K": K, "R": [row[:3] for row in pose], "t": [row[3] for row in pose]}
        cameras.append({"file": f"color-cam{index}-f000.png", **matrices, "rows": "bottom-up"})
    path.write_text(json.dumps(cameras))
    return path


def write_fern(folder: Path, path: Path) -> Path:
    """Write the cameras of *fern* with their distortion, and the points that they see."""
    text = (folder / "cameras.txt").read_text()
    rows = _numbers(folder / "cameras.txt")
    found = re.search(r"k1 = ([\d.]+)", text)
    assert found is not None
    cameras = []
    for index, name in enumerate(re.findall(r"# (image\d+\.png)", text)):
        pose = rows[3 + 3 * index : 6 + 3 * index]
        matrices = {"K": rows[:3], "R": [row[:3] for row in pose], "t": [row[3] for row in pose]}
        cameras.append({"file": name, **matrices, "distortion": [float(found[1])]})
    points = [row[:3] for row in _numbers(folder / "points3d.txt")]
    path.write_text(json.dumps({"cameras": cameras, "points": points}))
    return path


def _numbers(path: Path) -> list[list[float]]:
    lines = path.read_text().splitlines()
    return [[float(word) for word in line.split()] for line in lines if line and not line.startswith("#")]
