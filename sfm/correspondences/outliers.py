"""The eight tests that remove wrong correspondences; each returns a mask of those to keep.

`mse`, `unicity` and `motion` need the images only, `epipolar` and `epipole` a fundamental matrix,
`reprojection`, `chirality` and `depth` cameras and depths.
"""

from dataclasses import dataclass

import numpy as np

from dvc.arrays import Floats, Integers, Mask
from sfm.estimation.epipolar import distances_to_epipole, epipoles, symmetric_distances
from sfm.scene_model import Correspondences

MOTION_LIMIT_PX, MOTION_SPREADS = 2.0, 3.0
"""Allowed differences from the neighbours' median motion: in pixels, and in units of their spread."""
MAX_REPROJECTION_PX = 1.0
"""Largest reprojection error."""
EPIPOLE_DISTANCE_PX = 10.0
"""Least distance to an epipole; nearer points cannot be triangulated."""
DEPTH_SHARE, DEPTH_SPREADS = 0.1, 3.0
"""Allowed differences of inverse depths: as a share of the median, and in units of the neighbours' spread."""
ISLAND_SHARE, ISLAND_GAP = 0.02, 0.2
"""Largest share of the points in an island, and the least difference of inverse depth around it."""
MOSTLY = 0.9
"""Share of the neighbours around a group, by weight, that counts as all of them."""


@dataclass(frozen=True)
class Neighbours:
    """Pairs of neighbouring points, as indices; every pair occurs in both directions, ordered by point."""

    point: Integers
    neighbour: Integers
    weight: Floats  # inverse distances


def mse(error: Floats, limit: Floats | float) -> Mask:
    """Keep correspondences with similar neighbourhoods."""
    return np.asarray(error <= limit)


def unicity(i: Integers, j: Integers, error: Floats, limit: Floats | float) -> Mask:
    """Keep the best pairs without repeated points, by the Hungarian algorithm."""
    from scipy.optimize import linear_sum_assignment

    rows, row = np.unique(i, return_inverse=True)
    columns, column = np.unique(j, return_inverse=True)
    gain, pair = np.zeros((len(rows), len(columns))), np.full((len(rows), len(columns)), -1)
    gain[row, column] = limit - error
    pair[row, column] = np.arange(len(i))
    chosen = pair[linear_sum_assignment(gain, maximize=True)]
    keep = np.zeros(len(i), dtype=bool)
    keep[chosen[chosen >= 0]] = True
    return keep


def epipolar(correspondences: Correspondences, fundamental: Floats, limit_px: float) -> Mask:
    """Keep correspondences near each other's epipolar lines."""
    distance = symmetric_distances(fundamental, correspondences.first, correspondences.second)
    return np.asarray(distance <= limit_px)


def motion(pairs: Correspondences) -> Mask:
    """Keep correspondences that move like their neighbours."""
    return _like_neighbours(pairs.first, pairs.motion, MOTION_LIMIT_PX, MOTION_SPREADS)[0]


def reprojection(second: Floats, projected: Floats) -> Mask:
    """Keep correspondences with 3D points that project near the second points."""
    finite = np.asarray(np.isfinite(projected).all(axis=1))
    offset = np.where(finite[:, None], projected, second) - second
    return finite & (np.hypot(offset[:, 0], offset[:, 1]) <= MAX_REPROJECTION_PX)


def chirality(depth_first: Floats, depth_second: Floats) -> Mask:
    """Keep correspondences with the majority's sign of the product of projective depths."""
    sign = np.sign(depth_first) * np.sign(depth_second)
    sign = np.where(np.isfinite(depth_first) & np.isfinite(depth_second), sign, 0.0)
    return np.asarray(sign == (1.0 if sign.sum() >= 0 else -1.0))


def epipole(correspondences: Correspondences, fundamental: Floats) -> Mask:
    """Keep correspondences far from both epipoles, where triangulation is singular."""
    in_first, in_second = epipoles(fundamental)
    far_in_first = distances_to_epipole(in_first, correspondences.first) >= EPIPOLE_DISTANCE_PX
    far_in_second = distances_to_epipole(in_second, correspondences.second) >= EPIPOLE_DISTANCE_PX
    return np.asarray(far_in_first & far_in_second)


