"""Compiled loops of the coding of points and of residuals, in a fixed order so that both ends agree."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.entropy.mixing import SQUASH, STRETCH, STRETCH_LIMIT, TABLE_SIZE
from dvc.entropy.range_coder import FAILED, code_decision, code_uniform

LOST = -1
GRID_EXPONENTS, DISTANCES = 8, 256
"""Number of grids and of distances of points."""
MAX_CELLS = 2**18
"""Largest number of cells of a grid with directly coded first positions."""
_MAX_GUARD = 256
NUM_STAGES, NUM_NODES = 5, 25
"""Number of decisions of a residual with own curves, and of nodes of each curve."""
MAX_UNARY = 15
MAX_EXPONENT = 24
MAX_SYMBOLS = 1 + 2 * (2 + MAX_UNARY + 2 * MAX_EXPONENT)
NODE_STEP = 0.73
NODE_LIMIT = 8.4
_RATE = 0.02


class Models(NamedTuple):
    """Probabilities that adapt."""

    curves: NDArray[np.float64]  # probability of a 1 in each stage by the one that was computed
    tables: NDArray[np.float64]  # as `dvc.entropy.mixing.logistic_tables` returns them
    losses: NDArray[np.float64]  # tracks that were lost, and all, in each context


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


@kernel
def min_square(points, taken):
    """Return the least squared distance of points from other points; 0 without other points."""
    least = np.int64(2**62 if taken.shape[0] else 0)
    for i in range(points.shape[0]):
        for j in range(taken.shape[0]):
            dx, dy = points[i, 0] - taken[j, 0], points[i, 1] - taken[j, 1]
            least = min(least, dx * dx + dy * dy)
    return least


@kernel
def take_guarded(free, taken, guard, exponent):
    """Take the cells nearer than `guard` cells to one of the points in `taken` off those that are free."""
    least = (guard << exponent) ** 2
    for j in range(taken.shape[0]):
        column, row = taken[j, 0] >> exponent, taken[j, 1] >> exponent
        for x in range(max(column - guard, 0), min(column + guard + 2, free.shape[0])):
            dx = (x << exponent) - taken[j, 0]
            for y in range(max(row - guard, 0), min(row + guard + 2, free.shape[1])):
                dy = (y << exponent) - taken[j, 1]
                if dx * dx + dy * dy < least:
                    free[x, y] = False


@inlined_kernel
def count_near(near, x, y, reach, most):
    """Count a point in the cells within `reach`, and later in the scan; up to a number."""
    for column in range(x, min(near.shape[0], x + reach + 1)):
        for row in range(max(0, y - reach), min(near.shape[1], y + reach + 1)):
            if (column - x) ** 2 + (row - y) ** 2 <= reach * reach and near[column, row] < most:
                near[column, row] += 1


@kernel
def code_occupancy(coder, points, free, distance, rates):
    """Code points in column scan, cell by cell: one decision for each of the `free` cells."""
    count, k = points.shape[0], 0
    num_free = np.int64(free.sum())
    near = np.zeros(free.shape, np.uint8)
    for x in range(free.shape[0]):
        for y in range(free.shape[1]):
            left = count - k
            if left == 0:
                return True
            if not free[x, y]:
                continue
            room = max(float(num_free - (left - 1) * distance * distance), float(left))
            expected = left / room
            here = 1
            if left < num_free:
                ratio = rates[near[x, y], 0] / rates[near[x, y], 1]
                probability = min(max(expected * ratio, 1e-4), 0.97)
                here = code_decision(coder, probability, int(points[k, 0] == x and points[k, 1] == y))
            rates[near[x, y], 1] += expected
            num_free -= 1
            free[x, y] = False
            if here:
                rates[near[x, y], 0] += 1.0
                points[k, 0], points[k, 1] = x, y
                for column in range(x, min(free.shape[0], x + distance + 1)):
                    for row in range(max(0, y - distance), min(free.shape[1], y + distance + 1)):
                        is_near = (column - x) ** 2 + (row - y) ** 2 < distance * distance
                        if is_near and free[column, row]:
                            free[column, row] = False
                            num_free -= 1
                count_near(near, x, y, (5 * distance + 1) // 2, rates.shape[0] - 1)
                k += 1
    return k == count


@kernel
def code_first(coder, points, taken, sides, rates):
    """Code the starts of tracks, away from those that are taken; return whether all had room."""
    exponent = grid_exponent(points)
    distance = min_distance(points >> exponent, DISTANCES - 1)
    exponent, distance = code_grid(coder, exponent, distance)
    columns, rows = ((sides[0] - 1) >> exponent) + 1, ((sides[1] - 1) >> exponent) + 1
    cells = points >> exponent
    if distance == 0 or columns * rows > MAX_CELLS:
        fits = code_points(coder, cells, columns, rows, distance)
    else:
        nearest = np.int64(np.sqrt(min_square(points, taken) >> 2 * exponent))
        guard = code_uniform(coder, _MAX_GUARD, min(nearest, _MAX_GUARD - 1))
        free = np.ones((columns, rows), np.bool_)
        take_guarded(free, taken, guard, exponent)
        fits = code_occupancy(coder, cells, free, distance, rates)
    for i in range(points.shape[0]):
        points[i, 0], points[i, 1] = cells[i, 0] << exponent, cells[i, 1] << exponent
    return fits


@kernel
def spread_order(count):
    """Numbers below `count` by their binary digits in reverse, so that the first ones are far apart."""
    order = np.empty(count, np.int64)
    digits = 0
    while 1 << digits < count:
        digits += 1
    index = 0
    for k in range(1 << digits):
        number = 0
        for digit in range(digits):
            number |= (k >> digit & 1) << (digits - 1 - digit)
        if number < count:
            order[index] = number
            index += 1
    return order


@inlined_kernel
def logistic(tables, z):
    """Logistic function by table."""
    z = min(max(z, 0.01 - STRETCH_LIMIT), STRETCH_LIMIT - 0.01)
    return float(tables[SQUASH, np.int64((z + STRETCH_LIMIT) * (TABLE_SIZE / (2 * STRETCH_LIMIT)))])


@inlined_kernel
def code_refined(coder, models, stage, probability, decision):
    """Code a decision by a probability that was computed, as the curve of its stage has learnt to read it."""
    curves = models.curves
    probability = min(max(probability, 1.0 / TABLE_SIZE), 1.0 - 1.0 / TABLE_SIZE)
    stretched = models.tables[STRETCH, np.int64(probability * TABLE_SIZE)]
    position = (stretched + NODE_LIMIT) / NODE_STEP
    node = np.int64(position)
    share = position - node
    refined = (1.0 - share) * curves[stage, node] + share * curves[stage, node + 1]
    decision = code_decision(coder, min(max(refined, 1.0 / TABLE_SIZE), 1.0 - 1.0 / TABLE_SIZE), decision)
    curves[stage, node] += _RATE * (1.0 - share) * (decision - curves[stage, node])
    curves[stage, node + 1] += _RATE * share * (decision - curves[stage, node + 1])
    return decision


@inlined_kernel
def code_rest(coder, rest):
    """Code a number of at least 0 by the code of Exp-Golomb, as it is."""
    rest += 1
    exponent = 0
    while code_decision(coder, 0.5, int(rest >> (exponent + 1) > 0)):
        exponent += 1
        if exponent > MAX_EXPONENT:
            coder.fields[FAILED] = 1
            return 0
    coded = np.int64(1)
    for k in range(exponent - 1, -1, -1):
        coded = coded << 1 | code_decision(coder, 0.5, rest >> k & 1)
    return coded - 1


@inlined_kernel
def code_residual(coder, models, nearest, offset, scale, residual):
    """Code a whole number that a logistic density of mean `offset`, within half a unit of 0, lets expect."""
    tables = models.tables
    below = logistic(tables, (-0.5 - offset) / scale)
    above = 1.0 - logistic(tables, (0.5 - offset) / scale)
    if not code_refined(coder, models, 0, above + below, int(residual != 0)):
        return nearest
    positive = code_refined(coder, models, 1, above / (above + below), int(residual > 0))
    magnitude, toward = np.int64(1), (offset if positive else -offset)
    size = abs(residual)
    while True:
        here = logistic(tables, (toward + 0.5 - magnitude) / scale)
        beyond = logistic(tables, (toward - 0.5 - magnitude) / scale)
        more = min(max(beyond / here, 1e-3), 0.98)
        if not code_refined(coder, models, 2 + min(magnitude - 1, 2), more, int(size > magnitude)):
            break
        magnitude += 1
        if magnitude > MAX_UNARY:
            magnitude += code_rest(coder, size - magnitude)
            break
    return nearest + magnitude if positive else nearest - magnitude
