"""Compiled loops of track coding by regression; described by their callers, and in `docs/spec/tracks.md`.

Products, sums, quotients and roots of double precision in a fixed order, the same on every processor. All is
in units of the last digit of the positions.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.entropy.mixing import SQUASH, STRETCH, STRETCH_LIMIT, TABLE_SIZE
from dvc.entropy.range_coder import FAILED, code_decision, code_uniform, has_room
from dvc.tracks._kernels import DISTANCES, LOST, code_grid, code_points, grid_exponent, min_distance

OUTSIDE = -1
MAX_CELLS = 2**18
"""Largest number of cells of a grid for which first positions are coded directly."""
_MAX_GUARD = 256
NUM_FEATURES = 10
NUM_NEIGHBOURS = 8
NUM_STAGES, NUM_NODES = 5, 25
"""Number of decisions of a residual with own curves, and of nodes of each curve."""
MAX_UNARY = 15
MAX_EXPONENT = 24
MAX_SYMBOLS = 1 + 2 * (2 + MAX_UNARY + 2 * MAX_EXPONENT)
LEVEL, WEIGHT, SQUARES = 0, 1, 2
"""Places in `Motion.learned`: mean magnitude, sum of weights, squared coefficients."""
NUM_LEARNED = SQUARES + NUM_FEATURES

STRIDE = 12
"""Places of the coefficients in a row: whole vectors of any processor."""

NODE_STEP = 0.73
NODE_LIMIT = 8.4
_RATE = 0.02
_LIMIT = 1e4
_LEAST_NOISE = 2.0**-40  # least noise of the variance: rounding never cancels the variance of a coefficient


class Motion(NamedTuple):
    """State of tracks in one direction of time, before an instant, at both ends."""

    first: NDArray[np.float64]  # starts of the tracks
    place: NDArray[np.float64]  # filtered position, and motion from the instant before
    velocity: NDArray[np.float64]
    magnitude: NDArray[np.float64]  # expected magnitude of the residuals
    neighbours: NDArray[np.int64]  # nearest tracks before each one; -1: none
    weights: NDArray[np.float64]  # weight of each neighbour
    learned: NDArray[np.float64]  # mean magnitude of residuals, and squares of the coefficients of motion


class Picture(NamedTuple):
    """Positions of tracks."""

    sides: NDArray[np.int64]  # width and height
    pixel: float


class Instant(NamedTuple):
    """Results of the coding of an instant."""

    features: NDArray[np.float64]  # features of each track, before the instant
    # positions under no new motion, under the motion estimated before it, and predicted
    starts: NDArray[np.float64]
    fits: NDArray[np.float64]
    predictions: NDArray[np.float64]
    sizes: NDArray[np.float64]  # magnitude of its residual
    known: NDArray[np.bool_]  # whether it is known at the instant
    coefficients: NDArray[np.float64]  # the new motion
    covariance: NDArray[np.float64]  # how uncertain it is, row by row; a row ends with two zeros
    # covariance times the features of one track, and two zeros; room that is used again
    gain: NDArray[np.float64]


class Models(NamedTuple):
    """Probabilities that adapt."""

    curves: NDArray[np.float64]  # probability of a 1 in each stage by the one that was computed
    tables: NDArray[np.float64]  # as `dvc.entropy.mixing.logistic_tables` returns them
    losses: NDArray[np.float64]  # tracks that were lost, and all, in each context


# ---- first positions ----


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


@inlined_kernel
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
                ratio = told[near[x, y], 0] / told[near[x, y], 1]
                probability = min(max(expected * ratio, 1e-4), 0.97)
                here = code_decision(coder, probability, int(points[k, 0] == x and points[k, 1] == y))
            told[near[x, y], 1] += expected
            num_free -= 1
            free[x, y] = False
            if here:
                told[near[x, y], 0] += 1.0
                points[k, 0], points[k, 1] = x, y
                num_free -= occupy(free, x, y, distance)
                count_near(near, x, y, (5 * distance + 1) // 2, told.shape[0] - 1)
                k += 1
    return k == count


@kernel
def code_first(coder, points, taken, sides, told):
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
        fits = code_occupancy(coder, cells, free, distance, told)
    points[:] = cells << exponent
    return fits


# ---- order and neighbours ----


@kernel
def spread_order(count):
    """Numbers below `count` by their binary digits in reverse, so that the first ones are far apart."""
    order = np.empty(count, np.int64)
    digits = 0
    while 1 << digits < count:
        digits += 1
    place = 0
    for k in range(1 << digits):
        number = 0
        for digit in range(digits):
            number |= (k >> digit & 1) << (digits - 1 - digit)
        if number < count:
            order[place] = number
            place += 1
    return order


@kernel
def nearest_before(first, reach, neighbours, weights):
    """Find the nearest tracks before each one, nearest first, and their weights; `reach` is squared."""
    squares = np.empty(first.shape[0])
    for i in range(first.shape[0]):
        neighbours[i] = -1
        farthest = np.inf
        for j in range(i):
            dx, dy = first[i, 0] - first[j, 0], first[i, 1] - first[j, 1]
            squares[j] = dx * dx + dy * dy
        for j in range(i):
            if squares[j] >= farthest:
                continue
            ratio = reach / (reach + squares[j])
            weight = ratio * ratio
            k = NUM_NEIGHBOURS
            while k > 0 and (neighbours[i, k - 1] < 0 or weights[i, k - 1] < weight):
                k -= 1
            if k < NUM_NEIGHBOURS:
                for place in range(NUM_NEIGHBOURS - 1, k, -1):
                    neighbours[i, place] = neighbours[i, place - 1]
                    weights[i, place] = weights[i, place - 1]
                neighbours[i, k], weights[i, k] = j, weight
                if neighbours[i, NUM_NEIGHBOURS - 1] >= 0:
                    farthest = squares[neighbours[i, NUM_NEIGHBOURS - 1]]


@kernel
def begin_motion(given, tracks, reach, level):
    """Put tracks after those that are given, far apart in turn; return their order, all, and their motion."""
    order = spread_order(tracks.shape[0])
    count = given.shape[0] + order.size
    units = np.empty((count, given.shape[1], 2), np.int64)
    units[: given.shape[0]] = given
    for k in range(order.size):
        units[given.shape[0] + k] = tracks[order[k]]
    first = units[:, 0].astype(np.float64)
    neighbours, weights = np.empty((count, NUM_NEIGHBOURS), np.int64), np.zeros((count, NUM_NEIGHBOURS))
    nearest_before(first, reach, neighbours, weights)
    learned, magnitude = np.zeros(NUM_LEARNED), np.full(count, level)
    learned[LEVEL] = level
    motion = Motion(first, first.copy(), np.zeros((count, 2)), magnitude, neighbours, weights, learned)
    return order, units, motion


# ---- residuals ----


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
    place = (stretched + NODE_LIMIT) / NODE_STEP
    node = np.int64(place)
    share = place - node
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


# ---- motion of an instant ----


@inlined_kernel
def set_features(motion, instant, i, t, sides):
    """Features (10,) of a track before instant `t`: place, motion since the first and the last, squares."""
    features = instant.features
    scale = 2.8 / max(sides[0], sides[1])
    features[i, 0] = 1.0
    for axis in range(2):
        features[i, 1 + axis] = (motion.place[i, axis] - 0.5 * sides[axis]) * scale
        features[i, 3 + axis] = 0.0
        features[i, 5 + axis] = 0.0
        if t > 1:
            features[i, 3 + axis] = (motion.place[i, axis] - motion.first[i, axis]) / t
            features[i, 5 + axis] = motion.velocity[i, axis]
    features[i, 7] = features[i, 1] * features[i, 1]
    features[i, 8] = features[i, 1] * features[i, 2]
    features[i, 9] = features[i, 2] * features[i, 2]


@inlined_kernel
def set_prior(motion, units, t, covariance):
    """Set the covariance of the coefficients before anything of instant `t` is known."""
    covariance[:] = 0.0
    speed, count = 0.0, 0
    for i in range(units.shape[0]):
        if units[i, t - 1, 0] != LOST:
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
        variance = deviation * deviation
        if t > 2 and weight > 0.0:
            squares = motion.learned[SQUARES + k] / weight
            variance = share * squares + (1.0 - share) * variance
        covariance[k * (STRIDE + 1)] = variance


@inlined_kernel
def fitted(instant, i):
    """Return the position (x, y) of a track by the motion estimated so far."""
    x, y = instant.starts[i, 0], instant.starts[i, 1]
    for k in range(NUM_FEATURES):
        feature = instant.features[i, k]
        x += feature * instant.coefficients[k, 0]
        y += feature * instant.coefficients[k, 1]
    return x, y


@inlined_kernel
def set_gain(instant, i):
    """Covariance times features; return the variance that the coefficients leave in the prediction."""
    features, covariance, gain = instant.features, instant.covariance, instant.gain
    for m in range(gain.size):
        sum_of_products = 0.0
        for k in range(NUM_FEATURES):  # the covariance is symmetric: the same products in the same order
            sum_of_products += covariance[k * STRIDE + m] * features[i, k]
        gain[m] = sum_of_products
    variance = 0.0
    for k in range(NUM_FEATURES):
        variance += features[i, k] * gain[k]
    variance = max(variance, 0.0)
    for k in range(NUM_FEATURES):  # by Cauchy and Schwarz, which rounding must not break under wild motion
        square = covariance[k * (STRIDE + 1)] * variance
        if gain[k] * gain[k] > square:
            gain[k] = np.sqrt(square) if gain[k] > 0.0 else -np.sqrt(square)
    return variance


@inlined_kernel
def learn_motion(instant, error_x, error_y, variance, noise):
    """Recursive least squares: draw the coefficients to a position; errors beyond what can be, by less."""
    coefficients, covariance, gain = instant.coefficients, instant.covariance, instant.gain
    square = max(error_x * error_x, error_y * error_y)
    limit = 8.0 * (noise + variance)
    if square > limit:
        noise *= square / limit
    noise = max(noise, _LEAST_NOISE * variance)
    quotient = 1.0 / (noise + variance)
    for k in range(NUM_FEATURES):
        share = gain[k] * quotient
        coefficients[k, 0] = min(max(coefficients[k, 0] + share * error_x, -_LIMIT), _LIMIT)
        coefficients[k, 1] = min(max(coefficients[k, 1] + share * error_y, -_LIMIT), _LIMIT)
    for m in range(gain.size):
        for k in range(NUM_FEATURES):
            covariance[k * STRIDE + m] -= gain[k] * gain[m] * quotient


@inlined_kernel
def ask_neighbours(motion, instant, units, i, t):
    """Weighted sums of the errors of known neighbours in x, in y and in magnitude, and sum of the weights."""
    error_x, error_y, size, total = 0.0, 0.0, 0.0, 0.0
    for place in range(NUM_NEIGHBOURS):
        j = motion.neighbours[i, place]
        if j < 0:
            break
        if instant.known[j]:
            weight = motion.weights[i, place]
            x, y = fitted(instant, j)
            error_x += weight * (units[j, t, 0] - x)
            error_y += weight * (units[j, t, 1] - y)
            size += weight * instant.sizes[j]
            total += weight
    return error_x, error_y, size, total


@inlined_kernel
def expected_size(motion, i, t, total, size):
    """Magnitude of the residual to expect, by the neighbours, the track itself and all tracks."""
    level = motion.learned[LEVEL]
    if t == 1:
        return (size + 0.6 * level) / (total + 0.3)
    return (size + 3.3 * motion.magnitude[i] + 0.3 * level) / (total + 3.6)


@inlined_kernel
def predict(motion, instant, units, i, t, sides):
    """Predict a track; return the size of the residual to expect, and the variance of the motion there."""
    set_features(motion, instant, i, t, sides)
    for axis in range(2):
        instant.starts[i, axis] = motion.place[i, axis] + 0.14 * motion.velocity[i, axis]
    variance = set_gain(instant, i)
    error_x, error_y, size, total = ask_neighbours(motion, instant, units, i, t)
    x, y = fitted(instant, i)
    instant.fits[i, 0], instant.fits[i, 1] = x, y
    instant.predictions[i, 0] = min(max(x + error_x / (total + 1.0), 0.0), sides[0] - 1.0)
    instant.predictions[i, 1] = min(max(y + error_y / (total + 1.0), 0.0), sides[1] - 1.0)
    return expected_size(motion, i, t, total, size), variance


@inlined_kernel
def loss_context(instant, i, scale, picture):
    """Which context the loss of a track has, by how near the border it is expected."""
    sides, pixel = picture.sides, picture.pixel
    x, y = instant.predictions[i, 0], instant.predictions[i, 1]
    edge = min(x, sides[0] - 1 - x, y, sides[1] - 1 - y)
    if edge < 6.0 * pixel + 2.0 * scale:
        return 0
    return 1 if edge < 20.0 * pixel else 2


@inlined_kernel
def code_loss(coder, losses, context, lost):
    """Code whether a track is lost, by how many were before."""
    lost = code_decision(coder, losses[context, 0] / losses[context, 1], lost)
    losses[context, 0] += lost
    losses[context, 1] += 1.0
    return lost


@inlined_kernel
def code_position(coder, models, instant, units, i, t, scale):
    """Code the position of a track."""
    spread = 0.51 * max(scale, 0.1)
    for axis in range(2):
        predicted = instant.predictions[i, axis]
        nearest = np.int64(np.floor(predicted + 0.5))
        offset = predicted - nearest
        units[i, t, axis] = code_residual(coder, models, nearest, offset, spread, units[i, t, axis] - nearest)


@inlined_kernel
def learn(motion, instant, units, i, t, size, scale, variance):
    """Learn the new motion from a track with a known position."""
    instant.known[i] = True
    away = 0.0
    for axis in range(2):
        away += abs(units[i, t, axis] - instant.predictions[i, axis])
    instant.sizes[i] = 0.5 * away * size / max(scale, 1e-9)
    motion.magnitude[i] += 0.35 * (min(instant.sizes[i], 8.0) - motion.magnitude[i])
    noise = (0.47 if t == 1 else 0.12) + 0.5 * size * size
    error_x, error_y = units[i, t, 0] - instant.fits[i, 0], units[i, t, 1] - instant.fits[i, 1]
    learn_motion(instant, error_x, error_y, variance, noise)


@inlined_kernel
def finish_instant(motion, instant, units, t, sides):
    """Learn how large residuals and coefficients are; filter places and velocities."""
    known = instant.known
    count = known.sum()
    if count > 0:
        motion.learned[LEVEL] = 0.5 * motion.learned[LEVEL] + 0.5 * sum_of_known(instant) / count
    if t > 1 and count >= 8:
        motion.learned[WEIGHT] = 0.8 * motion.learned[WEIGHT] + 1.0
        for k in range(NUM_FEATURES):
            x, y = instant.coefficients[k, 0], instant.coefficients[k, 1]
            square = 0.5 * (x * x + y * y) + max(instant.covariance[k * (STRIDE + 1)], 0.0)
            motion.learned[SQUARES + k] = 0.8 * motion.learned[SQUARES + k] + square
    for i in range(known.size):
        if known[i]:
            x, y = fitted(instant, i)
            follow(motion, instant, units, i, t, 0, x, sides)
            follow(motion, instant, units, i, t, 1, y, sides)


@inlined_kernel
def follow(motion, instant, units, i, t, axis, fitted_last, sides):
    """Filter the place and the velocity of a track in one direction, within a frame around the frame."""
    share = 1.0 if t == 1 else 0.33
    fit = 0.5 * (fitted_last + instant.predictions[i, axis])
    error = units[i, t, axis] - fit
    velocity, place, side = fit - motion.place[i, axis] + share * error, fit + 0.75 * error, sides[axis]
    motion.velocity[i, axis] = min(max(velocity, -side), side)
    motion.place[i, axis] = min(max(place, -side), 2.0 * side)


@inlined_kernel
def sum_of_known(instant):
    """Sum of the magnitudes of the residuals, in the order of the tracks."""
    total = 0.0
    for i in range(instant.known.size):
        if instant.known[i]:
            total += instant.sizes[i]
    return total


@kernel
def new_instant(count):
    """Return room for the results of an instant."""
    return Instant(
        np.zeros((count, NUM_FEATURES)),
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros(count),
        np.zeros(count, np.bool_),
        np.zeros((NUM_FEATURES, 2)),
        np.zeros(NUM_FEATURES * STRIDE),
        np.zeros(STRIDE),
    )


@inlined_kernel
def code_instant(coder, models, motion, instant, units, t, num_given, picture):
    """Code the tracks at instant `t` that were not lost in the one before, and advance to the next."""
    sides = picture.sides
    instant.known[:] = False
    instant.coefficients[:] = 0.0
    set_prior(motion, units, t, instant.covariance)
    for i in range(units.shape[0]):
        if units[i, t - 1, 0] == LOST:
            units[i, t] = LOST
            continue
        size, variance = predict(motion, instant, units, i, t, sides)
        scale = np.sqrt(size * size + 1.3 * variance)
        if i >= num_given:
            context = loss_context(instant, i, scale, picture)
            if code_loss(coder, models.losses, context, int(units[i, t, 0] == LOST)):
                units[i, t] = LOST
                continue
            code_position(coder, models, instant, units, i, t, scale)
            if not (0 <= units[i, t, 0] < sides[0] and 0 <= units[i, t, 1] < sides[1]):
                return False
        learn(motion, instant, units, i, t, size, scale, variance)
    finish_instant(motion, instant, units, t, sides)
    return True


@kernel
def code_instants(coder, models, motion, units, begin, num_given, picture):
    """Code the tracks (N, T, 2) at the instants from `begin` on: all those before are known."""
    instant = new_instant(units.shape[0])
    most = units.shape[0] * MAX_SYMBOLS
    for t in range(begin, units.shape[1]):
        if coder.fields[FAILED] or not has_room(coder, most):
            return t
        if not code_instant(coder, models, motion, instant, units, t, num_given, picture):
            return OUTSIDE
    return units.shape[1]
