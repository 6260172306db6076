"""The calibrations of the real sets that are not rectified, as JSON files of cameras."""

import json
import re
from pathlib import Path
from typing import Any

Rows = list[list[float]]


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
