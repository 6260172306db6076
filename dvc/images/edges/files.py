"""Edges as pictures: both maps of the dual lattice in one grey PNG file of the size of the depth map."""

from pathlib import Path

import numpy as np

from dvc.errors import DvcError
from dvc.images.edge_maps import EdgeMaps
from dvc.picture_files import read_levels, write_png

RIGHT_LEVEL, BELOW_LEVEL = 85, 170
"""Of a sample that is cut off from that to its right, and from that below it; both: their sum."""


def write_edges(path: Path, edges: EdgeMaps) -> None:
    """Write edges; the inverse of `read_edges`."""
    write_png(path, RIGHT_LEVEL * edges.between_columns + BELOW_LEVEL * edges.between_rows)


def read_edges(path: str | Path, shape: tuple[int, int]) -> EdgeMaps:
    """Read edges; those beyond the last row and column have no meaning."""
    levels = read_levels(path, "a picture of edges, as decode writes it")
    if levels.shape != shape:
        sizes = [f"{size[1]}x{size[0]}" for size in (levels.shape, shape)]
        raise DvcError(f"{path}: edges of {sizes[0]}, but the depth map is {sizes[1]}")
    known = (0, RIGHT_LEVEL, BELOW_LEVEL, RIGHT_LEVEL + BELOW_LEVEL)
    if not np.isin(levels, known).all():
        raise DvcError(f"{path}: edges have the levels {', '.join(map(str, known))}")
    right = np.isin(levels, (RIGHT_LEVEL, RIGHT_LEVEL + BELOW_LEVEL)).astype(np.uint8)
    below = (levels >= BELOW_LEVEL).astype(np.uint8)
    below[-1], right[:, -1] = 0, 0
    return EdgeMaps(below, right)
