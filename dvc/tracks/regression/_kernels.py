"""Compiled loops of track coding by regression; described by their callers, and in `docs/tracks.md`.

Products, sums, quotients and roots of double precision in a fixed order, the same on every processor. All is
in units of the last digit of the positions.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.mixing import SQUASH, STRETCH, STRETCH_LIMIT, TABLE_SIZE
from dvc.entropy.range_coder import FAILED, code_decision

LOST = -1
NUM_FEATURES = 10
NUM_NEIGHBOURS = 8
NUM_STAGES, NUM_NODES = 5, 25
"""Decisions of a residual that are refined apart, and nodes at which each curve is kept."""
MAX_UNARY = 15
MAX_EXPONENT = 24
MAX_SYMBOLS = 1 + 2 * (2 + MAX_UNARY + 2 * MAX_EXPONENT)
LEVEL, WEIGHT, SQUARES = 0, 1, 2
"""Places in `Motion.learned`: mean magnitude, sum of weights, squared coefficients."""
NUM_LEARNED = SQUARES + NUM_FEATURES

NODE_STEP = 0.73
NODE_LIMIT = 8.4
_RATE = 0.02
_LIMIT = 1e4


class Motion(NamedTuple):
    """What both ends know of tracks in one direction of time, before an instant.

    Attributes
    ----------
    first : ndarray of shape (N, 2), float64
        Where the tracks begin.
    place, velocity : ndarray of shape (N, 2), float64
        Filtered position, and motion from the instant before.
    magnitude : ndarray of shape (N,), float64
        Of the residuals to expect.
    neighbours : ndarray of shape (N, 8), int64
        Nearest tracks before each one; -1: none.
    weights : ndarray of shape (N, 8), float64
        How much each of them tells.
    learned : ndarray of shape (12,), float64
        Mean magnitude of residuals, and squares of the coefficients of motion.
    """

    first: NDArray[np.float64]
    place: NDArray[np.float64]
    velocity: NDArray[np.float64]
    magnitude: NDArray[np.float64]
    neighbours: NDArray[np.int64]
    weights: NDArray[np.float64]
    learned: NDArray[np.float64]


class Instant(NamedTuple):
    """What is found while an instant is coded.

    Attributes
    ----------
    features : ndarray of shape (N, 10), float64
        Of each track, before the instant.
    starts, predictions : ndarray of shape (N, 2), float64
        Where the track would be under no new motion, and where it is expected.
    sizes : ndarray of shape (N,), float64
        Magnitude of its residual.
    known : ndarray of shape (N,), bool
        Whether it is known at the instant.
    coefficients, covariance : ndarray of shape (10, 2) and (10, 10), float64
        The new motion, and how uncertain it is.
    gain, said, errors : ndarray of shape (10,), (3,) and (2,), float64
        Of one track; room that is used again.
    """

    features: NDArray[np.float64]
    starts: NDArray[np.float64]
    predictions: NDArray[np.float64]
    sizes: NDArray[np.float64]
    known: NDArray[np.bool_]
    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]
    gain: NDArray[np.float64]
    said: NDArray[np.float64]
    errors: NDArray[np.float64]


class Models(NamedTuple):
    """Probabilities that adapt.

    Attributes
    ----------
    curves : ndarray of shape (5, 25), float64
        Probability of a 1 in each stage by the one that was computed.
    tables : ndarray of shape (3, 4096), float64
        As `dvc.entropy.mixing.logistic_tables` returns them.
    losses : ndarray of shape (3, 2), float64
        Tracks that were lost, and all, in each context.
    """

    curves: NDArray[np.float64]
    tables: NDArray[np.float64]
    losses: NDArray[np.float64]


# ---- first positions ----


@kernel
def count_near(points, k, x, y, reach):
    """Count the points before number `k` of a column scan within a distance."""
    count = 0
    for j in range(k - 1, -1, -1):
        dx, dy = x - points[j, 0], y - points[j, 1]
        if dx > reach:
            break
        count += dx * dx + dy * dy <= reach * reach
    return count


@kernel
def occupy(free, x, y, distance):
    """Take the cells nearer than `distance`, and later in the scan, off those that are free; count them."""
    taken = 0
    for column in range(x, min(free.shape[0], x + distance + 1)):
        for row in range(max(0, y - distance), min(free.shape[1], y + distance + 1)):
            near = (column - x) ** 2 + (row - y) ** 2 < distance * distance
            if near and free[column, row]:
                free[column, row] = False
                taken += 1
    return taken


@kernel
def code_occupancy(coder, points, free, distance, told):
    """Code points in column scan, cell by cell: whether there is one in each of the `free` cells.

    `distance` of at least 1 is what all pairs keep; `told` (classes, 2) counts points found and expected, by
    how many points are near. When reading, `points` (N, 2) receives them. Return whether there is room.
    """
    count, k = points.shape[0], 0
    num_free = np.int64(free.sum())
    for x in range(free.shape[0]):
        for y in range(free.shape[1]):
            left = count - k
            if left == 0:
                return True
            if not free[x, y]:
                continue
            near = min(count_near(points, k, x, y, (5 * distance + 1) // 2), told.shape[0] - 1)
            room = max(float(num_free - (left - 1) * distance * distance), float(left))
            expected = left / room
            here = 1
            if left < num_free:
                ratio = told[near, 0] / told[near, 1]
                probability = min(max(expected * ratio, 1e-4), 0.97)
                here = code_decision(coder, probability, int(points[k, 0] == x and points[k, 1] == y))
            told[near, 1] += expected
            num_free -= 1
            free[x, y] = False
            if here:
                told[near, 0] += 1.0
                points[k, 0], points[k, 1] = x, y
                num_free -= occupy(free, x, y, distance)
                k += 1
    return k == count


# ---- neighbours ----


@kernel
def nearest_before(first, reach, neighbours, weights):
    """Find the nearest tracks before each one, nearest first, and their weights; `reach` is squared."""
    for i in range(first.shape[0]):
        neighbours[i] = -1
        for j in range(i):
            dx, dy = first[i, 0] - first[j, 0], first[i, 1] - first[j, 1]
            ratio = reach / (reach + (dx * dx + dy * dy))
            weight = ratio * ratio
            k = NUM_NEIGHBOURS
            while k > 0 and (neighbours[i, k - 1] < 0 or weights[i, k - 1] < weight):
                k -= 1
            if k < NUM_NEIGHBOURS:
                for place in range(NUM_NEIGHBOURS - 1, k, -1):
                    neighbours[i, place] = neighbours[i, place - 1]
                    weights[i, place] = weights[i, place - 1]
                neighbours[i, k], weights[i, k] = j, weight


# ---- residuals ----


@kernel
def logistic(tables, z):
    """Logistic function by table."""
    z = min(max(z, 0.01 - STRETCH_LIMIT), STRETCH_LIMIT - 0.01)
    return float(tables[SQUASH, np.int64((z + STRETCH_LIMIT) * (TABLE_SIZE / (2 * STRETCH_LIMIT)))])


@kernel
def code_refined(coder, models, stage, probability, decision):
    """Code a decision by a probability that was computed, as the curve of its stage has learnt to read it."""
    curve = models.curves[stage]
    probability = min(max(probability, 1.0 / TABLE_SIZE), 1.0 - 1.0 / TABLE_SIZE)
    stretched = models.tables[STRETCH, np.int64(probability * TABLE_SIZE)]
    place = (stretched + NODE_LIMIT) / NODE_STEP
    node = np.int64(place)
    share = place - node
    refined = (1.0 - share) * curve[node] + share * curve[node + 1]
    decision = code_decision(coder, min(max(refined, 1.0 / TABLE_SIZE), 1.0 - 1.0 / TABLE_SIZE), decision)
    curve[node] += _RATE * (1.0 - share) * (decision - curve[node])
    curve[node + 1] += _RATE * share * (decision - curve[node + 1])
    return decision


@kernel
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


@kernel
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


# ---- motion of an instant ----


@kernel
def set_features(motion, i, t, sides, features):
    """Features (10,) of a track before instant `t`: place, motion since the first and the last, squares."""
    scale = 2.8 / sides[0]
    features[0] = 1.0
    for axis in range(2):
        features[1 + axis] = (motion.place[i, axis] - 0.5 * sides[axis]) * scale
        features[3 + axis] = 0.0
        features[5 + axis] = 0.0
        if t > 1:
            features[3 + axis] = (motion.place[i, axis] - motion.first[i, axis]) / t
            features[5 + axis] = motion.velocity[i, axis]
    features[7] = features[1] * features[1]
    features[8] = features[1] * features[2]
    features[9] = features[2] * features[2]


@kernel
def set_prior(motion, live, t, covariance):
    """Set the covariance (10, 10) of the coefficients before anything of an instant is known."""
    covariance[:] = 0.0
    speed, count = 0.0, 0
    for i in range(live.size):
        if live[i]:
            speed += abs(motion.velocity[i, 0]) + abs(motion.velocity[i, 1])
            count += 1
    common = 5.0 if t == 1 else 0.53 + 0.73 * speed / max(2 * count, 1)
    linear, square = (0.5, 0.55) if t == 1 else (0.36, 0.14)
    weight = motion.learned[WEIGHT]
    share = weight / (weight + 0.22)
    for k in range(NUM_FEATURES):
        deviation = common
        if k > 0:
            deviation *= linear if k < 3 else square
        if 3 <= k < 7:
            deviation = 0.0 if t == 1 else (1.4 if k < 5 else 0.5)
        covariance[k, k] = deviation * deviation
        if t > 2 and weight > 0.0:
            squares = motion.learned[SQUARES + k] / weight
            covariance[k, k] = share * squares + (1.0 - share) * covariance[k, k]


@kernel
def fitted(start, features, coefficients, axis):
    """Position by the motion that was found so far."""
    position = start
    for k in range(NUM_FEATURES):
        position += features[k] * coefficients[k, axis]
    return position


@kernel
def set_gain(covariance, features, gain):
    """Covariance times features; return the variance that the coefficients leave in the prediction."""
    variance = 0.0
    for k in range(NUM_FEATURES):
        gain[k] = 0.0
        for m in range(NUM_FEATURES):
            gain[k] += covariance[k, m] * features[m]
        variance += features[k] * gain[k]
    return max(variance, 0.0)


@kernel
def learn_motion(errors, variance, noise, gain, coefficients, covariance):
    """Recursive least squares: draw the coefficients to a position; errors beyond what can be, by less."""
    square = max(errors[0] * errors[0], errors[1] * errors[1])
    limit = 8.0 * (noise + variance)
    if square > limit:
        noise *= square / limit
    quotient = 1.0 / (noise + variance)
    for k in range(NUM_FEATURES):
        for axis in range(2):
            moved = coefficients[k, axis] + gain[k] * quotient * errors[axis]
            coefficients[k, axis] = min(max(moved, -_LIMIT), _LIMIT)
    for k in range(NUM_FEATURES):
        for m in range(NUM_FEATURES):
            covariance[k, m] -= gain[k] * gain[m] * quotient


@kernel
def fitted_position(instant, i, axis):
    """Position of a track by the motion that was found so far."""
    return fitted(instant.starts[i, axis], instant.features[i], instant.coefficients, axis)


@kernel
def ask_neighbours(motion, instant, i, position):
    """Set `said` to weighted sums of errors in x and y and of magnitudes; return the sum of the weights."""
    instant.said[:] = 0.0
    total = 0.0
    for place in range(NUM_NEIGHBOURS):
        j = motion.neighbours[i, place]
        if j < 0:
            break
        if instant.known[j]:
            weight = motion.weights[i, place]
            for axis in range(2):
                instant.said[axis] += weight * (position[j, axis] - fitted_position(instant, j, axis))
            instant.said[2] += weight * instant.sizes[j]
            total += weight
    return total


@kernel
def expected_size(motion, i, t, total, size):
    """Magnitude of the residual to expect, by the neighbours, the track itself and all tracks."""
    level = motion.learned[LEVEL]
    if t == 1:
        return (size + 0.6 * level) / (total + 0.3)
    return (size + 3.3 * motion.magnitude[i] + 0.3 * level) / (total + 3.6)


@kernel
def predict(motion, instant, i, t, position, sides):
    """Predict a track; return the size of the residual to expect, and the variance of the motion there."""
    set_features(motion, i, t, sides, instant.features[i])
    for axis in range(2):
        instant.starts[i, axis] = motion.place[i, axis] + 0.14 * motion.velocity[i, axis]
    variance = set_gain(instant.covariance, instant.features[i], instant.gain)
    total = ask_neighbours(motion, instant, i, position)
    for axis in range(2):
        at = fitted_position(instant, i, axis) + instant.said[axis] / (total + 1.0)
        instant.predictions[i, axis] = min(max(at, 0.0), sides[axis] - 1.0)
    return expected_size(motion, i, t, total, instant.said[2]), variance


@kernel
def loss_context(predicted, scale, sides, pixel):
    """Which context the loss of a track has, by how near the border it is expected."""
    edge = min(predicted[0], sides[0] - 1 - predicted[0], predicted[1], sides[1] - 1 - predicted[1])
    if edge < 6.0 * pixel + 2.0 * scale:
        return 0
    return 1 if edge < 20.0 * pixel else 2


@kernel
def code_loss(coder, counts, lost):
    """Code whether a track is lost, by how many were before."""
    lost = code_decision(coder, counts[0] / counts[1], lost)
    counts[0] += lost
    counts[1] += 1.0
    return lost


@kernel
def code_position(coder, models, predicted, scale, position):
    """Code the position (2,) of a track."""
    spread = 0.51 * max(scale, 0.1)
    for axis in range(2):
        nearest = np.int64(np.floor(predicted[axis] + 0.5))
        offset = predicted[axis] - nearest
        position[axis] = code_residual(coder, models, nearest, offset, spread, position[axis] - nearest)


@kernel
def learn(motion, instant, i, t, position, size, scale, variance):
    """Learn the new motion from a track whose position is known."""
    instant.known[i] = True
    away = 0.0
    for axis in range(2):
        away += abs(position[i, axis] - instant.predictions[i, axis])
        instant.errors[axis] = position[i, axis] - fitted_position(instant, i, axis)
    instant.sizes[i] = 0.5 * away * size / max(scale, 1e-9)
    motion.magnitude[i] += 0.35 * (min(instant.sizes[i], 8.0) - motion.magnitude[i])
    noise = (0.47 if t == 1 else 0.12) + 0.5 * size * size
    learn_motion(instant.errors, variance, noise, instant.gain, instant.coefficients, instant.covariance)


@kernel
def finish_instant(motion, instant, t, position):
    """Learn how large residuals and coefficients are; filter places and velocities."""
    known = instant.known
    count = known.sum()
    if count > 0:
        motion.learned[LEVEL] = 0.5 * motion.learned[LEVEL] + 0.5 * sum_of_known(instant) / count
    if t > 1 and count >= 8:
        motion.learned[WEIGHT] = 0.8 * motion.learned[WEIGHT] + 1.0
        for k in range(NUM_FEATURES):
            x, y = instant.coefficients[k, 0], instant.coefficients[k, 1]
            square = 0.5 * (x * x + y * y) + max(instant.covariance[k, k], 0.0)
            motion.learned[SQUARES + k] = 0.8 * motion.learned[SQUARES + k] + square
    for i in range(known.size):
        for axis in range(2 if known[i] else 0):
            fit = 0.5 * (fitted_position(instant, i, axis) + instant.predictions[i, axis])
            error = position[i, axis] - fit
            share = 1.0 if t == 1 else 0.33
            motion.velocity[i, axis] = fit - motion.place[i, axis] + share * error
            motion.place[i, axis] = fit + 0.75 * error


@kernel
def sum_of_known(instant):
    """Sum of the magnitudes of the residuals, in the order of the tracks."""
    total = 0.0
    for i in range(instant.known.size):
        if instant.known[i]:
            total += instant.sizes[i]
    return total


@kernel
def new_instant(count):
    """Room for what is found at an instant."""
    return Instant(
        np.zeros((count, NUM_FEATURES)),
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros(count),
        np.zeros(count, np.bool_),
        np.zeros((NUM_FEATURES, 2)),
        np.zeros((NUM_FEATURES, NUM_FEATURES)),
        np.zeros(NUM_FEATURES),
        np.zeros(3),
        np.zeros(2),
    )


@kernel
def code_instant(coder, models, motion, t, position, live, num_given, sides, pixel):
    """Code where the tracks are at instant `t` that were `live` in the one before, and go on to the next.

    The first `num_given` are known to both sides: they only help to predict. When reading, `position` (N, 2),
    which is `LOST` but for these, receives the others. Return whether all are inside the frame.
    """
    instant = new_instant(live.size)
    set_prior(motion, live, t, instant.covariance)
    for i in range(live.size):
        if not live[i]:
            continue
        size, variance = predict(motion, instant, i, t, position, sides)
        scale = np.sqrt(size * size + 1.3 * variance)
        if i >= num_given:
            predicted = instant.predictions[i]
            context = loss_context(predicted, scale, sides, pixel)
            if code_loss(coder, models.losses[context], int(position[i, 0] == LOST)):
                position[i, 0], position[i, 1] = LOST, LOST
                continue
            code_position(coder, models, predicted, scale, position[i])
            if not (0 <= position[i, 0] < sides[0] and 0 <= position[i, 1] < sides[1]):
                return False
        learn(motion, instant, i, t, position, size, scale, variance)
    finish_instant(motion, instant, t, position)
    return True
