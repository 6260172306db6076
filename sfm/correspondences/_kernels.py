"""Compiled loops of features, matching, refinement, propagation; validated and described by their callers.

They stand in one file because most of them call each other, and numba's cache does not see a callee in
another file change.

Images are float64 arrays [row, column]; points are (x, y). `coefficients` are those of the cubic B-spline
that interpolates an image, with `MARGIN` more on all sides: `sfm.correspondences.subpixel.spline`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel

Floats = NDArray[np.float64]

MARGIN = 2  # coefficients around the image that samples within it depend on
_SIXTH = 1.0 / 6.0


class Corners(NamedTuple):
    """Corners of a key frame with their descriptions."""

    positions: Floats  # (N, 2)
    patches: NDArray[np.uint8]  # (N, S), samples around them
    means: Floats
    histograms: Floats


class Similarity(NamedTuple):
    """How far apart and how different corners may be."""

    max_motion_px: float
    max_brightness_change: float
    max_chi_square: float


class Descent(NamedTuple):
    """When the search for the least error ends, and how far it may lead."""

    max_iterations: int
    min_step_px: float
    max_shift_px: float


class KeyPair(NamedTuple):
    """Two key frames and their epipolar geometry."""

    image: Floats  # the first
    coefficients: Floats  # of the second
    halves: Floats  # samples of the second half a pixel apart
    fundamental: Floats
    epipole: Floats  # in the first


class Line(NamedTuple):
    """An epipolar line in the second key frame, and how neighbourhoods appear there."""

    foot: Floats  # of the perpendicular from where the point is expected
    direction: Floats
    affine: Floats


class Patch(NamedTuple):
    """A neighbourhood that is looked for."""

    target: Floats  # its samples
    weights: Floats
    coefficients: Floats  # of the frame in which it is looked for


class ErrorLimit(NamedTuple):
    """The largest mean squared error."""

    least: float  # that noise and sampling can cause
    share: float  # beyond that, of the variance of the neighbourhood


class Points(NamedTuple):
    """Correspondences: whole pixels of the first key frame, points of the second, mean squared errors."""

    first: NDArray[np.int64]
    second: Floats
    errors: Floats


class Front(NamedTuple):
    """Work space of `nearest_owners`: of each pixel the point and its distance, and a list of pixels."""

    owner: NDArray[np.int64]
    distance_px2: NDArray[np.int64]
    columns: NDArray[np.int64]
    rows: NDArray[np.int64]


# ---- features ----


@kernel
def suppression_radii(x, y, strength, robustness, radii_px2):
    """Squared distance of each maximum to the nearest clearly stronger one; `strength` falls."""
    for i in range(x.size):
        nearest = np.int64(1) << 40
        for j in range(i):
            if strength[j] * robustness <= strength[i]:
                break
            nearest = min(nearest, (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)
        radii_px2[i] = nearest


# ---- matching ----


@kernel
def parzen_histograms(patches, bin_width, histograms):
    """Densities of deviations from the mean by triangular windows two bins wide, sampled at bin centres."""
    num_bins = histograms.shape[1]
    for i in range(patches.shape[0]):
        for k in range(num_bins):
            histograms[i, k] = 0.0
        for value in patches[i]:
            position = min(max(value / bin_width + 0.5 * (num_bins - 1), 0.0), num_bins - 1.0)
            k = min(int(position), num_bins - 2)
            histograms[i, k] += k + 1 - position
            histograms[i, k + 1] += position - k


@kernel
def chi_square(a, b):
    """Half the sum of (a - b)^2 / (a + b): from 0 (the same) to the number of samples (nothing shared)."""
    total = 0.0
    for k in range(a.size):
        both = a[k] + b[k]
        if both > 0.0:
            total += (a[k] - b[k]) ** 2 / both
    return 0.5 * total


@inlined_kernel
def sum_of_squares(a, b):
    """Sum of squared differences of samples; in 32 bits, so that many are taken at a time."""
    total = np.int32(0)
    for k in range(a.size):
        difference = np.int32(np.int32(a[k]) - np.int32(b[k]))
        total = np.int32(total + np.int32(difference * difference))
    return np.float64(total)


@kernel
def best_candidates(first, second, similarity, limits, chosen, errors):
    """List, by rising error, the most similar corners within the motion bound; -1 where there are fewer.

    Errors are squared differences of the deviations from the means.
    """
    corners_a, patches_a, means_a, histograms_a = first
    corners_b, patches_b, means_b, histograms_b = second
    max_motion_px, max_brightness_change, max_chi_square = similarity
    count = chosen.shape[1]
    for i in range(corners_a.shape[0]):
        found = 0
        for j in range(corners_b.shape[0]):
            dx, dy = corners_b[j, 0] - corners_a[i, 0], corners_b[j, 1] - corners_a[i, 1]
            if dx * dx + dy * dy > max_motion_px * max_motion_px:
                continue
            brighter = means_a[i] - means_b[j]
            if abs(brighter) > max_brightness_change:
                continue
            limit = min(limits[i], errors[i, count - 1]) if found == count else limits[i]
            error = sum_of_squares(patches_a[i], patches_b[j]) - patches_a.shape[1] * brighter * brighter
            if error > limit or chi_square(histograms_a[i], histograms_b[j]) > max_chi_square:
                continue
            place = min(found, count - 1)
            while place > 0 and errors[i, place - 1] > error:
                errors[i, place] = errors[i, place - 1]
                chosen[i, place] = chosen[i, place - 1]
                place -= 1
            errors[i, place] = error
            chosen[i, place] = j
            found = min(found + 1, count)


# ---- refinement ----


@inlined_kernel
def spline_weights(t):
    """Cubic B-spline at the four samples around a position."""
    s = 1.0 - t
    return (
        _SIXTH * s * s * s,
        _SIXTH * (4.0 - 6.0 * t * t + 3.0 * t * t * t),
        _SIXTH * (4.0 - 6.0 * s * s + 3.0 * s * s * s),
        _SIXTH * t * t * t,
    )


@inlined_kernel
def spline_slopes(t):
    """Return its derivative."""
    s = 1.0 - t
    return -0.5 * s * s, 0.5 * (3.0 * t * t - 4.0 * t), -0.5 * (3.0 * s * s - 4.0 * s), 0.5 * t * t


@inlined_kernel
def weighted(weights, a, b, c, d):
    """Return a weighted sum of four numbers."""
    return weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d


@inlined_kernel
def along_row(weights, coefficients, row, column):
    """Interpolate between four coefficients of a row, from a column on; unsigned, which spares tests."""
    return (
        weights[0] * coefficients[row, column]
        + weights[1] * coefficients[row, column + np.uint64(1)]
        + weights[2] * coefficients[row, column + np.uint64(2)]
        + weights[3] * coefficients[row, column + np.uint64(3)]
    )


@kernel
def fits(x, y, radius, width, height):
    """Tell whether the square neighbourhood of a point lies inside the image."""
    return radius <= x <= width - 1 - radius and radius <= y <= height - 1 - radius


@inlined_kernel
def sample(coefficients, column, row, across, down):
    """Interpolate between the sixteen coefficients around a position."""
    x, y = np.uint64(column - 1 + MARGIN), np.uint64(row - 1 + MARGIN)
    return weighted(
        down,
        along_row(across, coefficients, y, x),
        along_row(across, coefficients, y + np.uint64(1), x),
        along_row(across, coefficients, y + np.uint64(2), x),
        along_row(across, coefficients, y + np.uint64(3), x),
    )


@kernel
def sample_square(coefficients, x, y, radius, values, dx, dy):
    """Interpolate a square neighbourhood and its gradient; rows first, then columns."""
    size = 2 * radius + 1
    left, top = int(x), int(y)
    across, across_slope = spline_weights(x - left), spline_slopes(x - left)
    down, down_slope = spline_weights(y - top), spline_slopes(y - top)
    line, line_slope = np.empty((size + 3, size)), np.empty((size + 3, size))
    for i in range(size + 3):
        row = np.uint64(top - radius - 1 + MARGIN + i)
        for j in range(size):
            column = np.uint64(left - radius - 1 + MARGIN + j)
            line[i, j] = along_row(across, coefficients, row, column)
            line_slope[i, j] = along_row(across_slope, coefficients, row, column)
    for i in range(size):
        for j in range(size):
            values[i, j] = weighted(down, line[i, j], line[i + 1, j], line[i + 2, j], line[i + 3, j])
            dy[i, j] = weighted(down_slope, line[i, j], line[i + 1, j], line[i + 2, j], line[i + 3, j])
            dx[i, j] = weighted(
                down, line_slope[i, j], line_slope[i + 1, j], line_slope[i + 2, j], line_slope[i + 3, j]
            )


@kernel
def sample_affine(coefficients, x, y, affine, radius, values, dx, dy):
    """Interpolate the neighbourhood that an affine map makes of a square, and its gradient."""
    last_x, last_y = coefficients.shape[1] - 1.0 - 2 * MARGIN, coefficients.shape[0] - 1.0 - 2 * MARGIN
    for i in range(2 * radius + 1):
        for j in range(2 * radius + 1):
            u = x + affine[0, 0] * (j - radius) + affine[0, 1] * (i - radius)
            v = y + affine[1, 0] * (j - radius) + affine[1, 1] * (i - radius)
            u, v = min(max(u, 0.0), last_x), min(max(v, 0.0), last_y)
            column, row = int(u), int(v)
            across, down = spline_weights(u - column), spline_weights(v - row)
            values[i, j] = sample(coefficients, column, row, across, down)
            dx[i, j] = sample(coefficients, column, row, spline_slopes(u - column), down)
            dy[i, j] = sample(coefficients, column, row, across, spline_slopes(v - row))


@kernel
def normal_equations(target, values, dx, dy, weights, num_parameters, matrix, vector):
    """Set up the step of least squares in the neighbourhood's parameters, the mean difference being free."""
    size = target.shape[0]
    mean, mean_difference, error = np.zeros(num_parameters), 0.0, 0.0
    matrix[:] = 0.0
    vector[:] = 0.0
    for i in range(size):
        # Sums over a row of products of the gradient, times the column to the power of 0, 1, 2.
        xx0 = xx1 = xx2 = xy0 = xy1 = xy2 = yy0 = yy1 = yy2 = 0.0
        x0 = x1 = y0 = y1 = vx0 = vx1 = vy0 = vy1 = 0.0
        for j in range(size):
            across, w, difference = j - size // 2, weights[i, j], values[i, j] - target[i, j]
            x, y = w * dx[i, j], w * dy[i, j]
            mean_difference += w * difference
            error += w * difference * difference
            xx, xy, yy = x * dx[i, j], x * dy[i, j], y * dy[i, j]
            x0, x1, y0, y1 = x0 + x, x1 + across * x, y0 + y, y1 + across * y
            x, y = x * difference, y * difference
            vx0, vx1, vy0, vy1 = vx0 + x, vx1 + across * x, vy0 + y, vy1 + across * y
            xx0, xy0, yy0 = xx0 + xx, xy0 + xy, yy0 + yy
            xx, xy, yy = across * xx, across * xy, across * yy
            xx1, xy1, yy1 = xx1 + xx, xy1 + xy, yy1 + yy
            xx2, xy2, yy2 = xx2 + across * xx, xy2 + across * xy, yy2 + across * yy
        add_row((xx0, xx1, xx2), (xy0, xy1, xy2), (yy0, yy1, yy2), i - size // 2, matrix)
        for sums, (sx0, sx1, sy0, sy1) in ((mean, (x0, x1, y0, y1)), (vector, (vx0, vx1, vy0, vy1))):
            sums[0] += sx0
            sums[1] += sy0
            if num_parameters == 6:
                sums[2] += sx1
                sums[3] += (i - size // 2) * sx0
                sums[4] += sy1
                sums[5] += (i - size // 2) * sy0
    for a in range(num_parameters):
        vector[a] -= mean[a] * mean_difference
        for b in range(a + 1):
            matrix[a, b] -= mean[a] * mean[b]
            matrix[b, a] = matrix[a, b]
    return error - mean_difference * mean_difference


@inlined_kernel
def add_row(xx, xy, yy, down, matrix):
    """Add the sums of a row to the lower half of the matrix; parameters are those of `sample_affine`."""
    matrix[0, 0] += xx[0]
    matrix[1, 0] += xy[0]
    matrix[1, 1] += yy[0]
    if matrix.shape[0] == 2:
        return
    for first, sums in ((0, xx), (1, xy)):  # of derivatives across
        matrix[2, first] += sums[1]
        matrix[3, first] += down * sums[0]
    for first, sums in ((0, xy), (1, yy)):  # and down
        matrix[4, first] += sums[1]
        matrix[5, first] += down * sums[0]
    for second, first, sums in ((2, 2, xx), (4, 2, xy), (4, 4, yy)):
        matrix[second, first] += sums[2]
        matrix[second + 1, first] += down * sums[1]
        matrix[second + 1, first + 1] += down * down * sums[0]
    matrix[4, 3] += down * xy[1]


@kernel
def solve_damped(matrix, vector, damping, step):
    """Solve ``(A + damping diag(A)) step = -vector`` by Cholesky factors; False if A is not definite."""
    n = vector.size
    lower = np.zeros((n, n))
    for a in range(n):
        for b in range(a + 1):
            total = matrix[a, b] * (1.0 + damping) if a == b else matrix[a, b]
            for k in range(b):
                total -= lower[a, k] * lower[b, k]
            if a == b:
                if not total > 1e-9 * matrix[a, a] or matrix[a, a] <= 1e-9:
                    return False
                lower[a, a] = np.sqrt(total)
            else:
                lower[a, b] = total / lower[b, b]
    for a in range(n):
        total = -vector[a]
        for k in range(a):
            total -= lower[a, k] * step[k]
        step[a] = total / lower[a, a]
    for a in range(n - 1, -1, -1):
        total = step[a]
        for k in range(a + 1, n):
            total -= lower[k, a] * step[k]
        step[a] = total / lower[a, a]
    return True


@kernel
def sample_neighbourhood(coefficients, parameters, radius, values, dx, dy):
    """Interpolate the second neighbourhood that 2 or 6 parameters describe."""
    if parameters.size == 2:
        sample_square(coefficients, parameters[0], parameters[1], radius, values, dx, dy)
    else:
        affine = parameters[2:].reshape((2, 2))
        sample_affine(coefficients, parameters[0], parameters[1], affine, radius, values, dx, dy)


@kernel
def minimize_neighbourhood(patch, parameters, descent):
    """Run Levenberg-Marquardt on one neighbourhood from `parameters`, which receive the minimum."""
    target, weights, coefficients = patch
    max_iterations, min_step_px, max_shift_px = descent
    height, width = coefficients.shape[0] - 2 * MARGIN, coefficients.shape[1] - 2 * MARGIN
    size, count = target.shape[0], parameters.size
    radius = size // 2
    values, dx, dy = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    matrix, vector, step = np.empty((count, count)), np.empty(count), np.empty(count)
    trial_matrix, trial_vector = np.empty((count, count)), np.empty(count)
    x, y = parameters[0], parameters[1]
    if not fits(x, y, radius, width, height):
        return -1.0
    sample_neighbourhood(coefficients, parameters, radius, values, dx, dy)
    error = normal_equations(target, values, dx, dy, weights, count, matrix, vector)
    damping = 1e-3
    for _ in range(max_iterations):
        if not solve_damped(matrix, vector, damping, step):
            return -1.0
        trial = parameters + step
        length = np.sqrt(step[0] * step[0] + step[1] * step[1])
        trial_error = np.inf
        if fits(trial[0], trial[1], radius, width, height) and length <= 2.0 * max_shift_px:
            sample_neighbourhood(coefficients, trial, radius, values, dx, dy)
            trial_error = normal_equations(target, values, dx, dy, weights, count, trial_matrix, trial_vector)
        if trial_error <= error:
            for a in range(count):  # slices would make numba compile the text of an error, for seconds
                parameters[a], vector[a] = trial[a], trial_vector[a]
                for b in range(count):
                    matrix[a, b] = trial_matrix[a, b]
            error = trial_error
            damping = max(damping * 0.1, 1e-7)
        else:
            damping *= 10.0
        if length < min_step_px or damping > 1e6:
            break
    moved = (parameters[0] - x) ** 2 + (parameters[1] - y) ** 2
    return error if moved <= max_shift_px * max_shift_px else -1.0


@kernel
def refine_points(image, coefficients, first, parameters, weights, descent, errors):
    """Refine every row of `parameters`; `first` are whole pixels of `image` with room around them."""
    radius = weights.shape[0] // 2
    for i in range(first.shape[0]):
        x, y = first[i, 0], first[i, 1]
        target = image[y - radius : y + radius + 1, x - radius : x + radius + 1]
        errors[i] = minimize_neighbourhood(Patch(target, weights, coefficients), parameters[i], descent)


# ---- propagation ----


@kernel
def is_inside(radius, x, y, affine, height, width):
    """Tell whether the neighbourhood that an affine map makes of a square lies inside a frame."""
    reach_x = radius * (abs(affine[0, 0]) + abs(affine[0, 1]))
    reach_y = radius * (abs(affine[1, 0]) + abs(affine[1, 1]))
    return reach_x <= x <= width - 1 - reach_x and reach_y <= y <= height - 1 - reach_y


@kernel
def neighbourhood_error(target, coefficients, x, y, affine, weights):
    """Weighted mean squared error, the mean difference being free; infinite outside the image."""
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
def rough_error(target, halves, x, y, affine, weights):
    """Return nearly the same error, by samples half a pixel apart and straight lines between them."""
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
def epipolar_frame(fundamental, epipole, x, y, near_x, near_y, line):
    """Set up the search for a point on its epipolar line around the foot of the perpendicular from `near`."""
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
def similarities(fundamental, epipole, first, second, affines):
    """Fill in the similarity of `epipolar_frame` for every correspondence; the identity without lines."""
    foot, direction = np.empty(2), np.empty(2)
    for i in range(first.shape[0]):
        x, y = first[i, 0], first[i, 1]
        line = Line(foot, direction, affines[i])
        if not epipolar_frame(fundamental, epipole, x, y, second[i, 0], second[i, 1], line):
            affines[i, 0, 0] = affines[i, 1, 1] = 1.0
            affines[i, 0, 1] = affines[i, 1, 0] = 0.0


@kernel
def error_on_line(patch, line, position_px):
    """Error at a position on an epipolar line."""
    foot, direction, affine = line
    x, y = foot[0] + position_px * direction[0], foot[1] + position_px * direction[1]
    return neighbourhood_error(patch.target, patch.coefficients, x, y, affine, patch.weights)


@kernel
def golden_section(patch, line, low, high, tolerance_px):
    """Find the least error on an epipolar line between two positions; returns position and error."""
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
def search_line(patch, halves, line, half_range_px, step_px, tolerance_px):
    """Full search on an epipolar line around its foot, and golden-section search around the best."""
    foot, direction, affine = line
    half = int(np.ceil(half_range_px / step_px))
    errors = np.empty(2 * half + 1)
    for k in range(2 * half + 1):
        position = (k - half) * step_px
        x, y = foot[0] + position * direction[0], foot[1] + position * direction[1]
        errors[k] = rough_error(patch.target, halves, x, y, affine, patch.weights)
    best = np.argmin(errors)
    if best in (0, 2 * half) or not max(errors[best - 1], errors[best + 1]) < np.inf:
        return 0.0, np.inf
    low, high = (best - half - 1) * step_px, (best - half + 1) * step_px
    return golden_section(patch, line, low, high, tolerance_px)


@kernel
def weighted_variance(values, weights):
    """Variance of a neighbourhood; `weights` sum to 1."""
    mean, square = 0.0, 0.0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            mean += weights[i, j] * values[i, j]
            square += weights[i, j] * values[i, j] * values[i, j]
    return square - mean * mean


@kernel
def follow(pair, x, y, near, weights, search, limit, found):
    """Search the point at whole pixels (x, y) on its epipolar line, starting where `near` says."""
    image, coefficients, halves, fundamental, epipole = pair
    radius = weights.shape[0] // 2
    foot, direction, affine = np.empty(2), np.empty(2), np.empty((2, 2))
    line = Line(foot, direction, affine)
    if not epipolar_frame(fundamental, epipole, x, y, near[0], near[1], line):
        return np.inf
    target = image[y - radius : y + radius + 1, x - radius : x + radius + 1]
    patch = Patch(target, weights, coefficients)
    position, error = search_line(patch, halves, line, search[0], search[1], search[2])
    if error > limit.least + limit.share * weighted_variance(target, weights):
        return np.inf
    found[0], found[1] = foot[0] + position * direction[0], foot[1] + position * direction[1]
    return error


@kernel
def nearest_owners(first, begin, end, reach_px, radius, open_tries, front):
    """List the open pixels within reach of points [begin, end); `owner` receives the nearest of these."""
    owner, distance_px2, columns, rows = front
    height, width = open_tries.shape
    count = 0
    for p in range(begin, end):
        for y in range(max(first[p, 1] - reach_px, radius), min(first[p, 1] + reach_px + 1, height - radius)):
            for x in range(
                max(first[p, 0] - reach_px, radius), min(first[p, 0] + reach_px + 1, width - radius)
            ):
                square = (x - first[p, 0]) ** 2 + (y - first[p, 1]) ** 2
                if open_tries[y, x] <= 0 or square > reach_px * reach_px:
                    continue
                if owner[y, x] < 0:
                    columns[count], rows[count] = x, y
                    count += 1
                elif square >= distance_px2[y, x]:
                    continue
                owner[y, x], distance_px2[y, x] = p, square
    return count


@kernel
def propagate(pair, open_tries, reach_px, weights, search, limit, num_seeds, points):
    """Follow open pixels around known points until nothing is added; returns how many are known then."""
    first, second, errors = points
    owner = np.full(open_tries.shape, -1, dtype=np.int64)
    distance_px2 = np.zeros(open_tries.shape, dtype=np.int64)
    columns, rows = np.empty(open_tries.size, dtype=np.int64), np.empty(open_tries.size, dtype=np.int64)
    front = Front(owner, distance_px2, columns, rows)
    near, found = np.empty(2), np.empty(2)
    radius = weights.shape[0] // 2
    begin, end = 0, num_seeds
    while begin < end:
        count = nearest_owners(first, begin, end, reach_px, radius, open_tries, front)
        begin = end
        for k in range(count):
            x, y = columns[k], rows[k]
            p = owner[y, x]
            owner[y, x] = -1
            open_tries[y, x] -= 1
            near[0], near[1] = x + second[p, 0] - first[p, 0], y + second[p, 1] - first[p, 1]
            error = follow(pair, x, y, near, weights, search, limit, found)
            if error < np.inf:
                open_tries[y, x] = 0
                first[end, 0], first[end, 1] = x, y
                second[end, 0], second[end, 1], errors[end] = found[0], found[1], error
                end += 1
    return end


@kernel
def follow_all(pair, points, weights, search, limit):
    """Search every point again from where it is; `second` and `errors` are replaced where one is found."""
    first, second, errors = points
    found = np.empty(2)
    height, width = pair.image.shape
    for i in range(first.shape[0]):
        x, y = first[i, 0], first[i, 1]
        errors[i] = np.inf
        if fits(x, y, weights.shape[0] // 2, width, height):
            errors[i] = follow(pair, x, y, second[i], weights, search, limit, found)
        if errors[i] < np.inf:
            second[i, 0], second[i, 1] = found[0], found[1]


@kernel
def disagreement(pair, first, second, normals, distance_px, weights, half_range_px, scores):
    """Tell how badly what lies on either side of an edge point moves like it."""
    image, _, halves, fundamental, epipole = pair
    height, width = image.shape
    radius = weights.shape[0] // 2
    foot, direction, affine = np.empty(2), np.empty(2), np.empty((2, 2))
    half = int(2 * half_range_px)
    for p in range(first.shape[0]):
        x, y = first[p, 0], first[p, 1]
        line = Line(foot, direction, affine)
        known = epipolar_frame(fundamental, epipole, x, y, second[p, 0], second[p, 1], line)
        for side in range(2):
            sign = 1.0 - 2.0 * side
            dx = int(np.rint(sign * distance_px * normals[p, 0]))
            dy = int(np.rint(sign * distance_px * normals[p, 1]))
            scores[p, side] = np.nan
            if not known or not fits(x + dx, y + dy, radius, width, height):
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
