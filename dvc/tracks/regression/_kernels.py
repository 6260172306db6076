"""Compiled loops of track coding by regression; described by their callers, and in `docs/spec/tracks.md`.

Products, sums, quotients and roots of double precision in a fixed order, the same on every processor. All is
in units of the last digit of the positions.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.entropy.range_coder import FAILED, code_decision, has_room
from dvc.tracks._kernels import LOST, MAX_SYMBOLS, code_residual, spread_order

OUTSIDE = -1
NUM_FEATURES = 10
NUM_NEIGHBOURS = 8
LEVEL, WEIGHT, SQUARES = 0, 1, 2
"""Indices in `Motion.learned`: mean magnitude, sum of weights, squared coefficients."""
NUM_LEARNED = SQUARES + NUM_FEATURES

STRIDE = 12
"""Number of coefficients in a row: whole vectors of any processor."""

_LIMIT = 1e4
_LEAST_NOISE = 2.0**-40  # least noise of the variance: rounding never cancels the variance of a coefficient


class Motion(NamedTuple):
    """State of tracks in one direction of time, before an instant, at both ends."""

    first: NDArray[np.float64]  # starts of the tracks
    position: NDArray[np.float64]  # filtered position, and motion from the instant before
    velocity: NDArray[np.float64]
    magnitude: NDArray[np.float64]  # expected magnitude of the residuals
    neighbours: NDArray[np.int64]  # nearest tracks before each one; -1: none
    weights: NDArray[np.float64]  # weight of each neighbour
    learned: NDArray[np.float64]  # mean magnitude of residuals, and squares of the coefficients of motion


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
                for rank in range(NUM_NEIGHBOURS - 1, k, -1):
                    neighbours[i, rank] = neighbours[i, rank - 1]
                    weights[i, rank] = weights[i, rank - 1]
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


@inlined_kernel
def set_features(motion, instant, i, t, sides):
    """Features (10,) of a track before instant `t`: place, motion since the first and the last, squares."""
    features = instant.features
    scale = 2.8 / max(sides[0], sides[1])
    features[i, 0] = 1.0
    for axis in range(2):
        features[i, 1 + axis] = (motion.position[i, axis] - 0.5 * sides[axis]) * scale
        features[i, 3 + axis] = 0.0
        features[i, 5 + axis] = 0.0
        if t > 1:
            features[i, 3 + axis] = (motion.position[i, axis] - motion.first[i, axis]) / t
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
def predict(motion, instant, units, i, t, sides):
    """Predict a track; return the size of the residual to expect, and the variance of the motion there."""
    set_features(motion, instant, i, t, sides)
    for axis in range(2):
        instant.starts[i, axis] = motion.position[i, axis] + 0.14 * motion.velocity[i, axis]
    variance = set_gain(instant, i)
    error_x, error_y, size, total = 0.0, 0.0, 0.0, 0.0  # weighted sums of known neighbours
    for rank in range(NUM_NEIGHBOURS):
        j = motion.neighbours[i, rank]
        if j < 0:
            break
        if instant.known[j]:
            weight = motion.weights[i, rank]
            x, y = fitted(instant, j)
            error_x += weight * (units[j, t, 0] - x)
            error_y += weight * (units[j, t, 1] - y)
            size += weight * instant.sizes[j]
            total += weight
    x, y = fitted(instant, i)
    instant.fits[i, 0], instant.fits[i, 1] = x, y
    instant.predictions[i, 0] = min(max(x + error_x / (total + 1.0), 0.0), sides[0] - 1.0)
    instant.predictions[i, 1] = min(max(y + error_y / (total + 1.0), 0.0), sides[1] - 1.0)
    level = motion.learned[LEVEL]
    if t == 1:
        return (size + 0.6 * level) / (total + 0.3), variance
    return (size + 3.3 * motion.magnitude[i] + 0.3 * level) / (total + 3.6), variance


@inlined_kernel
def loss_context(instant, i, scale, sides, pixel):
    """Which context the loss of a track has, by how near the border it is expected."""
    x, y = instant.predictions[i, 0], instant.predictions[i, 1]
    edge = min(x, sides[0] - 1 - x, y, sides[1] - 1 - y)
    if edge < 6.0 * pixel + 2.0 * scale:
        return 0
    return 1 if edge < 20.0 * pixel else 2


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
    count, sum_of_sizes = known.sum(), 0.0
    for i in range(known.size):
        if known[i]:
            sum_of_sizes += instant.sizes[i]
    if count > 0:
        motion.learned[LEVEL] = 0.5 * motion.learned[LEVEL] + 0.5 * sum_of_sizes / count
    if t > 1 and count >= 8:
        motion.learned[WEIGHT] = 0.8 * motion.learned[WEIGHT] + 1.0
        for k in range(NUM_FEATURES):
            x, y = instant.coefficients[k, 0], instant.coefficients[k, 1]
            square = 0.5 * (x * x + y * y) + max(instant.covariance[k * (STRIDE + 1)], 0.0)
            motion.learned[SQUARES + k] = 0.8 * motion.learned[SQUARES + k] + square
    for i in range(known.size):
        if not known[i]:
            continue
        last = fitted(instant, i)
        share = 1.0 if t == 1 else 0.33
        for axis in range(2):  # within a frame around the frame
            fit = 0.5 * (last[axis] + instant.predictions[i, axis])
            error, side = units[i, t, axis] - fit, sides[axis]
            velocity, position = fit - motion.position[i, axis] + share * error, fit + 0.75 * error
            motion.velocity[i, axis] = min(max(velocity, -side), side)
            motion.position[i, axis] = min(max(position, -side), 2.0 * side)


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
def code_instant(coder, models, motion, instant, units, t, num_given, sides, pixel):
    """Code the tracks at instant `t` that were not lost in the one before, and advance to the next."""
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
            context = loss_context(instant, i, scale, sides, pixel)
            losses = models.losses[context]
            lost = code_decision(coder, losses[0] / losses[1], int(units[i, t, 0] == LOST))
            losses[0] += lost
            losses[1] += 1.0
            if lost:
                units[i, t] = LOST
                continue
            for axis in range(2):
                predicted = instant.predictions[i, axis]
                nearest = np.int64(np.floor(predicted + 0.5))
                residual = units[i, t, axis] - nearest
                units[i, t, axis] = code_residual(
                    coder, models, nearest, predicted - nearest, 0.51 * max(scale, 0.1), residual
                )
            if not (0 <= units[i, t, 0] < sides[0] and 0 <= units[i, t, 1] < sides[1]):
                return False
        learn(motion, instant, units, i, t, size, scale, variance)
    finish_instant(motion, instant, units, t, sides)
    return True


@kernel
def code_instants(coder, models, motion, units, begin, num_given, sides, pixel):
    """Code the tracks (N, T, 2) from instant `begin` on; `sides` of the frame and `pixel` are in units."""
    instant = new_instant(units.shape[0])
    most = units.shape[0] * MAX_SYMBOLS
    for t in range(begin, units.shape[1]):
        if coder.fields[FAILED] or not has_room(coder, most):
            return t
        if not code_instant(coder, models, motion, instant, units, t, num_given, sides, pixel):
            return OUTSIDE
    return units.shape[1]
