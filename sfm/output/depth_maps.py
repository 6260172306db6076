"""Depth maps as pictures of 16 bits."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Depths = NDArray[np.float32]

MAX_LEVEL = 2**16 - 1


def depth_step(depths: Mapping[int, Depths]) -> float:
    """Return the depth of a level: the largest depth of all has the largest level."""
    largest = max((float(depth[is_known(depth)].max(initial=0.0)) for depth in depths.values()), default=0.0)
    return largest / MAX_LEVEL or 1.0


def is_known(depth: Depths) -> NDArray[np.bool_]:
    """Tell where there is a depth."""
    return np.isfinite(depth) & (depth > 0.0)


def depth_levels(depth: Depths, step: float) -> NDArray[np.uint16]:
    """Return depths as levels from 1; 0 is where none is known."""
    known = is_known(depth)
    levels = np.zeros(depth.shape, np.uint16)
    levels[known] = np.clip(np.rint(depth[known].astype(np.float64) / step), 1, MAX_LEVEL).astype(np.uint16)
    return levels


def write_depth_maps(folder: Path, depths: Mapping[int, Depths], step: float) -> None:
    """Write ``000012.png`` for frame 12, and so on."""
    for number, depth in depths.items():
        _, coded = cv2.imencode(".png", depth_levels(depth, step))
        (folder / f"{number:06d}.png").write_bytes(coded.tobytes())
