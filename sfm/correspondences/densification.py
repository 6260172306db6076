"""More correspondences under known epipolar geometry: remaining corners, and edges of the first key frame."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from sfm.correspondences import outliers
from sfm.correspondences.epipolar_search import (
    EpipolarSearch,
    KeyPair,
    LineSearch,
    Points,
    far_from,
    follow,
    gradient_directions,
)
from sfm.correspondences.subpixel import RefinementSettings, inside, refine, window
from sfm.estimation.epipolar import distances_in_second
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DensificationSettings:
    """Limits for matches of corners that were not similar enough at first."""

    num_neighbours: int = 8  # correspondences that predict a motion by their weighted median
    reach_px: float = 3.0  # distance from the predicted position that is always allowed
    # additional distance, in weighted medians of the neighbours' differences
    reach_spreads: float = 1.5
    max_reach_px: float = 10.0  # bound on both
    epipolar_px: float = 0.7  # largest symmetric epipolar distance after refinement
    min_error: float = 5.0  # mean squared error due to noise and sampling, squared luma levels
    error_share: float = 0.1  # largest additional error, as a share of the neighbourhood's variance
    refinement: RefinementSettings = field(default_factory=lambda: RefinementSettings(affine=True))

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.num_neighbours < 2 or not 0 < self.reach_px <= self.max_reach_px:
            raise ValueError(f"`num_neighbours`, `reach_px` or `max_reach_px` is out of range: {self}")


@dataclass(frozen=True)
class PropagationSettings:
    """Parameters of the propagation along edges."""

    canny_low: float = 6.0  # thresholds of the edge detector on Sobel gradients, 4 to a luma level per pixel
    canny_high: float = 18.0
    reach_px: int = 4  # edge points this near a correspondence are tried
    num_tries: int = 2  # number of attempts at an edge point, from different neighbours
    min_sine: float = 0.3  # least sine of the angle between edge and epipolar line
    min_epipole_distance_px: float = 12.0  # edge points nearer to the epipole are left out

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.reach_px, self.num_tries) < 1:
            raise ValueError(f"`reach_px` and `num_tries` must be at least 1, got {self}")


def densify(
    search: EpipolarSearch,
    corners0: Floats,
    corners1: Floats,
    correspondences: Correspondences,
    settings: DensificationSettings | None = None,
) -> Correspondences:
    """Match the remaining corners at the positions that neighbours' motion and epipolar geometry predict."""
    settings = settings or DensificationSettings()
    if len(correspondences) < settings.num_neighbours or not search.usable:
        return correspondences
    free0 = corners0[far_from(corners0, correspondences.first, 1.5)]
    free1 = corners1[far_from(corners1, correspondences.second, settings.refinement.max_shift_px)]
    if len(free0) == 0 or len(free1) == 0:
        return correspondences
    i, j = _expected_pairs(free0, free1, correspondences, settings)
    # Distance from its line that the test below allows a point, and the longest move of the refinement.
    reach = math.sqrt(2.0) * settings.epipolar_px + settings.refinement.max_shift_px
    within = distances_in_second(search.fundamental, free0[i], free1[j]) <= reach
    i, j = i[within], j[within]
    first, start = free0[i], free1[j]
    shapes = search.facing_similarities(first, start)
    second, error, success = refine(search.luma0, search.luma1, first, start, settings.refinement, shapes)
    variances = neighbourhood_variances(search.luma0, first, settings.refinement.radius_px)
    limit = settings.min_error + settings.error_share * variances
    candidates = Correspondences(first, second, error)
    success &= outliers.mse(error, limit)
    success &= outliers.epipolar(candidates, search.fundamental, settings.epipolar_px)
    chosen = np.flatnonzero(success)
    chosen = chosen[outliers.unicity(i[chosen], j[chosen], error[chosen], limit[chosen])]
    new = search.settle_on_surfaces(candidates[chosen])
    return Correspondences.concatenate([correspondences, new])


