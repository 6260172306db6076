"""One cloud of coloured points from depth maps, thinned to one point in every cube of a grid."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Colours = NDArray[np.uint8]

MAX_POINTS = 500_000
"""More of them no viewer turns smoothly, and no page holds."""
CUBE_PX = 1.5
"""Side of the cubes at first, in pixels at the median depth."""
FARTHEST = 8.0
"""Depth, in medians of a frame, beyond which points are left out: they are far apart, and not precise."""


def points_in_world(depth: NDArray[np.float32], K: Floats, pose: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the points of a depth map that is known, and which pixels they are."""
    known = np.isfinite(depth)
    row, column = np.nonzero(known)
    z = depth[known].astype(np.float64)
    inside = np.column_stack([(column - K[0, 2]) / K[0, 0] * z, (row - K[1, 2]) / K[1, 1] * z, z])
    return (inside - pose[:, 3]) @ pose[:, :3], known


def dense_cloud(
    maps: Iterable[tuple[NDArray[np.float32], Floats, Colours]], K: Floats, limit: int = MAX_POINTS
) -> tuple[Floats, Colours]:
    """Join depth maps, each with its pose and picture, to points and colours; at most `limit` of them."""
    points, colours = np.empty((0, 3)), np.empty((0, 3), np.uint8)
    side = 0.0
    for depth, pose, picture in maps:
        if not np.isfinite(depth).any():
            continue
        middle = float(np.nanmedian(depth))
        near = np.where(depth <= FARTHEST * middle, depth, np.nan)
        side = side or CUBE_PX * middle / float(K[0, 0])
        new, known = points_in_world(near, K, pose)
        points, colours = np.concatenate([points, new]), np.concatenate([colours, picture[known]])
        points, colours = _thinned(points, colours, side)
        while len(points) > limit:
            side *= 1.25
            points, colours = _thinned(points, colours, side)
    return points, colours


def _thinned(points: Floats, colours: Colours, side: float) -> tuple[Floats, Colours]:
    """Keep the first point of every cube."""
    cubes = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    size = cubes.max(axis=0) + 1
    _, first = np.unique((cubes[:, 0] * size[1] + cubes[:, 1]) * size[2] + cubes[:, 2], return_index=True)
    first.sort()
    return points[first], colours[first]
