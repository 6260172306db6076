"""Compiled loops of the coding of points, in whole numbers so that both ends agree."""

import numpy as np

from dvc._jit import kernel
from dvc.entropy.range_coder import code_decision, code_uniform

LOST = -1

# ---- positions ----


@kernel
def set_units(positions, scale, sides, units):
    """Round positions (P, 2) to units, `LOST` if they are not known; return whether all are in the frame."""
    inside = True
    for i in range(positions.shape[0]):
        known = np.isfinite(positions[i, 0]) and np.isfinite(positions[i, 1])
        for axis in range(2):
            units[i, axis] = LOST
            if known:
                units[i, axis] = np.int64(np.rint(min(max(positions[i, axis] * scale, -1.0), 2.0**20)))
                inside &= 0 <= units[i, axis] < sides[axis]
    return inside


@kernel
def is_lost_for_good(units):
    """Return whether no track of units (N, T, 2) comes back once it is lost."""
    for i in range(units.shape[0]):
        for t in range(1, units.shape[1]):
            if units[i, t - 1, 0] == LOST and units[i, t, 0] != LOST:
                return False
    return True


# ---- point sets ----

GRID_EXPONENTS, DISTANCES = 8, 256
"""Number of tracks of each kind."""


@kernel
def grid_exponent(points):
    """Return the power of two that divides all coordinates."""
    exponent = GRID_EXPONENTS - 1
    for i in range(points.shape[0]):
        while (points[i, 0] | points[i, 1]) & ((1 << exponent) - 1):
            exponent -= 1
    return exponent


@kernel
def code_grid(coder, exponent, distance):
    """Code which places points can have, and which distance they keep."""
    return code_uniform(coder, GRID_EXPONENTS, exponent), code_uniform(coder, DISTANCES, distance)


@kernel
def min_distance(points, limit):
    """Largest whole number, up to `limit`, that no distance of two points falls below."""
    square = np.int64(limit) * limit
    for i in range(points.shape[0]):
        for j in range(i):
            dx, dy = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            square = min(square, dx * dx + dy * dy)
    root = 0
    while (root + 1) * (root + 1) <= square:
        root += 1
    return root


@kernel
def free_rows(points, k, distance, free):
    """Mark the possible rows of point `k` in a known column; return their number."""
    free[:] = True
    if k > 0 and points[k - 1, 0] == points[k, 0]:  # the scan goes down
        free[: points[k - 1, 1]] = False
    for j in range(k):
        dx = points[k, 0] - points[j, 0]
        if dx < distance:
            reach = 0
            while dx * dx + (reach + 1) * (reach + 1) < distance * distance:
                reach += 1
            if dx * dx < distance * distance:
                free[max(points[j, 1] - reach, 0) : points[j, 1] + reach + 1] = False
    return int(free.sum())


@kernel
def code_points(coder, points, num_columns, num_rows, distance):
    """Code points in column scan: steps to the next column and points, then rows among the free ones."""
    count, column = points.shape[0], 0
    for k in range(count):
        steps_left = num_columns - 1 - column
        while steps_left > 0 and code_decision(
            coder, steps_left / (steps_left + count - k), int(column < points[k, 0])
        ):
            column += 1
            steps_left -= 1
        points[k, 0] = column
    free = np.empty(num_rows, np.bool_)
    for k in range(count):
        num_free = free_rows(points, k, distance, free)
        if num_free == 0:
            return False
        rank = code_uniform(coder, num_free, free[: points[k, 1]].sum())
        row = -1
        for _ in range(rank + 1):
            row += 1
            while not free[row]:
                row += 1
        points[k, 1] = row
    return True
