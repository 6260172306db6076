"""Correspondences of two key frames: corners matched one to one, then more under known epipolar geometry."""

import math
from typing import NamedTuple

import numpy as np

from dvc._jit import inlined_kernel, kernel
from dvc.arrays import Bytes, Floats, Integers, Mask
from dvc.corners import SENSITIVITY, SOBEL_GAIN, corner_response, is_local_max
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
from sfm.correspondences.subpixel import MAX_SHIFT_PX, check_pair, inside, refine, window
from sfm.correspondences.subpixel import RADIUS_PX as REFINED_RADIUS_PX
from sfm.estimation.epipolar import distances_in_second
from sfm.scene_model import Correspondences

NUM_CORNERS = 2400
BORDER_PX = 8
"""Least distance of a corner from the frame's edge, so that neighbourhoods fit."""
BINOMIAL = (1, 2, 1)
"""Weights of the window over which the structure tensor is averaged."""
SEPARATION_PX = 1
"""Distance within which a corner is the strongest, by rows and by columns."""
MIN_GRADIENT = 1.0
"""Gradient with a response of noise, luma levels per pixel."""
ROBUSTNESS = 0.9
"""Share of a neighbour's response that suppresses a corner if it is larger."""
MAX_MOTION_SHARE = 0.25
"""Largest motion, as a share of the frame's longer side."""
CORNER_RADIUS_PX = 6
"""Half size of the neighbourhoods compared at whole pixels."""
MAX_BRIGHTNESS_CHANGE = 40.0
"""Largest difference of the mean luma of two neighbourhoods, levels."""
BIN_WIDTH = 12.0
"""Distance of the samples of intensity distributions, luma levels."""
NUM_BINS = 16
"""Number of samples; intensities beyond the ends count for the outermost."""
MAX_CHI_SQUARE_SHARE = 0.2
"""Largest chi-square of two distributions, as a share of that of distributions without overlap."""
NUM_CANDIDATES = 3
"""Number of most similar corners of the second frame that are refined, per corner of the first."""
MIN_MATCH_ERROR, MIN_ERROR = 4.0, 5.0
"""Mean squared errors due to noise and sampling, of corners and of later matches, squared luma levels."""
MATCH_ERROR_SHARE, SHIFTED_ERROR_SHARE, REFINED_ERROR_SHARE = 0.6, 0.4, 0.12
"""Largest additional errors at whole pixels, after refinement of the position, and of position and shape, as
shares of the neighbourhood's variance."""
MAX_AMBIGUITY = 0.7
"""Largest quotient of the errors of the most similar corner and the next one, plus `MIN_MATCH_ERROR` each."""
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


def detect_corners(luma: Bytes, num_corners: int = NUM_CORNERS) -> Floats:
    """Detect Harris-Stephens corners (N, 2) by adaptive non-maximal suppression."""
    if luma.ndim != 2 or luma.dtype != np.uint8:
        raise ValueError(f"`luma` must have shape (H, W) and dtype uint8, got {luma.shape}, {luma.dtype}")
    response = corner_response(luma, list(BINOMIAL), SENSITIVITY) / (SOBEL_GAIN * sum(BINOMIAL)) ** 4
    corner = is_local_max(response, SEPARATION_PX) & (response >= MIN_GRADIENT**4)
    (bottom, right), (y, x) = np.subtract(luma.shape, BORDER_PX), np.nonzero(corner)
    interior = (y >= BORDER_PX) & (y < bottom) & (x >= BORDER_PX) & (x < right)
    y, x = y[interior], x[interior]
    order = np.argsort(-response[y, x], kind="stable")
    x, y = x[order], y[order]
    strength = response[y, x]
    radii_px2 = np.empty(len(x), dtype=np.int64)
    suppression_radii(x, y, strength, radii_px2)
    chosen = np.argsort(-radii_px2, kind="stable")[:num_corners]
    return np.column_stack([x[chosen], y[chosen]]).astype(np.float64)


