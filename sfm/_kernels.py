"""Compiled loops of features, matching, refinement and propagation; validated and described by their callers.

Images are float64 arrays [row, column]; points are (x, y). `coefficients` are those of the cubic B-spline that
interpolates an image, `sfm.refinement.spline_coefficients`.
"""

import numpy as np

from dvc._jit import kernel

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


@kernel
def squared_difference(a, b, limit):
    """Sum of squared differences; stops, above `limit`, once it exceeds it."""
    total = 0.0
    for k in range(a.size):
        total += (a[k] - b[k]) ** 2
        if total > limit:
            break
    return total


@kernel
def best_candidates(
    predicted,
    corners,
    radii_px,
    patches_a,
    patches_b,
    means_a,
    means_b,
    histograms_a,
    histograms_b,
    max_brightness_change,
    max_chi_square,
    limits,
    chosen,
    errors,
):
    """List, by rising error, the most similar corners near each predicted position; -1 where there are fewer.

    `limits` are the largest sums of squared differences, `errors` receives the sums.
    """
    count = chosen.shape[1]
    for i in range(predicted.shape[0]):
        found = 0
        for j in range(corners.shape[0]):
            dx, dy = corners[j, 0] - predicted[i, 0], corners[j, 1] - predicted[i, 1]
            if dx * dx + dy * dy > radii_px[i] * radii_px[i]:
                continue
            if abs(means_a[i] - means_b[j]) > max_brightness_change:
                continue
            if chi_square(histograms_a[i], histograms_b[j]) > max_chi_square:
                continue
            limit = min(limits[i], errors[i, count - 1]) if found == count else limits[i]
            error = squared_difference(patches_a[i], patches_b[j], limit)
            if error > limit:
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


