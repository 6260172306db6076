"""Compiled loops of track coding, in whole numbers so that both ends agree; described by their callers.

`counts` (contexts, 2) holds how often each context has seen a 0 and a 1, `motion` (N, 3, 2) the filtered
position, velocity and last residual of each track in 1/256 units.
"""

import numpy as np

from dvc._jit import kernel

LOST = -1

LOSS = 0
# Contexts: one for the loss of a track, then as many as `CONTEXTS_PER_CLASS` for each class of magnitudes
# that are expected, in x and in y.
NUM_CLASSES = 10
NUM_EXPONENTS = 12
ZERO = 0  # whether the residual is not 0, where the prediction is near a whole number
ZERO_FAR = NUM_EXPONENTS  # the same where it is not
MANTISSA = NUM_EXPONENTS + 2
SIGN = MANTISSA + NUM_EXPONENTS
CONTEXTS_PER_CLASS = SIGN + 3
NUM_CONTEXTS = 1 + 2 * NUM_CLASSES * CONTEXTS_PER_CLASS
MAX_DECISIONS = 1 + 2 * 48  # of one track at one instant

_COUNT_STEP = 16
_MAX_COUNT = 64 * _COUNT_STEP
_CLASS_BOUNDS = np.array([64, 102, 164, 262, 524, 1048, 2096, 4192, 8384])

# ---- point sets ----


@kernel
def min_distance(points, limit):
    """Largest whole number, up to `limit`, that no distance of two points falls below."""
    least = np.int64(limit) * limit
    for i in range(points.shape[0]):
        for j in range(i):
            dx, dy = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            least = min(least, dx * dx + dy * dy)
    root = 0
    while (root + 1) * (root + 1) <= least:
        root += 1
    return root


@kernel
def column_decisions(columns, num_columns):
    """Steps to the next column (1) and points (0), with their probabilities by what is left of both."""
    count = columns.size
    decisions = np.empty(count + num_columns, np.int32)
    probabilities = np.empty(count + num_columns, np.float64)
    n, column = 0, 0
    for k in range(count):
        while True:
            steps_left = num_columns - 1 - column
            if steps_left == 0:
                break
            probabilities[n] = steps_left / (steps_left + count - k)
            decisions[n] = column < columns[k]
            n += 1
            if column == columns[k]:
                break
            column += 1
    return decisions[:n], probabilities[:n]


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
def row_ranks(points, distance, num_rows):
    """Rank of the row of each point among those that are free, and how many these are."""
    ranks = np.empty(points.shape[0], np.int32)
    bounds = np.empty(points.shape[0], np.int32)
    free = np.empty(num_rows, np.bool_)
    for k in range(points.shape[0]):
        bounds[k] = free_rows(points, k, distance, free)
        ranks[k] = free[: points[k, 1]].sum()
    return ranks, bounds


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
def predict(
    position,
    motion,
    i,
    weights,
    sides,
    started,
    prediction,
):
    """Predict track `i` from its past and from those before it at the same instant, of known `position`.

    The prediction stays inside the frame, whose `sides` are given. `prediction` (2, 3) receives, for x and
    y, the position and the correction of the velocity in 1/256 units and the class of the magnitude of the
    residual to expect.
    """
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
def follow(position, motion, i, prediction):
    """Note the residual of track `i`, whose position is known now."""
    for axis in range(2):
        motion[i, 2, axis] = position[i, axis] * 256 - prediction[axis, 0]


@kernel
def advance(
    position,
    motion,
    predictions,
    sides,
    started,
):
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
def first_context(axis, prediction):
    """Return where the contexts of a residual begin."""
    return 1 + (axis * NUM_CLASSES + prediction[axis, 2]) * CONTEXTS_PER_CLASS


@kernel
def zero_context(base, predicted):
    """Return the context of whether a residual is 0."""
    fraction = ((predicted + 128) & 255) - 128
    return base + (ZERO_FAR if abs(fraction) > 64 else ZERO)


@kernel
def sign_context(base, predicted):
    """Return the context of the sign of a residual."""
    fraction = ((predicted + 128) & 255) - 128
    return base + SIGN + (fraction > -38) + (fraction > 38)


@kernel
def exponent_context(base, exponent):
    """Return the context of whether the exponent of a magnitude is larger than this, at least 1."""
    return base + min(exponent, NUM_EXPONENTS - 1)


@kernel
def mantissa_context(base, exponent):
    """Return the context of the first digit after the leading one."""
    return base + MANTISSA + min(exponent, NUM_EXPONENTS - 1)


@kernel
def probability(counts, context):
    """Probability of a 1."""
    return counts[context, 1] / (counts[context, 0] + counts[context, 1])


@kernel
def adapt(counts, context, decision):
    """Count a decision; old ones fade."""
    counts[context, decision] += _COUNT_STEP
    if counts[context, 0] + counts[context, 1] > _MAX_COUNT:
        counts[context, 0] = (counts[context, 0] + 1) >> 1
        counts[context, 1] = (counts[context, 1] + 1) >> 1


@kernel
def _note(counts, context, decision, decisions, probabilities, n):
    decisions[n] = decision
    probabilities[n] = probability(counts, context)
    adapt(counts, context, decision)
    return n + 1


@kernel
def _note_residual(counts, residual, base, predicted, decisions, probabilities, n):
    magnitude, exponent = abs(residual) + 1, 0
    while magnitude >> (exponent + 1):
        exponent += 1
    n = _note(counts, zero_context(base, predicted), int(exponent > 0), decisions, probabilities, n)
    if exponent == 0:
        return n
    n = _note(counts, sign_context(base, predicted), int(residual > 0), decisions, probabilities, n)
    for k in range(1, exponent + 1):
        more = int(k < exponent)
        n = _note(counts, exponent_context(base, k), more, decisions, probabilities, n)
    digit = magnitude >> (exponent - 1) & 1
    n = _note(counts, mantissa_context(base, exponent), digit, decisions, probabilities, n)
    for k in range(exponent - 2, -1, -1):
        decisions[n], probabilities[n] = magnitude >> k & 1, 0.5
        n += 1
    return n


@kernel
def instant_decisions(
    position,
    live,
    num_given,
    motion,
    weights,
    sides,
    started,
    counts,
):
    """Decisions that code one instant of the tracks that were `live` in the one before.

    The first `num_given` are known to the other side: they only help to predict.
    """
    decisions = np.empty(position.shape[0] * MAX_DECISIONS, np.int32)
    probabilities = np.empty(decisions.size, np.float64)
    predictions = np.zeros((position.shape[0], 2, 3), np.int64)
    n = 0
    for i in range(position.shape[0]):
        if not live[i]:
            continue
        if i >= num_given:
            lost = int(position[i, 0] == LOST)
            n = _note(counts, LOSS, lost, decisions, probabilities, n)
            if lost:
                continue
        predict(position, motion, i, weights, sides, started, predictions[i])
        for axis in range(2 if i >= num_given else 0):
            predicted = predictions[i, axis, 0]
            residual = position[i, axis] - ((predicted + 128) >> 8)
            base = first_context(axis, predictions[i])
            n = _note_residual(counts, residual, base, predicted, decisions, probabilities, n)
        follow(position, motion, i, predictions[i])
    advance(position, motion, predictions, sides, started)
    return decisions[:n], probabilities[:n]
