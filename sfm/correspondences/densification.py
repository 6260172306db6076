"""More correspondences under known epipolar geometry: remaining corners, and edges of the first key frame."""

import math

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers, Mask
from sfm.correspondences import outliers
from sfm.correspondences.epipolar_search import (
    RADIUS_PX,
    EpipolarSearch,
    KeyPair,
    LineSearch,
    Points,
    far_from,
    follow,
    gradient_directions,
)
from sfm.correspondences.subpixel import MAX_SHIFT_PX, inside, refine, window
from sfm.correspondences.subpixel import RADIUS_PX as REFINED_RADIUS_PX
from sfm.estimation.epipolar import distances_in_second
from sfm.scene_model import Correspondences

NUM_NEIGHBOURS = 8
"""Number of correspondences that predict a motion by their weighted median."""
REACH_PX = 3.0
"""Distance from the predicted position that is always allowed."""
REACH_SPREADS = 1.5
"""Additional distance, in weighted medians of the neighbours' differences."""
MAX_REACH_PX = 10.0
"""Largest distance from the predicted position."""
EPIPOLAR_PX = 0.7
"""Largest symmetric epipolar distance after refinement."""
MIN_ERROR = 5.0
"""Mean squared error due to noise and sampling, squared luma levels."""
ERROR_SHARE = 0.1
"""Largest additional error, as a share of the neighbourhood's variance."""
CANNY = (6.0, 18.0)
"""Thresholds of the edge detector on Sobel gradients, 4 to a luma level per pixel."""
EDGE_REACH_PX = 4
"""Distance from a correspondence within which edge points are tried."""
NUM_TRIES = 2
"""Number of attempts at an edge point, from different neighbours."""
MIN_SINE = 0.3
"""Least sine of the angle between edge and epipolar line."""
MIN_EPIPOLE_DISTANCE_PX = 12.0
"""Distance from the epipole below which edge points are left out."""


def densify(
    search: EpipolarSearch, corners0: Floats, corners1: Floats, correspondences: Correspondences
) -> Correspondences:
    """Match the remaining corners at the positions that neighbours' motion and epipolar geometry predict."""
    if len(correspondences) < NUM_NEIGHBOURS or not search.usable:
        return correspondences
    free0 = corners0[far_from(corners0, correspondences.first, 1.5)]
    free1 = corners1[far_from(corners1, correspondences.second, MAX_SHIFT_PX)]
    if len(free0) == 0 or len(free1) == 0:
        return correspondences
    i, j = _expected_pairs(free0, free1, correspondences)
    # Distance from its line that the test below allows a point, and the longest move of the refinement.
    reach = math.sqrt(2.0) * EPIPOLAR_PX + MAX_SHIFT_PX
    within = distances_in_second(search.fundamental, free0[i], free1[j]) <= reach
    i, j = i[within], j[within]
    first, start = free0[i], free1[j]
    shapes = search.facing_similarities(first, start)
    second, error, success = refine(search.luma0, search.luma1, first, start, affine=True, shapes=shapes)
    variances = neighbourhood_variances(search.luma0, first, REFINED_RADIUS_PX)
    limit = MIN_ERROR + ERROR_SHARE * variances
    candidates = Correspondences(first, second, error)
    success &= outliers.mse(error, limit)
    success &= outliers.epipolar(candidates, search.fundamental, EPIPOLAR_PX)
    chosen = np.flatnonzero(success)
    chosen = chosen[outliers.unicity(i[chosen], j[chosen], error[chosen], limit[chosen])]
    new = search.settle_on_surfaces(candidates[chosen])
    return Correspondences.concatenate([correspondences, new])