def _expected_pairs(
    free0: Floats, free1: Floats, matched: Correspondences, settings: DensificationSettings
) -> tuple[Indices, Indices]:
    """Pair corners with corners around the position that the weighted median of motions predicts."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(matched.first).query(free0, k=settings.num_neighbours)
    point = np.repeat(np.arange(len(free0)), settings.num_neighbours)
    weight = 1.0 / np.maximum(distance.ravel(), 1e-9)
    motions = matched.motion[nearest.ravel()]

    def median(values: Floats) -> Floats:
        return outliers.weighted_median(values, point, weight, len(free0))

    predicted = np.stack([median(column) for column in motions.T], axis=1)
    difference = motions - predicted[point]
    spread = median(np.sqrt((difference**2).sum(axis=1)))
    reach = np.minimum(settings.reach_px + settings.reach_spreads * spread, settings.max_reach_px)
    lists = cKDTree(free1).query_ball_point(free0 + predicted, reach, return_sorted=True)
    i = np.repeat(np.arange(len(free0)), [len(each) for each in lists])
    j = np.array([k for each in lists for k in each], dtype=np.int64)
    return i, j


def neighbourhood_variances(luma: Image, points: Floats, radius_px: int) -> Floats:
    """Return the variances of neighbourhoods around whole pixels; zero if they leave the frame."""
    variances = np.zeros(len(points))
    room = inside(points, luma, radius_px)
    offset = np.arange(-radius_px, radius_px + 1)
    x, y = points[room].astype(np.int64).T
    square = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].astype(np.float64)
    variances[room] = square.var(axis=(1, 2))
    return variances


def propagate(
    search: EpipolarSearch, correspondences: Correspondences, settings: PropagationSettings | None = None
) -> Correspondences:
    """Spread correspondences along the edges of the first key frame, under the epipolar constraint."""
    settings = settings or PropagationSettings()
    seeds = correspondences[search.inside_both(correspondences)]
    if len(seeds) == 0 or not search.usable:
        return correspondences
    tries = np.where(_crossing_edges(search, settings), settings.num_tries, 0)
    num_seeds, room = len(seeds), len(seeds) + tries.size
    first, second, error = np.empty((room, 2), dtype=np.int64), np.empty((room, 2)), np.empty(room)
    first[:num_seeds] = np.rint(seeds.first)
    second[:num_seeds] = first[:num_seeds] + seeds.motion
    tries[first[:num_seeds, 1], first[:num_seeds, 0]] = 0
    weights, points = window(search.settings.radius_px), Points(first, second, error)
    end = spread(search.pair, tries, settings.reach_px, weights, search.line_search(), num_seeds, points)
    added = slice(num_seeds, end)
    new = search.settle_sides(first[added].copy(), second[added].copy(), error[added])
    new = new[far_from(new.first, seeds.first, 0.5)]
    return Correspondences.concatenate([correspondences, new])


def find_edges(luma: Image, settings: PropagationSettings) -> Mask:
    """Return a mask of edges by Canny's detector."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    return np.asarray(cv2.Canny(smooth, settings.canny_low, settings.canny_high, L2gradient=True) > 0)


def _crossing_edges(search: EpipolarSearch, settings: PropagationSettings) -> Mask:
    """Return a mask of edge points far from the epipole, on edges that epipolar lines cross."""
    edges, normals = find_edges(search.luma0, settings), gradient_directions(search.luma0)
    epipole = search.epipole
    rows, columns = np.indices(edges.shape)
    x, y = epipole[0] - columns * epipole[2], epipole[1] - rows * epipole[2]
    length = np.sqrt(x * x + y * y)
    far = length >= settings.min_epipole_distance_px * abs(epipole[2])
    across = np.abs(normals[..., 0] * x + normals[..., 1] * y) >= settings.min_sine * length
    return np.asarray(edges & far & across)


@kernel
def spread(
    pair: KeyPair,
    open_tries: Indices,
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
