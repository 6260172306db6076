"""Camera arrays to test with: synthetic ones whose surfaces are known, and the real sets."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

REAL_SETS = Path(__file__).resolve().parents[2].parent / "shared" / "stereo"


def real_set(name: str) -> Path:
    """Return the folder of a real set; the test is skipped where it is not there."""
    folder = REAL_SETS / name
    if not folder.is_dir():
        pytest.skip(f"no folder ../shared/stereo/{name} beside the project")
    return folder


def pair_of_planes(
    height: int = 48, width: int = 72, near: int = 6, far: int = 2
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float64]]:
    """Return a left and a right view of a square before a background, and the disparity of the left one."""
    rng = np.random.default_rng(7)
    background = rng.integers(0, 256, (height, width + far, 3)).astype(np.uint8)
    square = rng.integers(0, 256, (height // 2, width // 3, 3)).astype(np.uint8)
    top, left = height // 4, width // 3
    views = []
    for camera in (0, 1):
        view = background[:, far * camera : far * camera + width].copy()
        at = left - near * camera
        view[top : top + square.shape[0], at : at + square.shape[1]] = square
        views.append(view)
    disparity = np.full((height, width), float(far))
    disparity[top : top + square.shape[0], left : left + square.shape[1]] = near
    return views[0], views[1], disparity
