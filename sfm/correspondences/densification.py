"""Matches for corners that were not similar enough at first, where geometry and neighbours expect them."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sfm.correspondences import outliers
from sfm.correspondences.epipolar_search import EpipolarSearch, far_from, gradient_directions
from sfm.correspondences.subpixel import RefinementSettings, inside, refine, window
from sfm.estimation.epipolar import distances_in_second
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DensificationSettings:
    """When two corners match that were not similar enough at first."""

    num_neighbours: int = 8  # correspondences whose weighted median predicts a motion
    reach_px: float = 3.0  # how far from the predicted position a corner may always be
    # how much farther where the neighbours disagree, in weighted medians of their differences
    reach_spreads: float = 1.5
    max_reach_px: float = 10.0  # bound on both
    epipolar_px: float = 0.7  # largest symmetric epipolar distance after refinement
    min_error: float = 5.0  # mean squared error that noise and sampling alone can cause, squared luma levels
    error_share: float = 0.1  # largest error beyond, as a share of the variance of the neighbourhood
    # sub-pixel refinement
    refinement: RefinementSettings = field(default_factory=lambda: RefinementSettings(affine=True))

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.num_neighbours < 2 or not 0 < self.reach_px <= self.max_reach_px:
            raise ValueError(f"`num_neighbours`, `reach_px` or `max_reach_px` is out of range: {self}")


def densify(
    search: EpipolarSearch,
    corners0: Floats,
    corners1: Floats,
    correspondences: Correspondences,
    settings: DensificationSettings | None = None,
) -> Correspondences:
    """Match the corners that are left, where their neighbours' motion and epipolar geometry expect them."""
    settings = settings or DensificationSettings()
    if len(correspondences) < settings.num_neighbours or not search.usable:
        return correspondences
    free0 = corners0[far_from(corners0, correspondences.first, 1.5)]
    free1 = corners1[far_from(corners1, correspondences.second, settings.refinement.max_shift_px)]
    if len(free0) == 0 or len(free1) == 0:
        return correspondences
    i, j = _expected_pairs(free0, free1, correspondences, settings)
    # The test below lets a point be this far from its line, and refinement moves it at most so far.
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
    kept = np.flatnonzero(success)
    kept = kept[outliers.unicity(i[kept], j[kept], error[kept], limit[kept])]
    new = search.settle_on_surfaces(candidates[kept])
    return Correspondences.concatenate([correspondences, new])


def _expected_pairs(
    free0: Floats, free1: Floats, known: Correspondences, settings: DensificationSettings
) -> tuple[Indices, Indices]:
    """Pair corners with those around the position that the weighted median of known motions predicts."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(known.first).query(free0, k=settings.num_neighbours)
    point = np.repeat(np.arange(len(free0)), settings.num_neighbours)
    weight = 1.0 / np.maximum(distance.ravel(), 1e-9)
    motions = known.motion[nearest.ravel()]

    def median(values: Floats) -> Floats:
        return outliers.weighted_median(values, point, weight, len(free0))

    predicted = np.stack([median(column) for column in motions.T], axis=1)
    difference = motions - predicted[point]
    spread = median(np.sqrt((difference**2).sum(axis=1)))
    reach = np.minimum(settings.reach_px + settings.reach_spreads * spread, settings.max_reach_px)
    lists = cKDTree(free1).query_ball_point(free0 + predicted, reach, return_sorted=True)
    i = np.repeat(np.arange(len(free0)), [len(found) for found in lists])
    j = np.array([k for found in lists for k in found], dtype=np.int64)
    return i, j


def neighbourhood_variances(luma: Image, points: Floats, radius_px: int) -> Floats:
    """Variances of neighbourhoods around whole pixels; zero where they leave the frame."""
    variances = np.zeros(len(points))
    room = inside(points, luma, radius_px)
    offset = np.arange(-radius_px, radius_px + 1)
    x, y = points[room].astype(np.int64).T
    square = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].astype(np.float64)
    variances[room] = square.var(axis=(1, 2))
    return variances


@dataclass(frozen=True)
class PropagationSettings:
    """How correspondences spread along edges."""

    canny_low: float = 6.0  # thresholds of the edge detector on Sobel gradients, 4 to a luma level per pixel
    canny_high: float = 18.0
    reach_px: int = 4  # edge points this near a known correspondence are tried
    num_tries: int = 2  # how often one edge point may be tried from different neighbours
    min_sine: float = 0.3  # least sine of the angle between edge and epipolar line
    min_epipole_distance_px: float = 12.0  # edge points nearer to the epipole are left out

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.reach_px, self.num_tries) < 1:
            raise ValueError(f"`reach_px` and `num_tries` must be at least 1, got {self}")


def propagate(
    search: EpipolarSearch, correspondences: Correspondences, settings: PropagationSettings | None = None
) -> Correspondences:
    """Spread correspondences along the edges of the first key frame, under the epipolar constraint."""
    from sfm.correspondences import _kernels

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
    end = _kernels.propagate(
        search.pair,
        tries,
        settings.reach_px,
        window(search.settings.radius_px),
        search.line_search,
        _kernels.ErrorLimit(search.settings.min_error, search.settings.error_share),
        num_seeds,
        _kernels.Points(first, second, error),
    )
    added = slice(num_seeds, end)
    new = search.settle_sides(first[added].copy(), second[added].copy(), error[added])
    new = new[far_from(new.first, seeds.first, 0.5)]
    return Correspondences.concatenate([correspondences, new])


def find_edges(luma: Image, settings: PropagationSettings) -> Mask:
    """Find edges with Canny's detector."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    return np.asarray(cv2.Canny(smooth, settings.canny_low, settings.canny_high, L2gradient=True) > 0)


def _crossing_edges(search: EpipolarSearch, settings: PropagationSettings) -> Mask:
    """Choose edge points that are far from the epipole and on edges that epipolar lines cross."""
    edges, normals = find_edges(search.luma0, settings), gradient_directions(search.luma0)
    epipole = search.epipole
    rows, columns = np.indices(edges.shape)
    x, y = epipole[0] - columns * epipole[2], epipole[1] - rows * epipole[2]
    length = np.sqrt(x * x + y * y)
    far = length >= settings.min_epipole_distance_px * abs(epipole[2])
    across = np.abs(normals[..., 0] * x + normals[..., 1] * y) >= settings.min_sine * length
    return np.asarray(edges & far & across)
