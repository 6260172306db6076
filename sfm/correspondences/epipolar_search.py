"""Searches on epipolar lines: points of the first key frame in the second, and the surface of each."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from sfm.correspondences.spline_sampling import (
    MARGIN,
    fits,
    half_pixel_samples,
    sample,
    spline,
    spline_weights,
)
from sfm.correspondences.subpixel import Patch, check_pair, inside, window
from sfm.estimation.epipolar import epipoles
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class SearchSettings:
    """Parameters of the search on epipolar lines."""

    radius_px: int = 3  # half size of the neighbourhoods compared
    search_px: float = 2.0  # half range of the full search on the epipolar line
    step_px: float = 0.5
    tolerance_px: float = 0.02  # precision of the golden-section search
    min_error: float = 8.0  # mean squared error due to noise and sampling, squared luma levels
    error_share: float = 0.06  # largest additional error, as a share of the neighbourhood's variance
    # distance of the two neighbourhoods that show an edge's surface from the edge
    side_distance_px: float = 5.0
    side_radius_px: int = 2  # half size of these neighbourhoods
    side_search_px: float = 6.0  # half range of the search for a motion of their own
    side_ratio: float = 1.2  # least quotient of the two sides' disagreement with the edge's motion
    settling_px: float = 1.0  # half range of the search after a point has been moved to its side
    # largest distance between the best positions of a corner's small and large neighbourhoods
    confirmed_px: float = 0.5

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.radius_px, self.side_radius_px) < 1:
            raise ValueError(f"radii must be at least 1, got {self}")
        if min(self.search_px, self.step_px, self.tolerance_px, self.settling_px) <= 0:
            raise ValueError(f"ranges, step and tolerance of the search must be positive, got {self}")


class LineSearch(NamedTuple):
    """Range and precision of a search on an epipolar line, and the largest error of a match."""

    half_range_px: float
    step_px: float
    tolerance_px: float
    min_error: float  # due to noise and sampling
    error_share: float  # additional error, as a share of the neighbourhood's variance


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

    first: NDArray[np.int64]
    second: Floats
    errors: Floats


class EpipolarSearch:
    """Two key frames and their epipolar geometry, ready to be searched."""

    def __init__(
        self, luma0: Image, luma1: Image, fundamental: Floats, settings: SearchSettings | None = None
    ) -> None:
        check_pair(luma0, luma1)
        self.luma0, self.luma1, self.fundamental = luma0, luma1, fundamental
        self.settings = settings or SearchSettings()
        self.usable = bool(np.isfinite(fundamental).all() and np.abs(fundamental).max() > 0)
        self.epipole = epipoles(fundamental)[0] if self.usable else np.zeros(3)
        coefficients = spline(luma1)
        image, halves = luma0.astype(np.float64), half_pixel_samples(coefficients)
        self.pair = KeyPair(image, coefficients, halves, fundamental, self.epipole)

    def line_search(self, half_range_px: float | None = None) -> LineSearch:
        """Return the parameters of a search, with the usual range if none is given."""
        s = self.settings
        reach = s.search_px if half_range_px is None else half_range_px
        return LineSearch(reach, s.step_px, s.tolerance_px, s.min_error, s.error_share)

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
        error, small = np.empty(len(first)), window(self.settings.side_radius_px)
        any_error = self.line_search()._replace(min_error=np.inf, error_share=0.0)
        follow_all(self.pair, Points(first, again, error), small, any_error)
        moved = np.sqrt(((again - correspondences.second) ** 2).sum(axis=1))
        same = np.isfinite(error) & (moved <= self.settings.confirmed_px)
        chosen = correspondences[same]
        return self.settle_sides(first[same], chosen.second, chosen.error)

    def settle_sides(self, first: Indices, second: Floats, error: Floats) -> Correspondences:
        """Move points next to the surface that they move with on to it by a pixel, and search them again."""
        settings, scores = self.settings, np.empty((len(first), 2))
        normals = gradient_directions(self.luma0)[first[:, 1], first[:, 0]]
        reach, small = settings.side_distance_px, window(settings.side_radius_px)
        disagreement(self.pair, first, second, normals, reach, small, settings.side_search_px, scores)
        plus, minus = np.nan_to_num(scores, nan=1.0).T
        sign = np.where((minus > 1.0) & (minus > settings.side_ratio * plus), 1, 0)
        sign -= (plus > 1.0) & (plus > settings.side_ratio * minus)
        moved = np.flatnonzero(sign)
        step = np.rint(1.2 * sign[moved, None] * normals[moved]).astype(np.int64)
        points = Points(first[moved] + step, second[moved] + step, np.empty(len(moved)))
        follow_all(self.pair, points, window(settings.radius_px), self.line_search(settings.settling_px))
        first, second, error = first.copy(), second.copy(), error.copy()
        first[moved], second[moved], error[moved] = points
        order = np.argsort(error, kind="stable")
        order = order[np.isfinite(error[order])]
        _, once = np.unique(first[order], axis=0, return_index=True)
        chosen = np.sort(order[once])
        return Correspondences(first[chosen].astype(np.float64), second[chosen], error[chosen])


def gradient_directions(luma: Image) -> Floats:
    """Return the directions of the gradient of a blurred frame, shape (H, W, 2)."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)], axis=-1)
    length = np.sqrt((gradient**2).sum(axis=-1, keepdims=True))
    directions: Floats = gradient / np.maximum(length, 1e-9)
    return directions


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
        if fits(x, y, weights.shape[0] // 2, width, height):
            errors[i] = follow(pair, x, y, second[i], weights, search, position)
        if errors[i] < np.inf:
            second[i, 0], second[i, 1] = position[0], position[1]


@kernel
def follow(
    pair: KeyPair, x: int, y: int, near: Floats, weights: Floats, search: LineSearch, position: Floats
) -> float:
    """Search the point at whole pixels (x, y) on its epipolar line, from the point nearest to `near`."""
    image, coefficients, halves, fundamental, epipole = pair
    radius = weights.shape[0] // 2
    foot, direction, affine = np.empty(2), np.empty(2), np.empty((2, 2))
    line = Line(foot, direction, affine)
    if not epipolar_frame(fundamental, epipole, x, y, near[0], near[1], line):
        return np.inf
    target = image[y - radius : y + radius + 1, x - radius : x + radius + 1]
    patch = Patch(target, weights, coefficients)
    offset_px, error = search_line(patch, halves, line, search)
    if error > search.min_error + search.error_share * weighted_variance(target, weights):
        return np.inf
    position[0], position[1] = foot[0] + offset_px * direction[0], foot[1] + offset_px * direction[1]
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
def search_line(patch: Patch, halves: Floats, line: Line, search: LineSearch) -> tuple[float, float]:
    """Search an epipolar line in steps around its foot, then by golden section around the best step."""
    foot, direction, affine = line
    step_px = search.step_px
    half = int(np.ceil(search.half_range_px / step_px))
    errors = np.empty(2 * half + 1)
    for k in range(2 * half + 1):
        position = (k - half) * step_px
        x, y = foot[0] + position * direction[0], foot[1] + position * direction[1]
        errors[k] = rough_error(patch.target, halves, x, y, affine, patch.weights)
    best = np.argmin(errors)
    if best in (0, 2 * half) or not max(errors[best - 1], errors[best + 1]) < np.inf:
        return 0.0, np.inf
    low, high = (best - half - 1) * step_px, (best - half + 1) * step_px
    return golden_section(patch, line, low, high, search.tolerance_px)


@kernel
def golden_section(
    patch: Patch, line: Line, low: float, high: float, tolerance_px: float
) -> tuple[float, float]:
    """Find the least error on an epipolar line between two positions; return position and error."""
    ratio = 0.6180339887498949
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    error_a = error_on_line(patch, line, a)
    error_b = error_on_line(patch, line, b)
    while high - low > tolerance_px:
        if error_a <= error_b:
            high, b, error_b = b, a, error_a
            a = high - ratio * (high - low)
            error_a = error_on_line(patch, line, a)
        else:
            low, a, error_a = a, b, error_b
            b = low + ratio * (high - low)
            error_b = error_on_line(patch, line, b)
    if error_a <= error_b:
        return a, error_a
    return b, error_b


@kernel
def error_on_line(patch: Patch, line: Line, position_px: float) -> float:
    """Return the error at a position on an epipolar line."""
    foot, direction, affine = line
    x, y = foot[0] + position_px * direction[0], foot[1] + position_px * direction[1]
    return neighbourhood_error(patch.target, patch.coefficients, x, y, affine, patch.weights)


@kernel
def neighbourhood_error(
    target: Floats, coefficients: Floats, x: float, y: float, affine: Floats, weights: Floats
) -> float:
    """Return the weighted mean squared error, the mean difference being free; inf outside the image."""
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
def rough_error(target: Floats, halves: Floats, x: float, y: float, affine: Floats, weights: Floats) -> float:
    """Return nearly the same error, from samples half a pixel apart and bilinear interpolation."""
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
def weighted_variance(values: Floats, weights: Floats) -> float:
    """Return the variance of a neighbourhood; `weights` sum to 1."""
    mean, square = 0.0, 0.0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            mean += weights[i, j] * values[i, j]
            square += weights[i, j] * values[i, j] * values[i, j]
    return square - mean * mean


@kernel
def disagreement(
    pair: KeyPair,
    first: Indices,
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
    foot, direction, affine = np.empty(2), np.empty(2), np.empty((2, 2))
    half = int(2 * half_range_px)
    for p in range(first.shape[0]):
        x, y = first[p, 0], first[p, 1]
        line = Line(foot, direction, affine)
        has_line = epipolar_frame(fundamental, epipole, x, y, second[p, 0], second[p, 1], line)
        for side in range(2):
            sign = 1.0 - 2.0 * side
            dx = int(np.rint(sign * distance_px * normals[p, 0]))
            dy = int(np.rint(sign * distance_px * normals[p, 1]))
            scores[p, side] = np.nan
            if not has_line or not fits(x + dx, y + dy, radius, width, height):
                continue
            target = image[y + dy - radius : y + dy + radius + 1, x + dx - radius : x + dx + radius + 1]
            u = second[p, 0] + affine[0, 0] * dx + affine[0, 1] * dy
            v = second[p, 1] + affine[1, 0] * dx + affine[1, 1] * dy
            same, other = np.inf, np.inf
            for k in range(-half, half + 1):
                moved_u, moved_v = u + 0.5 * k * direction[0], v + 0.5 * k * direction[1]
                error = rough_error(target, halves, moved_u, moved_v, affine, weights)
                if abs(k) <= 1:
                    same = min(same, error)
                else:
                    other = min(other, error)
            if same < np.inf and other < np.inf:
                scores[p, side] = (same + 2.0) / (other + 2.0)
