"""Camera paths in the format of the TUM RGB-D benchmark: where the camera stands, and how it is turned."""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfm.output.colmap_text import quaternion

Floats = NDArray[np.float64]


def write_trajectory(path: Path, poses: Mapping[int, Floats], fps: Fraction | float | None) -> None:
    """Write poses, world to camera, as lines of camera to world; a time is that of a frame by its number."""
    unit = "the number of the frame" if fps is None else f"seconds, the number of the frame / {fps}"
    lines = ["# timestamp tx ty tz qx qy qz qw", f"# camera to world; timestamp: {unit}"]
    for number in sorted(poses):
        turn, shift = poses[number][:, :3].T, poses[number][:, 3]
        w, x, y, z = quaternion(turn)
        time = f"{number}" if fps is None else f"{float(number / Fraction(fps)):.6f}"
        lines.append(" ".join([time, *(f"{value:.9g}" for value in (*(-turn @ shift), x, y, z, w))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