@kernel
def spline_weights(fraction, weights, slopes):
    """Cubic B-spline at the four samples around a position, and its derivative."""
    t = fraction
    s = 1.0 - t
    weights[0] = s * s * s / 6.0
    weights[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    weights[2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
    weights[3] = t * t * t / 6.0
    slopes[0] = -0.5 * s * s
    slopes[1] = 0.5 * (3.0 * t * t - 4.0 * t)
    slopes[2] = -0.5 * (3.0 * s * s - 4.0 * s)
    slopes[3] = 0.5 * t * t


@kernel
def fits(x, y, radius, width, height):
    """Tell whether the square neighbourhood of a point lies inside the image."""
    return radius <= x <= width - 1 - radius and radius <= y <= height - 1 - radius


@kernel
def at_border(index, length):
    """Reflect an index about the first or last sample."""
    if index < 0:
        return -index
    if index >= length:
        return 2 * (length - 1) - index
    return index


@kernel
def sample_square(coefficients, x, y, radius, values, dx, dy):
    """Interpolate a square neighbourhood and its gradient; rows first, then columns."""
    height, width = coefficients.shape
    size = 2 * radius + 1
    column, row = int(np.floor(x)), int(np.floor(y))
    across, across_slope = np.empty(4), np.empty(4)
    down, down_slope = np.empty(4), np.empty(4)
    spline_weights(x - column, across, across_slope)
    spline_weights(y - row, down, down_slope)
    line, line_slope = np.empty((size + 3, size)), np.empty((size + 3, size))
    for i in range(size + 3):
        source = coefficients[at_border(row - radius - 1 + i, height)]
        for j in range(size):
            value, slope = 0.0, 0.0
            for k in range(4):
                c = source[at_border(column - radius - 1 + j + k, width)]
                value += across[k] * c
                slope += across_slope[k] * c
            line[i, j] = value
            line_slope[i, j] = slope
    for i in range(size):
        for j in range(size):
            value, slope_x, slope_y = 0.0, 0.0, 0.0
            for k in range(4):
                value += down[k] * line[i + k, j]
                slope_x += down[k] * line_slope[i + k, j]
                slope_y += down_slope[k] * line[i + k, j]
            values[i, j] = value
            dx[i, j] = slope_x
            dy[i, j] = slope_y


@kernel
def sample_affine(coefficients, x, y, affine, radius, values, dx, dy):
    """Interpolate the neighbourhood that an affine map makes of a square, and its gradient."""
    height, width = coefficients.shape
    across, across_slope = np.empty(4), np.empty(4)
    down, down_slope = np.empty(4), np.empty(4)
    for i in range(2 * radius + 1):
        for j in range(2 * radius + 1):
            u = x + affine[0, 0] * (j - radius) + affine[0, 1] * (i - radius)
            v = y + affine[1, 0] * (j - radius) + affine[1, 1] * (i - radius)
            u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
            column, row = int(u), int(v)
            spline_weights(u - column, across, across_slope)
            spline_weights(v - row, down, down_slope)
            value, slope_x, slope_y = 0.0, 0.0, 0.0
            for k in range(4):
                source = coefficients[at_border(row - 1 + k, height)]
                line, line_slope = 0.0, 0.0
                for m in range(4):
                    c = source[at_border(column - 1 + m, width)]
                    line += across[m] * c
                    line_slope += across_slope[m] * c
                value += down[k] * line
                slope_x += down[k] * line_slope
                slope_y += down_slope[k] * line
            values[i, j] = value
            dx[i, j] = slope_x
            dy[i, j] = slope_y


@kernel
def normal_equations(target, values, dx, dy, weights, num_parameters, matrix, vector):
    """Set up the step of least squares in the neighbourhood's parameters, the mean difference being free.

    Parameters are (x, y) and, if there are 6, the affine map row by row. Returns the weighted mean squared
    error; `weights` sum to 1.
    """
    size = target.shape[0]
    radius = size // 2
    jacobian, mean = np.empty(num_parameters), np.zeros(num_parameters)
    mean_difference, error = 0.0, 0.0
    matrix[:] = 0.0
    vector[:] = 0.0
    for i in range(size):
        for j in range(size):
            w = weights[i, j]
            difference = values[i, j] - target[i, j]
            jacobian[0], jacobian[1] = dx[i, j], dy[i, j]
            if num_parameters == 6:
                jacobian[2], jacobian[3] = dx[i, j] * (j - radius), dx[i, j] * (i - radius)
                jacobian[4], jacobian[5] = dy[i, j] * (j - radius), dy[i, j] * (i - radius)
            mean_difference += w * difference
            error += w * difference * difference
            for a in range(num_parameters):
                scaled = w * jacobian[a]
                mean[a] += scaled
                vector[a] += scaled * difference
                for b in range(a + 1):
                    matrix[a, b] += scaled * jacobian[b]
    for a in range(num_parameters):
        vector[a] -= mean[a] * mean_difference
        for b in range(a + 1):
            matrix[a, b] -= mean[a] * mean[b]
            matrix[b, a] = matrix[a, b]
    return error - mean_difference * mean_difference


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
def minimize_neighbourhood(
    target, coefficients, parameters, weights, max_iterations, least_step_px, max_shift_px
):
    """Run Levenberg-Marquardt on one neighbourhood from `parameters`, which receive the minimum.

    Returns the weighted mean squared error, or -1 if the point moves too far, leaves the image or has no texture.
    """
    height, width = coefficients.shape
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
            parameters[:] = trial
            matrix[:] = trial_matrix
            vector[:] = trial_vector
            error = trial_error
            damping = max(damping * 0.1, 1e-7)
        else:
            damping *= 10.0
        if length < least_step_px or damping > 1e6:
            break
    moved = (parameters[0] - x) ** 2 + (parameters[1] - y) ** 2
    return error if moved <= max_shift_px * max_shift_px else -1.0


@kernel
def refine_points(
    image, coefficients, first, parameters, weights, max_iterations, least_step_px, max_shift_px, errors
):
    """Refine every row of `parameters`; `first` are whole pixels of `image` with room around them."""
    radius = weights.shape[0] // 2
    for i in range(first.shape[0]):
        x, y = first[i, 0], first[i, 1]
        target = image[y - radius : y + radius + 1, x - radius : x + radius + 1]
        errors[i] = minimize_neighbourhood(
            target, coefficients, parameters[i], weights, max_iterations, least_step_px, max_shift_px
        )
