"""Plain twins of the loops over neighbourhoods, one sample at a time from the definitions."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def basis(distance: float) -> float:
    """Return the cubic B-spline at a distance from its centre."""
    d = abs(distance)
    if d >= 2.0:
        return 0.0
    return (2.0 - d) ** 3 / 6.0 if d >= 1.0 else (4.0 - 6.0 * d * d + 3.0 * d**3) / 6.0


def mirrored(index: int, length: int) -> int:
    """Reflect an index about the first and last sample."""
    period = 2 * (length - 1)
    index %= period
    return min(index, period - index)


def interpolated(coefficients: Floats, x: float, y: float) -> float:
    """Return the spline's value at a point."""
    height, width = coefficients.shape
    return sum(
        basis(y - i) * basis(x - j) * coefficients[mirrored(i, height), mirrored(j, width)]
        for i in range(int(np.floor(y)) - 1, int(np.floor(y)) + 3)
        for j in range(int(np.floor(x)) - 1, int(np.floor(x)) + 3)
    )


def offsets(radius: int) -> list[tuple[int, int]]:
    """Return the offsets (x, y) of a square, row by row."""
    return [(j, i) for i in range(-radius, radius + 1) for j in range(-radius, radius + 1)]


def neighbourhood(coefficients: Floats, x: float, y: float, affine: Floats, radius: int) -> Floats:
    """Return the samples that an affine map makes of a square, row by row."""
    points = [np.array([x, y]) + affine @ np.array(offset) for offset in offsets(radius)]
    return np.array([interpolated(coefficients, *point) for point in points])


def free_mean_error(target: Floats, values: Floats, weights: Floats) -> float:
    """Return the least weighted squared error over all constants added to the values; weights sum to 1."""
    difference = values.ravel() - target.ravel()
    constant = np.average(difference, weights=weights.ravel())
    return float(np.average((difference - constant) ** 2, weights=weights.ravel()))


def normal_equations(
    target: Floats, values: Floats, dx: Floats, dy: Floats, weights: Floats, num_parameters: int
) -> tuple[Floats, Floats]:
    """Return J'WJ and J'Wr with a last parameter, the mean difference, eliminated by its Schur complement."""
    radius = target.shape[0] // 2
    x, y = np.array(offsets(radius), dtype=np.float64).T
    gx, gy = dx.ravel(), dy.ravel()
    columns = [gx, gy] + ([gx * x, gx * y, gy * x, gy * y] if num_parameters == 6 else [])
    jacobian, w = np.column_stack([*columns, np.ones(x.size)]), np.diag(weights.ravel())
    full = jacobian.T @ w @ jacobian
    right = jacobian.T @ w @ (values - target).ravel()
    coupling = full[:-1, -1:] / full[-1, -1]
    return full[:-1, :-1] - coupling @ full[-1:, :-1], right[:-1] - coupling[:, 0] * right[-1]