@kernel
def suppression_radii(x: Integers, y: Integers, strength: Floats, radii_px2: Integers) -> None:
    """Measure squared distances to the nearest clearly stronger maximum; `strength` is in falling order."""
    for i in range(x.size):
        radii_px2[i] = np.int64(1) << 40
        for j in range(i):
            if strength[j] * ROBUSTNESS <= strength[i]:
                break
            radii_px2[i] = min(radii_px2[i], (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)


class DescribedCorners(NamedTuple):
    """Corners of a key frame with their descriptions."""

    positions: Floats  # (N, 2)
    patches: Bytes  # (N, S), samples of the neighbourhoods
    means: Floats
    histograms: Floats


def match_corners(luma0: Bytes, luma1: Bytes, corners0: Floats, corners1: Floats) -> Correspondences:
    """Match the corners of two key frames."""
    check_pair(luma0, luma1)
    corners0 = corners0[inside(corners0, luma0, CORNER_RADIUS_PX)]
    corners1 = corners1[inside(corners1, luma1, CORNER_RADIUS_PX)]
    if len(corners0) == 0 or len(corners1) == 0:
        return Correspondences.empty()
    described = describe(luma0, corners0)
    num_samples, variances = described.patches.shape[1], described.patches.var(axis=1)
    candidates = np.full((len(corners0), NUM_CANDIDATES), -1, dtype=np.int64)
    best_candidates(
        described,
        describe(luma1, corners1),
        MAX_MOTION_SHARE * max(luma0.shape),
        num_samples * (MIN_MATCH_ERROR + MATCH_ERROR_SHARE * variances),
        candidates,
        np.empty(candidates.shape),
    )
    i, rank = np.nonzero(candidates >= 0)
    j, variance = candidates[i, rank], variances[i]
    second = corners1[j]
    for affine, share in ((False, SHIFTED_ERROR_SHARE), (True, REFINED_ERROR_SHARE)):
        largest = MIN_MATCH_ERROR + share * variance
        second, error, success = refine(luma0, luma1, corners0[i], second, affine=affine)
        success &= outliers.mse(error, largest)
        i, j, variance = i[success], j[success], variance[success]
        second, error, largest = second[success], error[success], largest[success]
    # Pairs must be clearly more similar than any other pair of the same first corner.
    order = np.lexsort((error, i))
    i_sorted, error_sorted = i[order], error[order] + MIN_MATCH_ERROR
    next_error = np.append(np.where(i_sorted[1:] == i_sorted[:-1], error_sorted[1:], np.inf), np.inf)
    clear = np.empty(len(i), dtype=bool)
    clear[order] = (np.diff(i_sorted, prepend=-1) != 0) & (error_sorted <= MAX_AMBIGUITY * next_error)
    chosen = outliers.unicity(i, j, error, largest) & clear
    return Correspondences(corners0[i[chosen]], second[chosen], error[chosen])


def describe(luma: Bytes, corners: Floats) -> DescribedCorners:
    """Cut out neighbourhoods of corners, with means and densities of intensity (triangular windows)."""
    offset = np.arange(-CORNER_RADIUS_PX, CORNER_RADIUS_PX + 1)
    x, y = corners.astype(np.int64).T
    patches = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].reshape(len(corners), -1)
    means, last = patches.mean(axis=1), NUM_BINS - 1
    position = np.clip((patches - means[:, None]) / BIN_WIDTH + 0.5 * last, 0.0, last)
    left = np.minimum(position.astype(np.int64), last - 1)
    bins = NUM_BINS * np.arange(len(corners))[:, None] + left
    shares = np.stack([left + 1 - position, position - left], axis=-1)
    size = len(corners) * NUM_BINS
    histograms = np.bincount(np.stack([bins, bins + 1], axis=-1).ravel(), shares.ravel(), size)
    return DescribedCorners(corners, patches, means, np.asarray(histograms.reshape(len(corners), -1), float))


