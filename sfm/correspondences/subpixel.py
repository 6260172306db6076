"""Sub-pixel positions of second points: least squares between neighbourhoods by Levenberg-Marquardt."""

import numpy as np

from dvc._jit import inlined_kernel, kernel
from dvc.arrays import Bytes, Floats, Integers, Mask
from sfm.correspondences.spline_sampling import MARGIN, fits, sample_affine, sample_square, spline

Row = tuple[float, float, float]


RADIUS_PX = 5
"""Half size of a neighbourhood."""
MAX_STEPS = 12
"""Largest number of steps of Levenberg-Marquardt, rejected steps included."""
MIN_STEP_PX = 2e-3
"""Length of a step below which the search ends."""
MAX_SHIFT_PX = 2.0
"""Largest distance of a point from its start."""


def refine(
    luma0: Bytes,
    luma1: Bytes,
    first: Floats,
    second: Floats,
    *,
    affine: bool = False,
    shapes: Floats | None = None,
) -> tuple[Floats, Floats, Mask]:
    """Move second points to the neighbourhoods most like those of the first points, which are whole pixels.

    Affine neighbourhoods may also turn, scale and shear, from `shapes` on if these are given. Returns the
    positions, their mean squared errors (inf: failed), and a mask of successes.
    """
    check_pair(luma0, luma1)
    if not np.array_equal(first, np.rint(first)):
        raise ValueError("`first` must be in whole pixels")
    refined, error = second.copy(), np.full(len(first), np.inf)
    room = np.flatnonzero(inside(first, luma0, RADIUS_PX))
    parameters = second[room]
    if affine:
        start = np.tile(np.eye(2), (len(first), 1, 1)) if shapes is None else shapes
        parameters = np.column_stack([parameters, start[room].reshape(-1, 4)])
    image, pixels, least = luma0.astype(np.float64), first[room].astype(np.int64), np.empty(len(room))
    refine_points(image, spline(luma1), pixels, parameters, window(RADIUS_PX), least)
    good = least >= 0.0
    refined[room[good]], error[room[good]] = parameters[good, :2], least[good]
    return refined, error, np.isfinite(error)


def check_pair(luma0: Bytes, luma1: Bytes) -> None:
    """Raise `ValueError` unless both frames are planes of one size."""
    if luma0.ndim != 2 or luma0.shape != luma1.shape:
        raise ValueError(f"`luma0` and `luma1` must have one shape (H, W), got {luma0.shape}, {luma1.shape}")


def inside(points: Floats, luma: Bytes, distance_px: float) -> Mask:
    """Return a mask of the points that keep a distance from the frame's edge."""
    last = np.array([luma.shape[1] - 1, luma.shape[0] - 1])
    return np.asarray(((points >= distance_px) & (points <= last - distance_px)).all(axis=1))


def window(radius_px: int) -> Floats:
    """Return the weights of a neighbourhood: Epanechnikov's kernel, which reaches zero beyond its corners."""
    offset = np.arange(-radius_px, radius_px + 1, dtype=np.float64)
    weights: Floats = 2.0 * (radius_px + 1) ** 2 - (offset[:, None] ** 2 + offset**2)
    return np.asarray(weights / weights.sum())


@kernel
def refine_points(
    image: Floats, coefficients: Floats, first: Integers, parameters: Floats, weights: Floats, errors: Floats
) -> None:
    """Minimise errors over the rows of `parameters`, in place, around whole pixels `first`; -1: failed."""
    height, width = coefficients.shape[0] - 2 * MARGIN, coefficients.shape[1] - 2 * MARGIN
    size, count = weights.shape[0], parameters.shape[1]
    radius = size // 2
    values, dx, dy = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    matrix, trial_matrix = np.empty((count, count)), np.empty((count, count))
    vector, trial_vector, step, trial = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for i in range(first.shape[0]):
        left, top = first[i, 0] - radius, first[i, 1] - radius
        target, best = image[top : top + size, left : left + size], parameters[i]
        x, y = best[0], best[1]
        errors[i] = -1.0
        if not fits(x, y, radius, width, height):
            continue
        sample_neighbourhood(coefficients, best, radius, values, dx, dy)
        error = normal_equations(target, values, dx, dy, weights, matrix, vector)
        damping = 1e-3
        for _ in range(MAX_STEPS):
            if not solve_damped(matrix, vector, damping, step):
                error = -1.0
                break
            for a in range(count):  # expressions of arrays take long to compile
                trial[a] = best[a] + step[a]
            length = np.sqrt(step[0] * step[0] + step[1] * step[1])
            trial_error = np.inf
            if fits(trial[0], trial[1], radius, width, height) and length <= 2.0 * MAX_SHIFT_PX:
                sample_neighbourhood(coefficients, trial, radius, values, dx, dy)
                trial_error = normal_equations(target, values, dx, dy, weights, trial_matrix, trial_vector)
            if trial_error <= error:
                for a in range(count):
                    best[a], vector[a] = trial[a], trial_vector[a]
                    for b in range(count):
                        matrix[a, b] = trial_matrix[a, b]
                error = trial_error
                damping = max(damping * 0.1, 1e-7)
            else:
                damping *= 10.0
            if length < MIN_STEP_PX or damping > 1e6:
                break
        if (best[0] - x) ** 2 + (best[1] - y) ** 2 <= MAX_SHIFT_PX * MAX_SHIFT_PX:
            errors[i] = error


@kernel
def sample_neighbourhood(
    coefficients: Floats, parameters: Floats, radius: int, values: Floats, dx: Floats, dy: Floats
) -> None:
    """Interpolate the second neighbourhood that 2 or 6 parameters describe."""
    if parameters.size == 2:
        sample_square(coefficients, parameters[0], parameters[1], radius, values, dx, dy)
    else:
        sample_affine(coefficients, parameters, radius, values, dx, dy)


@kernel
def normal_equations(
    target: Floats, values: Floats, dx: Floats, dy: Floats, weights: Floats, matrix: Floats, vector: Floats
) -> float:
    """Set up the normal equations of the neighbourhood's parameters, the mean difference being free."""
    size, num_parameters = target.shape[0], vector.size
    mean, mean_difference, error = np.empty(num_parameters), 0.0, 0.0
    mean[:] = 0.0
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
def add_row(xx: Row, xy: Row, yy: Row, down: int, matrix: Floats) -> None:
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
def solve_damped(matrix: Floats, vector: Floats, damping: float, step: Floats) -> bool:
    """Solve ``(A + damping diag(A)) step = -vector`` by Cholesky factors; False if A is not definite."""
    n = vector.size
    lower = np.empty((n, n))
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
