"""Edges of depth maps: differences of neighbours, those of Canny's detector, or those of a file."""

from pathlib import Path

import cv2
import numpy as np

from dvc.errors import DvcError
from dvc.images.chain_code import draw, trace
from dvc.images.edge_maps import EdgeMaps
from dvc.images.lifting import Plane
from dvc.picture_files import read_levels, write_png

CANNY_THRESHOLDS = 40.0, 100.0
"""Weaker and stronger threshold of the detector, for maps stretched to levels from 0 to 255."""

SHORTEST_CHAIN = 8
"""Edge elements of the shortest chain that Canny's detector keeps."""

_JUMP = 0.02

RIGHT_LEVEL, BELOW_LEVEL = 85, 170
"""Levels of a sample that is cut off from that to its right, and from that below it; both: their sum."""


def edges_of_jumps(depth: Plane, least: float) -> EdgeMaps:
    """Return the edges between neighbours that differ."""
    edges = EdgeMaps.none((depth.shape[0], depth.shape[1]))
    edges.between_rows[:-1] = np.abs(np.diff(depth, axis=0)) > least
    edges.between_columns[:, :-1] = np.abs(np.diff(depth, axis=1)) > least
    return edges


def canny_edges(depth: Plane) -> EdgeMaps:
    """Return the edges at pixels that Canny's detector marks, without short chains."""
    extent = float(np.ptp(depth))
    if not extent:
        return EdgeMaps.none((depth.shape[0], depth.shape[1]))
    levels = np.round((depth - depth.min()) * (255.0 / extent)).astype(np.uint8)
    marked = cv2.Canny(levels, *CANNY_THRESHOLDS, L2gradient=True) > 0
    edges = edges_of_jumps(depth, _JUMP * extent)
    edges.between_rows[:-1] &= marked[:-1] | marked[1:]
    edges.between_columns[:, :-1] &= marked[:, :-1] | marked[:, 1:]
    chains = trace(edges)
    return draw(chains.take(np.flatnonzero(chains.lengths >= SHORTEST_CHAIN)))


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
