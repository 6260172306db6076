"""Compiled loops of track coding, in whole numbers so that both ends agree; described by their callers.

`counts` (contexts, 2) holds how often each context has seen a 0 and a 1, `motion` (N, 3, 2) the filtered
position, velocity and last residual of each track in 1/256 units.
"""

import numpy as np

from dvc._jit import kernel
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS, code_exp_golomb
from dvc.entropy.contexts import code_adaptive
from dvc.entropy.range_coder import code_decision, code_uniform

LOST = -1

LOSS = 0
# Contexts: one for the loss of a track, then as many as `CONTEXTS_PER_CLASS` for each class of magnitudes
# that are expected, in x and in y.
NUM_CLASSES = 10
ZERO = 0  # whether the residual is not 0, where the prediction is near a whole number
ZERO_FAR = NUM_EXPONENTS  # the same where it is not
MANTISSA = NUM_EXPONENTS + 2
SIGN = MANTISSA + NUM_EXPONENTS
CONTEXTS_PER_CLASS = SIGN + 3
MAX_SYMBOLS = 1 + 2 * MAX_DECISIONS  # of one track at one instant

_CLASS_BOUNDS = np.array([64, 102, 164, 262, 524, 1048, 2096, 4192, 8384])

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
    """Tell whether no track of units (N, T, 2) comes back once it is lost."""
    for i in range(units.shape[0]):
        for t in range(1, units.shape[1]):
            if units[i, t - 1, 0] == LOST and units[i, t, 0] != LOST:
                return False
    return True


# ---- point sets ----


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
    """Mark the rows where point `k`, whose column is known, can be; return how many there are."""
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
    """Code points in column scan: steps to the next column and points, then rows among those that are free.
    Code points in column scan: steps to the next column and points, then rows among those that are free.
    """
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


# ---- tracks ----


@kernel
def neighbour_weights(points, reach):
    """Weight of each point for each other, falling with the distance; `reach` is a squared distance."""
    count = points.shape[0]
    weights = np.empty((count, count), np.int64)
    for i in range(count):
        for j in range(count):
            dx, dy = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            ratio = (reach << 12) // (reach + dx * dx + dy * dy)
            weights[i, j] = ratio * ratio >> 8
    return weights


@kernel
def predict(position, motion, i, weights, sides, started, prediction):
    """Predict track `i` from its past and from those before it at the same instant, of known `position`."""
    for axis in range(2):
        correction, magnitude = np.int64(0), np.int64(0)
        total = np.int64(0)
        for j in range(i):
            if position[j, axis] != LOST:
                moved = position[j, axis] * 256 - motion[j, 0, axis] - motion[j, 1, axis]
                correction += weights[i, j] * moved
                magnitude += weights[i, j] * abs(motion[j, 2, axis])
                total += weights[i, j]
        correction //= total + 3932  # the velocity does not change, as a neighbour of little weight
        if started:
            magnitude = (magnitude + 40960 * abs(motion[i, 2, axis])) // (total + 40960)
        elif total > 0:
            magnitude //= total
        else:
            magnitude = np.int64(1024)
        predicted = motion[i, 0, axis] + motion[i, 1, axis] + correction
        prediction[axis, 0] = min(max(predicted, 0), 256 * (sides[axis] - 1))
        prediction[axis, 1] = correction
        prediction[axis, 2] = 0
        for bound in _CLASS_BOUNDS:
            prediction[axis, 2] += magnitude >= bound


@kernel
def advance(position, motion, predictions, sides, started):
    """Filter positions and velocities once all tracks of an instant are known."""
    for i in range(position.shape[0]):
        if position[i, 0] != LOST:
            for axis in range(2):
                residual = motion[i, 2, axis]
                motion[i, 0, axis] = predictions[i, axis, 0] + (13 * residual >> 4)
                share = residual >> 1 if started else residual
                velocity = motion[i, 1, axis] + predictions[i, axis, 1] + share
                fastest = 256 * sides[axis]
                motion[i, 1, axis] = min(max(velocity, -fastest), fastest)


@kernel
def code_coordinate(coder, counts, axis, prediction, coordinate):
    """Code a coordinate as its difference from the `prediction` (3,) of it, and return it."""
    base = 1 + (axis * NUM_CLASSES + prediction[2]) * CONTEXTS_PER_CLASS
    nearest = (prediction[0] + 128) >> 8
    fraction = prediction[0] - (nearest << 8)
    zero = base + (ZERO_FAR if abs(fraction) > 64 else ZERO)
    sign = base + SIGN + (fraction > -38) + (fraction > 38)
    residual = coordinate - nearest
    return nearest + code_exp_golomb(coder, counts, zero, sign, base, base + MANTISSA, residual)


@kernel
def code_instant(coder, position, live, num_given, motion, weights, sides, started, counts):
    """Code where the tracks are that were `live` in the instant before, and go on to the next."""
    predictions = np.zeros((position.shape[0], 2, 3), np.int64)
    for i in range(position.shape[0]):
        if not live[i]:
            continue
        given = i < num_given
        if not given and code_adaptive(coder, counts, LOSS, int(position[i, 0] == LOST)):
            continue
        predict(position, motion, i, weights, sides, started, predictions[i])
        for axis in range(2):
            prediction = predictions[i, axis]
            if not given:
                position[i, axis] = code_coordinate(coder, counts, axis, prediction, position[i, axis])
                if not 0 <= position[i, axis] < sides[axis]:
                    return False
            motion[i, 2, axis] = position[i, axis] * 256 - prediction[0]
    advance(position, motion, predictions, sides, started)
    return True
