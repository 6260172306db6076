"""Searches on epipolar lines: points of the first key frame in the second, and the surface of each."""

from typing import NamedTuple

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers, Mask
from sfm.correspondences.spline_sampling import (
    MARGIN,
    fits,
    half_pixel_samples,
    sample,
    spline,
    spline_weights,
)
from sfm.correspondences.subpixel import check_pair, inside, window
from sfm.estimation.epipolar import epipoles
from sfm.scene_model import Correspondences

RADIUS_PX = 3
"""Half size of the neighbourhoods compared."""
SIDE_DISTANCE_PX = 5.0
"""Distance from an edge of the two neighbourhoods that show its surface."""
SIDE_RADIUS_PX = 2
"""Half size of these neighbourhoods."""
SIDE_SEARCH_PX = 6.0
"""Half range of the search for a motion of these neighbourhoods."""
SIDE_RATIO = 1.2
"""Least quotient of the two sides' disagreement with the edge's motion."""
SETTLING_PX = 1.0
"""Half range of the search after a point has been moved to its side."""
GOLDEN_RATIO = 0.6180339887498949
CONFIRMED_PX = 0.5
"""Largest distance between the best positions of a corner's small and large neighbourhoods."""


class LineSearch(NamedTuple):
    """Range and precision of a search on an epipolar line, and the largest error of a match."""

    half_range_px: float = 2.0
    step_px: float = 0.5
    tolerance_px: float = 0.02  # precision of the golden-section search
    min_error: float = 8.0  # mean squared error due to noise and sampling, squared luma levels
    error_share: float = 0.06  # largest additional error, as a share of the neighbourhood's variance


class KeyPair(NamedTuple):
    """Two key frames and their epipolar geometry, as kernels take them."""

    image: Floats  # first frame
    coefficients: Floats  # spline of the second frame
    halves: Floats  # samples of the second frame, half a pixel apart
    fundamental: Floats
    epipole: Floats  # in the first frame


class Line(NamedTuple):
    """An epipolar line in the second key frame, and the map of neighbourhoods between the frames."""

    foot: Floats  # foot of the perpendicular from the expected position
    direction: Floats
    affine: Floats


class Points(NamedTuple):
    """Whole pixels of the first key frame, points of the second, and their mean squared errors."""

    first: Integers
    second: Floats
    errors: Floats


class EpipolarSearch:
    """Two key frames and their epipolar geometry, ready to be searched."""

    def __init__(self, luma0: Bytes, luma1: Bytes, fundamental: Floats) -> None:
        check_pair(luma0, luma1)
        self.luma0, self.luma1, self.fundamental = luma0, luma1, fundamental
        self.usable = bool(np.isfinite(fundamental).all() and np.abs(fundamental).max() > 0)
        self.epipole = epipoles(fundamental)[0] if self.usable else np.zeros(3)
        coefficients = spline(luma1)
        image, halves = luma0.astype(np.float64), half_pixel_samples(coefficients)
        self.pair = KeyPair(image, coefficients, halves, fundamental, self.epipole)

    def inside_both(self, correspondences: Correspondences) -> Mask:
        """Return a mask of correspondences that are finite and inside both frames."""
        first, second = correspondences.first, correspondences.second
        return correspondences.finite & inside(first, self.luma0, 0.0) & inside(second, self.luma0, 0.0)

    def facing_similarities(self, first: Floats, second: Floats) -> Floats:
        """Return how neighbourhoods turn and scale between the frames on surfaces that face the cameras."""
        affines = np.empty((len(first), 2, 2))
        similarities(self.fundamental, self.epipole, first, second, affines)
        return affines

    def settle_on_surfaces(self, correspondences: Correspondences) -> Correspondences:
        """Keep points that move like their surroundings, and move them to the surface they move with."""
        correspondences = correspondences[self.inside_both(correspondences)]
        if len(correspondences) == 0 or not self.usable:
            return correspondences
        first, again = np.rint(correspondences.first).astype(np.int64), correspondences.second.copy()
        error, small = np.empty(len(first)), window(SIDE_RADIUS_PX)
        any_error = LineSearch(min_error=np.inf, error_share=0.0)
        follow_all(self.pair, Points(first, again, error), small, any_error)
        moved = np.sqrt(((again - correspondences.second) ** 2).sum(axis=1))
        same = np.isfinite(error) & (moved <= CONFIRMED_PX)
        chosen = correspondences[same]
        return self.settle_sides(first[same], chosen.second, chosen.error)

    def settle_sides(self, first: Integers, second: Floats, error: Floats) -> Correspondences:
        """Move points next to the surface that they move with on to it by a pixel, and search them again."""
        scores, small = np.empty((len(first), 2)), window(SIDE_RADIUS_PX)
        normals = gradient_directions(self.luma0)[first[:, 1], first[:, 0]]
        disagreement(self.pair, first, second, normals, SIDE_DISTANCE_PX, small, SIDE_SEARCH_PX, scores)
        plus, minus = np.nan_to_num(scores, nan=1.0).T
        sign = np.where((minus > 1.0) & (minus > SIDE_RATIO * plus), 1, 0)
        sign -= (plus > 1.0) & (plus > SIDE_RATIO * minus)
        moved = np.flatnonzero(sign)
        step = np.rint(1.2 * sign[moved, None] * normals[moved]).astype(np.int64)
        points = Points(first[moved] + step, second[moved] + step, np.empty(len(moved)))
        follow_all(self.pair, points, window(RADIUS_PX), LineSearch(SETTLING_PX))
        first, second, error = first.copy(), second.copy(), error.copy()
        first[moved], second[moved], error[moved] = points
        order = np.argsort(error, kind="stable")
        order = order[np.isfinite(error[order])]
        _, once = np.unique(first[order], axis=0, return_index=True)
        chosen = np.sort(order[once])
        return Correspondences(first[chosen].astype(np.float64), second[chosen], error[chosen])