def depth(first: Floats, depths: Floats) -> Mask:
    """Keep points with depths like those of their neighbours."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    keep = np.asarray(np.isfinite(depths) & (depths != 0))
    if not keep.any():
        return keep
    inverse = 1.0 / depths[keep]
    inverse /= np.median(np.abs(inverse))
    usual, around = _like_neighbours(first[keep], inverse[:, None], DEPTH_SHARE, DEPTH_SPREADS)
    # Drop islands, small groups of points behind nearly all the points around them.
    inverse = inverse[usual]
    a, b = around.point, around.neighbour
    together = np.abs(inverse[a] - inverse[b]) <= ISLAND_GAP
    links = coo_array((together[together], (a[together], b[together])), shape=(len(inverse),) * 2)
    group = connected_components(links, directed=False)[1].astype(np.int64)
    small = np.bincount(group) <= int(ISLAND_SHARE * len(inverse))
    shore = group[a] != group[b]
    group_a, weight = group[a[shore]], around.weight[shore]
    nearer = inverse[b[shore]] > inverse[a[shore]]
    total = np.bincount(group_a, weight, len(small))
    behind = np.bincount(group_a, weight * nearer, len(small)) >= MOSTLY * np.maximum(total, 1e-300)
    usual[usual] = ~(small & behind)[group]
    keep[keep] = usual
    return keep


def _like_neighbours(
    points: Floats, values: Floats, limit: float, num_spreads: float
) -> tuple[Mask, Neighbours]:
    """Drop values (N, D) unlike those around until none is left; return the mask and the neighbours."""
    keep = np.ones(len(points), dtype=bool)
    while True:
        some, around = values[keep], delaunay_neighbours(points[keep])
        columns = [_median_around(around, column[around.neighbour], len(some)) for column in some.T]
        median = np.stack(columns, axis=1)
        difference = np.sqrt(((some - median) ** 2).sum(axis=1))
        offsets = some[around.neighbour] - median[around.point]
        spread = _median_around(around, np.sqrt((offsets**2).sum(axis=1)), len(some))
        with np.errstate(invalid="ignore"):
            aberrant = difference > limit + num_spreads * spread
        if not aberrant.any():
            return keep, around
        keep[np.flatnonzero(keep)[aberrant]] = False


def _median_around(around: Neighbours, of_neighbours: Floats, num_points: int) -> Floats:
    return weighted_median(of_neighbours, around.point, around.weight, num_points)


def delaunay_neighbours(points: Floats) -> Neighbours:
    """Return the neighbours of points in a Delaunay triangulation."""
    from scipy.spatial import Delaunay, QhullError

    try:
        starts, neighbour = Delaunay(points).vertex_neighbor_vertices
        point = np.repeat(np.arange(len(points)), np.diff(starts))
    except (QhullError, ValueError):
        order = np.lexsort(points.T)
        point = np.concatenate([order[:-1], order[1:]])
        neighbour = np.concatenate([order[1:], order[:-1]])
    by_point = np.lexsort((neighbour, point))
    point, neighbour = point[by_point].astype(np.int64), neighbour[by_point].astype(np.int64)
    offset = points[neighbour] - points[point]
    return Neighbours(point, neighbour, 1.0 / np.maximum(np.sqrt((offset**2).sum(axis=1)), 1e-9))


def weighted_median(values: Floats, point: Integers, weight: Floats, num_points: int) -> Floats:
    """Return weighted medians of values, each listed with the index of its point."""
    medians = np.full(num_points, np.nan)
    order = np.lexsort((values, point))
    point, values, weight = point[order], values[order], weight[order]
    starts = np.flatnonzero(np.diff(point, prepend=-1))
    if len(starts) == 0:
        return medians
    lengths = np.diff(starts, append=len(point))
    summed = np.cumsum(weight)
    before = np.repeat(summed[starts] - weight[starts], lengths)
    total = np.repeat(np.add.reduceat(weight, starts), lengths)
    half = np.flatnonzero(2.0 * (summed - before) >= total * (1.0 - 1e-9))
    which, position = np.unique(point[half], return_index=True)
    medians[which] = values[half[position]]
    return medians