def _expected_pairs(free0: Floats, free1: Floats, matched: Correspondences) -> tuple[Integers, Integers]:
    """Pair corners with corners around the position that the weighted median of motions predicts."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(matched.first).query(free0, k=NUM_NEIGHBOURS)
    point = np.repeat(np.arange(len(free0)), NUM_NEIGHBOURS)
    weight = 1.0 / np.maximum(distance.ravel(), 1e-9)
    motions = matched.motion[nearest.ravel()]

    def median(values: Floats) -> Floats:
        return outliers.weighted_median(values, point, weight, len(free0))

    predicted = np.stack([median(column) for column in motions.T], axis=1)
    difference = motions - predicted[point]
    spread = median(np.sqrt((difference**2).sum(axis=1)))
    reach = np.minimum(REACH_PX + REACH_SPREADS * spread, MAX_REACH_PX)
    lists = cKDTree(free1).query_ball_point(free0 + predicted, reach, return_sorted=True)
    i = np.repeat(np.arange(len(free0)), [len(each) for each in lists])
    j = np.array([k for each in lists for k in each], dtype=np.int64)
    return i, j


def neighbourhood_variances(luma: Bytes, points: Floats, radius_px: int) -> Floats:
    """Return the variances of neighbourhoods around whole pixels; zero if they leave the frame."""
    variances = np.zeros(len(points))
    room = inside(points, luma, radius_px)
    offset = np.arange(-radius_px, radius_px + 1)
    x, y = points[room].astype(np.int64).T
    square = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].astype(np.float64)
    variances[room] = square.var(axis=(1, 2))
    return variances


def propagate(search: EpipolarSearch, correspondences: Correspondences) -> Correspondences:
    """Spread correspondences along the edges of the first key frame, under the epipolar constraint."""
    seeds = correspondences[search.inside_both(correspondences)]
    if len(seeds) == 0 or not search.usable:
        return correspondences
    tries = np.where(_crossing_edges(search), NUM_TRIES, 0)
    num_seeds, room = len(seeds), len(seeds) + tries.size
    first, second, error = np.empty((room, 2), dtype=np.int64), np.empty((room, 2)), np.empty(room)
    first[:num_seeds] = np.rint(seeds.first)
    second[:num_seeds] = first[:num_seeds] + seeds.motion
    tries[first[:num_seeds, 1], first[:num_seeds, 0]] = 0
    weights, points = window(RADIUS_PX), Points(first, second, error)
    end = spread(search.pair, tries, EDGE_REACH_PX, weights, LineSearch(), num_seeds, points)
    added = slice(num_seeds, end)
    new = search.settle_sides(first[added].copy(), second[added].copy(), error[added])
    new = new[far_from(new.first, seeds.first, 0.5)]
    return Correspondences.concatenate([correspondences, new])


def find_edges(luma: Bytes) -> Mask:
    """Return a mask of edges by Canny's detector."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    return np.asarray(cv2.Canny(smooth, *CANNY, L2gradient=True) > 0)


def _crossing_edges(search: EpipolarSearch) -> Mask:
    """Return a mask of edge points far from the epipole, on edges that epipolar lines cross."""
    edges, normals = find_edges(search.luma0), gradient_directions(search.luma0)
    epipole = search.epipole
    rows, columns = np.indices(edges.shape)
    x, y = epipole[0] - columns * epipole[2], epipole[1] - rows * epipole[2]
    length = np.sqrt(x * x + y * y)
    far = length >= MIN_EPIPOLE_DISTANCE_PX * abs(epipole[2])
    across = np.abs(normals[..., 0] * x + normals[..., 1] * y) >= MIN_SINE * length
    return np.asarray(edges & far & across)


@kernel
def spread(
    pair: KeyPair,
    open_tries: Integers,
    reach_px: int,
    weights: Floats,
    search: LineSearch,
    num_seeds: int,
    points: Points,
) -> int:
    """Follow open pixels around matched points until none is added; return the number of matched points."""
    first, second, errors = points
    owner = np.full(open_tries.shape, -1, dtype=np.int64)
    distance_px2 = np.empty(open_tries.shape, dtype=np.int64)
    columns, rows = np.empty(open_tries.size, dtype=np.int64), np.empty(open_tries.size, dtype=np.int64)
    near, position = np.empty(2), np.empty(2)
    radius = weights.shape[0] // 2
    height, width = open_tries.shape
    begin, end = 0, num_seeds
    while begin < end:
        # List the open pixels within reach of the latest points, each owned by the nearest of them.
        count = 0
        for p in range(begin, end):
            column, row = first[p, 0], first[p, 1]
            left, right = max(column - reach_px, radius), min(column + reach_px + 1, width - radius)
            top, bottom = max(row - reach_px, radius), min(row + reach_px + 1, height - radius)
            for y in range(top, bottom):
                for x in range(left, right):
                    square = (x - column) ** 2 + (y - row) ** 2
                    if open_tries[y, x] <= 0 or square > reach_px * reach_px:
                        continue
                    if owner[y, x] < 0:
                        columns[count], rows[count] = x, y
                        count += 1
                    elif square >= distance_px2[y, x]:
                        continue
                    owner[y, x], distance_px2[y, x] = p, square
        begin = end
        for k in range(count):
            x, y = columns[k], rows[k]
            p = owner[y, x]
            owner[y, x] = -1
            open_tries[y, x] -= 1
            near[0], near[1] = x + second[p, 0] - first[p, 0], y + second[p, 1] - first[p, 1]
            error = follow(pair, x, y, near, weights, search, position)
            if error < np.inf:
                open_tries[y, x] = 0
                first[end, 0], first[end, 1] = x, y
                second[end, 0], second[end, 1], errors[end] = position[0], position[1], error
                end += 1
    return end
