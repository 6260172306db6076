"""Cubic B-splines of images: their coefficients, and samples of them between pixels.

Kernels take images as float64 arrays [row, column], points as (x, y), and the coefficients of `spline`.
"""

import math

import numpy as np

from dvc._jit import inlined_kernel, kernel
from dvc.arrays import Bytes, Floats

Weights = tuple[float, float, float, float]

SPLINE_POLE = math.sqrt(3.0) - 2.0
POLE_HORIZON = 40
"""Number of powers of the pole that can change a double."""
MARGIN = 2
"""Number of coefficients around the image that influence samples within it."""
_SIXTH = 1.0 / 6.0


def spline(image: Bytes | Floats) -> Floats:
    """Return the coefficients of `spline_coefficients` with a margin around them, as kernels take them."""
    return np.pad(spline_coefficients(image), MARGIN, "reflect")


def half_pixel_samples(spline: Floats) -> Floats:
    """Sample such a spline half a pixel apart: (2 H, 2 W)."""
    for _ in range(2):
        before, at, after, beyond = (spline[1 + k : len(spline) - 3 + k] for k in range(4))
        samples = np.empty((2 * len(at), at.shape[1]))
        samples[::2] = (before + 4.0 * at + after) / 6.0
        samples[1::2] = (before + 23.0 * (at + after) + beyond) / 48.0
        spline = np.ascontiguousarray(samples.T)
    return spline


def spline_coefficients(image: Bytes | Floats) -> Floats:
    """Compute the coefficients of the cubic B-spline that interpolates an image, mirrored at its edges."""
    along_columns = _filter_rows(np.asarray(image, dtype=np.float64))
    return np.ascontiguousarray(_filter_rows(np.ascontiguousarray(along_columns.T)).T)


def _filter_rows(samples: Floats) -> Floats:
    """Apply the recursive filter down the first axis, causal and then anticausal."""
    length, z = len(samples), SPLINE_POLE
    if length < 2:
        return samples.copy()
    filtered = samples * 6.0
    start, power = filtered[0].copy(), 1.0
    for k in range(1, POLE_HORIZON):
        power *= z
        turned = k % (2 * length - 2)
        start += power * filtered[min(turned, 2 * length - 2 - turned)]
    filtered[0] = start
    for k in range(1, length):
        filtered[k] += z * filtered[k - 1]
    filtered[-1] = z / (z * z - 1.0) * (filtered[-1] + z * filtered[-2])
    for k in range(length - 2, -1, -1):
        filtered[k] = z * (filtered[k + 1] - filtered[k])
    return filtered


@kernel
def sample_square(
    coefficients: Floats, x: float, y: float, radius: int, values: Floats, dx: Floats, dy: Floats
) -> None:
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
def sample_affine(
    coefficients: Floats, parameters: Floats, radius: int, values: Floats, dx: Floats, dy: Floats
) -> None:
    """Interpolate an affine image of a square, and its gradient: x and y, then the rows of the matrix."""
    x, y = parameters[0], parameters[1]
    xx, xy, yx, yy = parameters[2], parameters[3], parameters[4], parameters[5]
    last_x, last_y = coefficients.shape[1] - 1.0 - 2 * MARGIN, coefficients.shape[0] - 1.0 - 2 * MARGIN
    for i in range(2 * radius + 1):
        for j in range(2 * radius + 1):
            u, v = x + xx * (j - radius) + xy * (i - radius), y + yx * (j - radius) + yy * (i - radius)
            u, v = min(max(u, 0.0), last_x), min(max(v, 0.0), last_y)
            column, row = int(u), int(v)
            across, down = spline_weights(u - column), spline_weights(v - row)
            values[i, j] = sample(coefficients, column, row, across, down)
            dx[i, j] = sample(coefficients, column, row, spline_slopes(u - column), down)
            dy[i, j] = sample(coefficients, column, row, across, spline_slopes(v - row))


@inlined_kernel
def sample(coefficients: Floats, column: int, row: int, across: Weights, down: Weights) -> float:
    """Interpolate between the sixteen coefficients around a position."""
    x, y = np.uint64(column - 1 + MARGIN), np.uint64(row - 1 + MARGIN)
    return weighted(
        down,
        along_row(across, coefficients, y, x),
        along_row(across, coefficients, y + np.uint64(1), x),
        along_row(across, coefficients, y + np.uint64(2), x),
        along_row(across, coefficients, y + np.uint64(3), x),
    )


@inlined_kernel
def along_row(weights: Weights, coefficients: Floats, row: np.uint64, column: np.uint64) -> float:
    """Interpolate between four coefficients of a row, from a column on; unsigned indices need no tests."""
    value: float = (
        weights[0] * coefficients[row, column]
        + weights[1] * coefficients[row, column + np.uint64(1)]
        + weights[2] * coefficients[row, column + np.uint64(2)]
        + weights[3] * coefficients[row, column + np.uint64(3)]
    )
    return value


@inlined_kernel
def weighted(weights: Weights, a: float, b: float, c: float, d: float) -> float:
    """Return a weighted sum of four numbers."""
    return weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d


@inlined_kernel
def spline_weights(t: float) -> Weights:
    """Cubic B-spline at the four samples around a position."""
    s = 1.0 - t
    return (
        _SIXTH * s * s * s,
        _SIXTH * (4.0 - 6.0 * t * t + 3.0 * t * t * t),
        _SIXTH * (4.0 - 6.0 * s * s + 3.0 * s * s * s),
        _SIXTH * t * t * t,
    )


@inlined_kernel
def spline_slopes(t: float) -> Weights:
    """Return the derivative of `spline_weights`."""
    s = 1.0 - t
    return -0.5 * s * s, 0.5 * (3.0 * t * t - 4.0 * t), -0.5 * (3.0 * s * s - 4.0 * s), 0.5 * t * t


@kernel
def fits(x: float, y: float, radius: int, width: int, height: int) -> bool:
    """Return whether the square neighbourhood of a point lies inside the image."""
    return radius <= x <= width - 1 - radius and radius <= y <= height - 1 - radius