@kernel
def best_candidates(
    first: DescribedCorners,
    second: DescribedCorners,
    max_motion_px: float,
    limits: Floats,
    chosen: Integers,
    errors: Floats,
) -> None:
    """Choose the most similar corners within the motion bound, by rising error; -1 fills the rows."""
    corners_a, patches_a, means_a, histograms_a = first
    corners_b, patches_b, means_b, histograms_b = second
    count, max_chi_square = chosen.shape[1], MAX_CHI_SQUARE_SHARE * patches_a.shape[1]
    for i in range(corners_a.shape[0]):
        num_chosen = 0
        for j in range(corners_b.shape[0]):
            dx, dy = corners_b[j, 0] - corners_a[i, 0], corners_b[j, 1] - corners_a[i, 1]
            if dx * dx + dy * dy > max_motion_px * max_motion_px:
                continue
            brighter = means_a[i] - means_b[j]
            if abs(brighter) > MAX_BRIGHTNESS_CHANGE:
                continue
            limit = min(limits[i], errors[i, count - 1]) if num_chosen == count else limits[i]
            error = sum_of_squares(patches_a[i], patches_b[j]) - patches_a.shape[1] * brighter * brighter
            if error > limit or chi_square(histograms_a[i], histograms_b[j]) > max_chi_square:
                continue
            rank = min(num_chosen, count - 1)
            while rank > 0 and errors[i, rank - 1] > error:
                errors[i, rank] = errors[i, rank - 1]
                chosen[i, rank] = chosen[i, rank - 1]
                rank -= 1
            errors[i, rank] = error
            chosen[i, rank] = j
            num_chosen = min(num_chosen + 1, count)


@kernel
def chi_square(a: Floats, b: Floats) -> float:
    """Half the sum of (a - b)^2 / (a + b): from 0 (the same) to the number of samples (nothing shared)."""
    total = 0.0
    for k in range(a.size):
        both = a[k] + b[k]
        if both > 0.0:
            total += (a[k] - b[k]) ** 2 / both
    return 0.5 * total


@inlined_kernel
def sum_of_squares(a: Bytes, b: Bytes) -> float:
    """Sum squared differences of samples; in 32 bits, so that the compiler vectorises the loop."""
    total = np.int32(0)
    for k in range(a.size):
        difference = np.int32(np.int32(a[k]) - np.int32(b[k]))
        total = np.int32(total + np.int32(difference * difference))
    return np.float64(total)


def densify(
    search: EpipolarSearch, corners0: Floats, corners1: Floats, correspondences: Correspondences
) -> Correspondences:
    """Match the remaining corners at the positions that neighbours' motion and epipolar geometry predict."""
    from scipy.spatial import cKDTree

    if len(correspondences) < NUM_NEIGHBOURS or not search.usable:
        return correspondences
    free0 = corners0[far_from(corners0, correspondences.first, 1.5)]
    free1 = corners1[far_from(corners1, correspondences.second, MAX_SHIFT_PX)]
    if len(free0) == 0 or len(free1) == 0:
        return correspondences
    # Pair corners with corners around the position that the weighted median of motions predicts.
    distance, nearest = cKDTree(correspondences.first).query(free0, k=NUM_NEIGHBOURS)
    point = np.repeat(np.arange(len(free0)), NUM_NEIGHBOURS)
    weight = 1.0 / np.maximum(distance.ravel(), 1e-9)
    motions = correspondences.motion[nearest.ravel()]

    def median(values: Floats) -> Floats:
        return outliers.weighted_median(values, point, weight, len(free0))

    predicted = np.stack([median(column) for column in motions.T], axis=1)
    difference = motions - predicted[point]
    around = np.minimum(REACH_PX + REACH_SPREADS * median(np.sqrt((difference**2).sum(axis=1))), MAX_REACH_PX)
    lists = cKDTree(free1).query_ball_point(free0 + predicted, around, return_sorted=True)
    i = np.repeat(np.arange(len(free0)), [len(each) for each in lists])
    j = np.array([k for each in lists for k in each], dtype=np.int64)
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
    # Edge points far from the epipole are tried, on edges that epipolar lines cross.
    edges, normals, epipole = find_edges(search.luma0), gradient_directions(search.luma0), search.epipole
    rows, columns = np.indices(edges.shape)
    x, y = epipole[0] - columns * epipole[2], epipole[1] - rows * epipole[2]
    length = np.sqrt(x * x + y * y)
    far = length >= MIN_EPIPOLE_DISTANCE_PX * abs(epipole[2])
    across = np.abs(normals[..., 0] * x + normals[..., 1] * y) >= MIN_SINE * length
    tries = np.where(edges & far & across, NUM_TRIES, 0)
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