def gradient_directions(luma: Bytes) -> Floats:
    """Return the directions of the gradient of a blurred frame, shape (H, W, 2)."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)], axis=-1)
    length = np.sqrt((gradient**2).sum(axis=-1, keepdims=True))
    return np.asarray(gradient / np.maximum(length, 1e-9))


def far_from(points: Floats, obstacles: Floats, distance_px: float) -> Mask:
    """Return a mask of points farther than a distance from all obstacles."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(obstacles).query(points)[0] > distance_px)


@kernel
def follow_all(pair: KeyPair, points: Points, weights: Floats, search: LineSearch) -> None:
    """Search every point again from its position, in place; the error is inf if the search fails."""
    first, second, errors = points
    position = np.empty(2)
    height, width = pair.image.shape
    for i in range(first.shape[0]):
        x, y = first[i, 0], first[i, 1]
        errors[i] = np.inf
        if fits(float(x), float(y), weights.shape[0] // 2, width, height):
            errors[i] = follow(pair, x, y, second[i], weights, search, position)
        if errors[i] < np.inf:
            second[i, 0], second[i, 1] = position[0], position[1]


@kernel
def follow(
    pair: KeyPair, x: int, y: int, near: Floats, weights: Floats, search: LineSearch, position: Floats
) -> float:
    """Search the point at pixel (x, y) on its epipolar line: steps around `near`, then golden sections."""
    radius, step_px = weights.shape[0] // 2, search.step_px
    line = Line(np.empty(2), np.empty(2), np.empty((2, 2)))
    if not epipolar_frame(pair.fundamental, pair.epipole, float(x), float(y), near[0], near[1], line):
        return np.inf
    target = pair.image[y - radius : y + radius + 1, x - radius : x + radius + 1]
    half, best = int(np.ceil(search.half_range_px / step_px)), 0
    errors = np.empty(2 * half + 1)
    for k in range(2 * half + 1):
        errors[k] = rough_error(target, pair.halves, line, (k - half) * step_px, weights)
        if errors[k] < errors[best]:
            best = k
    if best == 0 or best == 2 * half or not (errors[best - 1] < np.inf and errors[best + 1] < np.inf):
        return np.inf
    low, high = (best - half - 1) * step_px, (best - half + 1) * step_px
    a, b = high - GOLDEN_RATIO * (high - low), low + GOLDEN_RATIO * (high - low)
    error_a = neighbourhood_error(target, pair.coefficients, line, a, weights)
    error_b = neighbourhood_error(target, pair.coefficients, line, b, weights)
    while high - low > search.tolerance_px:
        if error_a <= error_b:
            high, b, error_b = b, a, error_a
            a = high - GOLDEN_RATIO * (high - low)
            error_a = neighbourhood_error(target, pair.coefficients, line, a, weights)
        else:
            low, a, error_a = a, b, error_b
            b = low + GOLDEN_RATIO * (high - low)
            error_b = neighbourhood_error(target, pair.coefficients, line, b, weights)
    offset_px, error = (a, error_a) if error_a <= error_b else (b, error_b)
    mean, square = 0.0, 0.0
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            mean += weights[i, j] * target[i, j]
            square += weights[i, j] * target[i, j] * target[i, j]
    if error > search.min_error + search.error_share * (square - mean * mean):
        return np.inf
    position[0] = line.foot[0] + offset_px * line.direction[0]
    position[1] = line.foot[1] + offset_px * line.direction[1]
    return error


@kernel
def epipolar_frame(
    fundamental: Floats, epipole: Floats, x: float, y: float, near_x: float, near_y: float, line: Line
) -> bool:
    """Fill in the epipolar line of a point, with the foot of the perpendicular from `near`, if it has one."""
    foot, direction, affine = line
    along_x, along_y = epipole[0] - x * epipole[2], epipole[1] - y * epipole[2]
    length = np.sqrt(along_x * along_x + along_y * along_y)
    a = fundamental[0, 0] * x + fundamental[0, 1] * y + fundamental[0, 2]
    b = fundamental[1, 0] * x + fundamental[1, 1] * y + fundamental[1, 2]
    c = fundamental[2, 0] * x + fundamental[2, 1] * y + fundamental[2, 2]
    norm = np.sqrt(a * a + b * b)
    if not length > 0.0 or not norm > 0.0:
        return False
    along_x, along_y, a, b, c = along_x / length, along_y / length, a / norm, b / norm, c / norm
    distance = a * near_x + b * near_y + c
    foot[0], foot[1] = near_x - distance * a, near_y - distance * b
    da = (fundamental[0, 1] * along_x - fundamental[0, 0] * along_y) / norm
    db = (fundamental[1, 1] * along_x - fundamental[1, 0] * along_y) / norm
    dc = (fundamental[2, 1] * along_x - fundamental[2, 0] * along_y) / norm
    scale = -(da * foot[0] + db * foot[1] + dc)
    if scale < 0.0:
        scale, a, b = -scale, -a, -b
    scale = min(max(scale, 0.5), 2.0)
    direction[0], direction[1] = b, -a
    affine[0, 0] = affine[1, 1] = scale * (b * along_x + a * -along_y)
    affine[1, 0] = scale * (-a * along_x + b * -along_y)
    affine[0, 1] = -affine[1, 0]
    return True


@kernel
def similarities(
    fundamental: Floats, epipole: Floats, first: Floats, second: Floats, affines: Floats
) -> None:
    """Fill in the similarity of `epipolar_frame` for every correspondence; the identity without lines."""
    foot, direction = np.empty(2), np.empty(2)
    for i in range(first.shape[0]):
        x, y = first[i, 0], first[i, 1]
        line = Line(foot, direction, affines[i])
        if not epipolar_frame(fundamental, epipole, x, y, second[i, 0], second[i, 1], line):
            affines[i, 0, 0] = affines[i, 1, 1] = 1.0
            affines[i, 0, 1] = affines[i, 1, 0] = 0.0


@kernel
def neighbourhood_error(
    target: Floats, coefficients: Floats, line: Line, position_px: float, weights: Floats
) -> float:
    """Return the weighted variance of the difference at a position on an epipolar line; inf outside."""
    foot, direction, affine = line
    x, y = foot[0] + position_px * direction[0], foot[1] + position_px * direction[1]
    height, width = coefficients.shape[0] - 2 * MARGIN, coefficients.shape[1] - 2 * MARGIN
    radius = target.shape[0] // 2
    if not is_inside(radius, x, y, affine, height, width):
        return np.inf
    mean, error = 0.0, 0.0
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            u = max(x + affine[0, 0] * (j - radius) + affine[0, 1] * (i - radius), 0.0)
            v = max(y + affine[1, 0] * (j - radius) + affine[1, 1] * (i - radius), 0.0)
            column, row = int(u), int(v)
            across, down = spline_weights(u - column), spline_weights(v - row)
            difference = sample(coefficients, column, row, across, down) - target[i, j]
            mean += weights[i, j] * difference
            error += weights[i, j] * difference * difference
    return error - mean * mean


@kernel
def rough_error(target: Floats, halves: Floats, line: Line, position_px: float, weights: Floats) -> float:
    """Return nearly the same error, from samples half a pixel apart and bilinear interpolation."""
    foot, direction, affine = line
    x, y = foot[0] + position_px * direction[0], foot[1] + position_px * direction[1]
    height, width = halves.shape[0] // 2, halves.shape[1] // 2
    radius = target.shape[0] // 2
    if not is_inside(radius, x, y, affine, height, width):
        return np.inf
    mean, error = 0.0, 0.0
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            u = 2.0 * max(x + affine[0, 0] * (j - radius) + affine[0, 1] * (i - radius), 0.0)
            v = 2.0 * max(y + affine[1, 0] * (j - radius) + affine[1, 1] * (i - radius), 0.0)
            column, row = int(u), int(v)
            u, v = u - column, v - row
            left, top = np.uint64(column), np.uint64(row)
            right, bottom = left + np.uint64(1), top + np.uint64(1)
            above = halves[top, left] + u * (halves[top, right] - halves[top, left])
            below = halves[bottom, left] + u * (halves[bottom, right] - halves[bottom, left])
            difference = above + v * (below - above) - target[i, j]
            mean += weights[i, j] * difference
            error += weights[i, j] * difference * difference
    return error - mean * mean


@kernel
def is_inside(radius: int, x: float, y: float, affine: Floats, height: int, width: int) -> bool:
    """Return whether the affine image of a square neighbourhood lies inside a frame."""
    reach_x = radius * (abs(affine[0, 0]) + abs(affine[0, 1]))
    reach_y = radius * (abs(affine[1, 0]) + abs(affine[1, 1]))
    return bool(reach_x <= x <= width - 1 - reach_x and reach_y <= y <= height - 1 - reach_y)


@kernel
def disagreement(
    pair: KeyPair,
    first: Integers,
    second: Floats,
    normals: Floats,
    distance_px: float,
    weights: Floats,
    half_range_px: float,
    scores: Floats,
) -> None:
    """Score how badly the neighbourhoods on the two sides of edge points move like the edge; nan: outside."""
    image, _, halves, fundamental, epipole = pair
    height, width = image.shape
    radius = weights.shape[0] // 2
    line = Line(np.empty(2), np.empty(2), np.empty((2, 2)))
    foot, _, affine = line
    half = int(2 * half_range_px)
    for p in range(first.shape[0]):
        x, y = first[p, 0], first[p, 1]
        u, v = second[p, 0], second[p, 1]
        has_line = epipolar_frame(fundamental, epipole, float(x), float(y), u, v, line)
        for side in range(2):
            sign = 1.0 - 2.0 * side
            dx = int(np.rint(sign * distance_px * normals[p, 0]))
            dy = int(np.rint(sign * distance_px * normals[p, 1]))
            scores[p, side] = np.nan
            if not has_line or not fits(float(x + dx), float(y + dy), radius, width, height):
                continue
            target = image[y + dy - radius : y + dy + radius + 1, x + dx - radius : x + dx + radius + 1]
            foot[0] = u + affine[0, 0] * dx + affine[0, 1] * dy
            foot[1] = v + affine[1, 0] * dx + affine[1, 1] * dy
            same, other = np.inf, np.inf
            for k in range(-half, half + 1):
                error = rough_error(target, halves, line, 0.5 * k, weights)
                if abs(k) <= 1:
                    same = min(same, error)
                else:
                    other = min(other, error)
            if same < np.inf and other < np.inf:
                scores[p, side] = (same + 2.0) / (other + 2.0)
