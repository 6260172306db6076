"""Compiled loops of what tracks leave to be told; validated and described by their callers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.wynerziv.lengths import LONGEST
from dvc.wynerziv.no_feedback import MAX_BLOCK_BITS
from dvc.wynerziv.transform import transform_four, transform_lines

NEAREST = 3  # points whose motion is blended
_NEAR = 16.0  # squared distance, in pixels, up to which they count alike
SIDE = 8  # of a sampled block
DIRECTIONS = 3  # from the left, from above, from both
FAR = np.int32(2**31 - 1)  # of a point that there is not
_ALIKE = np.uint64(0x0101010101010101)  # times a byte: eight of it
BLOCK_BITS = 40
"""What a block costs beside its syndrome: check bits, and numbers of planes."""
CODE_RATIO = 1.12, 4.0
"""Length of the shortest syndrome that serves over the ideal code length: for long blocks, and what is added
over the root of the bits of short ones."""
RATE_MARGIN_BITS = 0.08
"""What the rate margin is of besides the length, for each bit of a plane: small needs are expected the least
reliably."""


class Sampling(NamedTuple):
    """Which blocks of a picture are looked at, and how distances of points from them become keys."""

    grid: tuple[int, int]  # rows and columns of the blocks
    spacing: int  # from one block to the next, in pixels
    unit: float  # of squared distances
    index_bits: int  # of a key, which tell the point


class Bands(NamedTuple):
    """What the integer coefficients of a block mean."""

    weights: NDArray[np.float64]  # of their squares, by row and column
    order: NDArray[np.int64]  # their bands


class CostModel(NamedTuple):
    """What planes cost and leave, by the variance of the error."""

    borders: NDArray[np.int64]  # first band of each block of bands, and the last
    variances: NDArray[np.float64]  # of residual and noise in each of these: two factors, and what is added
    first: int  # place in the tables that stands for the least variance
    per_plane: int  # places from one plane to the next
    refined_share: float
    tables: NDArray[np.float64]


class Worth(NamedTuple):
    """When planes of a frame pay, and by how much syndromes are longer than they are expected to need."""

    multiplier: float  # squared error that a bit must save
    bit_cost: float  # bits that one of ideal code length costs
    least: NDArray[np.float64]  # how much more each must save than it costs
    margins: tuple[float, float]  # the usual rate margin, and that which is wanted


@kernel
def sort_by_rows(positions, grid, spacing, first, order):
    """Sort points that are known everywhere by the nearest row of blocks; return how many these are."""
    rows = np.full(positions.shape[0], -1)
    first[:] = 0
    for i in range(positions.shape[0]):
        known = True
        for instant in range(positions.shape[1]):
            known &= np.isfinite(positions[i, instant, 0]) and np.isfinite(positions[i, instant, 1])
        if known:
            row = np.int64(np.floor((positions[i, 0, 1] + 0.5 * (spacing - SIDE)) / spacing))
            rows[i] = min(max(row, 0), grid[0] - 1)
            first[rows[i] + 1] += 1
    for r in range(grid[0]):
        first[r + 1] += first[r]
    place = first[:-1].copy()
    for i in range(positions.shape[0]):
        if rows[i] >= 0:
            order[place[rows[i]]] = i
            place[rows[i]] += 1
    return first[grid[0]]


@inlined_kernel
def compare_row(across, down, nearest):
    """Put a point among the nearest ones of a row of blocks, by keys of which the least come first."""
    for column in range(across.size):
        key = np.int32(across[column] + down)
        for place in range(NEAREST):
            kept = nearest[place, column]
            nearest[place, column] = min(kept, key)
            key = max(kept, key)


@kernel
def nearest_points(positions, sampling, nearest):
    """List the `NEAREST` points nearest to the centre of each block, as keys; return how many it compared."""
    grid, spacing, unit, index_bits = sampling
    nearest[:] = FAR
    first, order = np.empty(grid[0] + 1, np.int64), np.empty(positions.shape[0], np.int64)
    count, num_compared = sort_by_rows(positions, grid, spacing, first, order), 0
    across = np.empty((positions.shape[0], nearest.shape[2]), np.int32)
    for place in range(count):
        i = order[place]
        for column in range(across.shape[1]):
            x = positions[i, 0, 0] - (spacing * min(column, grid[1] - 1) + 0.5 * SIDE)
            across[i, column] = (np.int64(unit * (x * x)) << index_bits) | i
    for row in range(grid[0]):
        for ring in range(grid[0]):
            for near in range(row - ring, row + ring + 1, max(2 * ring, 1)):
                if 0 <= near < grid[0]:
                    for place in range(first[near], first[near + 1]):
                        i = order[place]
                        y = positions[i, 0, 1] - (spacing * row + 0.5 * SIDE)
                        down = np.int32(np.int64(unit * (y * y)) << index_bits)
                        compare_row(across[i], down, nearest[row])
                    num_compared += (first[near + 1] - first[near]) * grid[1]
            reach = (ring + 0.5) * spacing
            if (nearest[row, NEAREST - 1].max() >> index_bits) <= unit * (reach * reach):
                break
    return num_compared


@kernel
def blend_motion(positions, instant, grid, spacing, index_bits, nearest, motion):
    """Blend the motion of the nearest points of each block: (x, y) in half pixels; none without points."""
    for row in range(grid[0]):
        y = spacing * row + 0.5 * SIDE
        for column in range(grid[1]):
            x = spacing * column + 0.5 * SIDE
            total, sum_x, sum_y = 0.0, 0.0, 0.0
            for place in range(NEAREST):
                key = nearest[row, place, column]
                if key < FAR:
                    i = key & ((1 << index_bits) - 1)
                    at_x, at_y = positions[i, 0, 0], positions[i, 0, 1]
                    weight = 1.0 / ((at_x - x) * (at_x - x) + (at_y - y) * (at_y - y) + _NEAR)
                    total += weight
                    sum_x += weight * (positions[i, instant, 0] - at_x)
                    sum_y += weight * (positions[i, instant, 1] - at_y)
            k = row * grid[1] + column
            motion[k] = 0
            if total > 0.0:
                motion[k, 0] = np.int64(np.floor(2.0 * sum_x / total + 0.5))
                motion[k, 1] = np.int64(np.floor(2.0 * sum_y / total + 0.5))


@kernel
def cut_blocks(words, grid, spacing, factor, lines):
    """Write `factor` times the sampled blocks of a picture, those of a row of blocks side by side."""
    window = np.empty((SIDE, grid[1]), np.uint64)
    samples = window.view(np.uint8)
    for row in range(grid[0]):
        for y in range(SIDE):
            for column in range(grid[1]):
                window[y, column] = words[spacing * row + y, spacing * column]
        for y in range(SIDE):
            for x in range(samples.shape[1]):
                lines[row, y, x] = np.int16(factor * np.int16(samples[y, x]))


@inlined_kernel
def word_at(words, y, x):
    """Return eight samples from a place on, the first in the lowest bits; borders are repeated."""
    last = words.shape[1] - 1
    word = words[np.uintp(min(max(y, 0), words.shape[0] - 1)), np.uintp(min(max(x, 0), last))]
    if 0 <= x <= last:
        return word
    missing = min(-x if x < 0 else x - last, SIDE)
    kept, filled = np.uint64(8 * (missing - 1)), np.uint64(8 * (SIDE - missing))
    if x < 0:
        return (word << kept) << np.uint64(8) | ((word & np.uint64(255)) * _ALIKE) >> filled
    return (word >> kept) >> np.uint64(8) | ((word >> np.uint64(56)) * _ALIKE) << filled


@kernel
def subtract_moved(words, motion, grid, spacing, lines):
    """Subtract four times the blocks of a picture, by half pixels, borders repeated; see `cut_blocks`."""
    lowest, rightmost = 2 * (words.shape[0] - SIDE), 2 * (words.shape[1] - 1)
    windows = np.empty((SIDE, 4, grid[1]), np.uint64)
    samples = windows.view(np.uint8)
    for row in range(grid[0]):
        for column in range(grid[1]):
            k = row * grid[1] + column
            y, x = 2 * spacing * row + motion[k, 1], 2 * spacing * column + motion[k, 0]
            if 0 <= y <= lowest and 0 <= x <= rightmost:
                left, right = np.uintp(x >> 1), np.uintp((x >> 1) + (x & 1))
                for line in range(SIDE):
                    above, below = np.uintp((y >> 1) + line), np.uintp((y >> 1) + line + (y & 1))
                    windows[line, 0, column], windows[line, 1, column] = (
                        words[above, left],
                        words[above, right],
                    )
                    windows[line, 2, column], windows[line, 3, column] = (
                        words[below, left],
                        words[below, right],
                    )
            else:
                for line in range(SIDE):
                    for corner in range(4):
                        at_y = (y >> 1) + line + (y & 1) * (corner >> 1)
                        at_x = (x >> 1) + (x & 1) * (corner & 1)
                        windows[line, corner, column] = word_at(words, at_y, at_x)
        for y in range(SIDE):
            for x in range(samples.shape[2]):
                upper = np.int16(np.int16(samples[y, 0, x]) + np.int16(samples[y, 1, x]))
                lower = np.int16(np.int16(samples[y, 2, x]) + np.int16(samples[y, 3, x]))
                lines[row, y, x] = np.int16(lines[row, y, x] - np.int16(upper + lower))


@inlined_kernel
def _add_squares(line, squares):
    """Do the horizontal half of the transform on one line; add up squares of the four coefficients."""
    for part in range(squares.shape[1]):
        x = np.uintp(4 * part)
        a, b = np.float32(line[x]), np.float32(line[x + 1])  # which holds all sums of them
        c, d = np.float32(line[x + 2]), np.float32(line[x + 3])
        outer, inner, high, low = a + d, b + c, a - d, b - c
        first, third = outer + inner, outer - inner
        second, fourth = (high + high) + low, high - (low + low)
        squares[0, part] += first * first
        squares[1, part] += second * second
        squares[2, part] += third * third
        squares[3, part] += fourth * fourth


@kernel
def energies(lines, grid, weights, order, share, means):
    """Write weighed sums of squares of the coefficients of each band in each block; `lines` are lost."""
    squares = np.empty((4, 4, 2 * grid[1]), np.float32)
    for row in range(grid[0]):
        squares[:] = 0.0
        for top in range(0, SIDE, 4):
            part = lines[row, top : top + 4]
            transform_lines(part[0], part[1], part[2], part[3])
            for y in range(4):
                _add_squares(lines[row, top + y], squares[y])
        for y in range(4):
            for x in range(4):
                parts, own, factor = squares[y, x], means[order[y, x]][row * grid[1] :], share * weights[y, x]
                for column in range(grid[1]):
                    own[column] = factor * np.float64(parts[2 * column] + parts[2 * column + 1])


@kernel
def block_errors(words, references, noises, positions, sampling, bands, residual, noise):
    """Write energies of blocks less the mean of where they are in references, and the noise these add."""
    count = len(references)
    grid, spacing, _, index_bits = sampling
    nearest = np.empty((grid[0], NEAREST, -(-grid[1] // 8) * 8), np.int32)
    motion = np.empty((grid[0] * grid[1], 2), np.int64)
    lines = np.empty((grid[0], SIDE, SIDE * grid[1]), np.int16)
    num_compared = nearest_points(positions, sampling, nearest)
    cut_blocks(words, grid, spacing, 4 * count, lines)
    noise[:] = 0.0
    for r in range(count):
        blend_motion(positions, r + 1, grid, spacing, index_bits, nearest, motion)
        subtract_moved(references[r], motion, grid, spacing, lines)
        add_noise(motion, grid, spacing, 1.0 / (count * count), noises[r], noise)
    energies(lines, grid, bands.weights, bands.order, 1.0 / (count * count), residual)
    return num_compared


@inlined_kernel
def _intra_part(image, y0, x0, half, core, line, column):
    """Write the transform of a part of a block, and of the lines of samples to its left and above it."""
    above, left = np.uintp(max(y0 - 1, 0)), np.uintp(max(x0 - 1, 0))
    y, x = np.uintp(y0), np.uintp(x0)
    for k in range(4):
        a, b = np.int32(image[y, np.uintp(x0 + k)]), np.int32(image[np.uintp(y0 + 1), np.uintp(x0 + k)])
        c, d = (
            np.int32(image[np.uintp(y0 + 2), np.uintp(x0 + k)]),
            np.int32(image[np.uintp(y0 + 3), np.uintp(x0 + k)]),
        )
        half[0, k], half[1, k], half[2, k], half[3, k] = transform_four(a, b, c, d)
    for k in range(4):
        core[k, 0], core[k, 1], core[k, 2], core[k, 3] = transform_four(
            half[k, 0], half[k, 1], half[k, 2], half[k, 3]
        )
    a, b = np.int32(image[y, left]), np.int32(image[np.uintp(y0 + 1), left])
    c, d = np.int32(image[np.uintp(y0 + 2), left]), np.int32(image[np.uintp(y0 + 3), left])
    line[0], line[1], line[2], line[3] = transform_four(a, b, c, d)
    a, b = np.int32(image[above, x]), np.int32(image[above, np.uintp(x0 + 1)])
    c, d = np.int32(image[above, np.uintp(x0 + 2)]), np.int32(image[above, np.uintp(x0 + 3)])
    column[0], column[1], column[2], column[3] = transform_four(a, b, c, d)
    return line[0] + column[0]


@kernel
def intra_errors(image, corners, step, rounding, scale, order, errors):
    """Write the mean squared error of quantised intra residuals, by blocks and bands."""
    half, core = np.empty((4, 4), np.int32), np.empty((4, 4), np.int32)
    whole, predicted = np.empty((4, 4, 4)), np.zeros((DIRECTIONS, 4, 4, 4))
    line, column, totals = np.empty(4, np.int32), np.empty(4, np.int32), np.empty(DIRECTIONS)
    for k in range(corners.shape[0]):
        totals[:] = 0.0
        for part in range(4):
            y0, x0 = corners[k, 0] + 4 * (part // 2), corners[k, 1] + 4 * (part % 2)
            around = _intra_part(image, y0, x0, half, core, line, column)
            for y in range(4):
                for x in range(4):
                    whole[part, y, x] = scale[y, x] * core[y, x]
            for i in range(4):
                predicted[0, part, i, 0] = scale[i, 0] * (4 * line[i])
                predicted[1, part, 0, i] = scale[0, i] * (4 * column[i])
            predicted[2, part, 0, 0] = scale[0, 0] * (2 * around)
            for direction in range(DIRECTIONS):
                for i in range(4):
                    totals[direction] += abs(whole[part, i, 0] - predicted[direction, part, i, 0])
                for i in range(1, 4):
                    totals[direction] += abs(whole[part, 0, i] - predicted[direction, part, 0, i])
        best = 0
        for direction in range(1, DIRECTIONS):
            best = direction if totals[direction] < totals[best] else best
        for y in range(4):
            for x in range(4):
                square = 0.0
                for part in range(4):
                    size = abs(whole[part, y, x] - predicted[best, part, y, x])
                    error = size - np.floor(size / step + rounding) * step
                    square += error * error
                errors[order[y, x], k] = 0.25 * square


@kernel
def add_noise(motion, grid, spacing, share, noise, total):
    """Add a share of the noise of a reference where blocks come from: of the sampled block nearest to it."""
    places = np.empty(grid[0] * grid[1], np.int64)
    for row in range(grid[0]):
        for column in range(grid[1]):
            k = row * grid[1] + column
            y = (spacing * row + (motion[k, 1] >> 1) + spacing // 2) // spacing
            x = (spacing * column + (motion[k, 0] >> 1) + spacing // 2) // spacing
            places[k] = min(max(y, 0), grid[0] - 1) * grid[1] + min(max(x, 0), grid[1] - 1)
    for band in range(total.shape[0]):
        line, own = noise[band], total[band]
        for k in range(places.size):
            own[k] += np.float32(share) * line[np.uintp(places[k])]


@kernel
def variance_places(residual, noise, weights, step, first, places, histograms):
    """Weigh residual and noise of all bands to variances in squared steps; tell and count their places."""
    variances = np.empty(residual.shape[1], np.float32)
    of_residual, of_noise, added = weights[0], weights[1], weights[2]
    histograms[:] = 0
    for band in range(residual.shape[0]):
        for k in range(residual.shape[1]):
            variance = of_residual * residual[band, k] + of_noise * noise[band, k] + added
            variances[k] = variance / (step * step)
        bits = variances.view(np.int32)
        for k in range(residual.shape[1]):
            place = min(max((bits[k] >> 20) - first, 0), histograms.shape[1] - 1)
            places[band, k] = place
            histograms[band, place] += 1


@kernel
def expected_costs(histograms, planes, step, per_plane, scale, tables, bits, costs):
    """Write, by bands and numbers of planes that are known, what tables tell of all blocks, times `scale`."""
    costs[:] = 0.0
    for band in range(histograms.shape[0]):
        for place in range(histograms.shape[1]):
            count = histograms[band, place]
            if count:
                variance = count * tables[0, place] * step * step
                costs[band, 1, 0] += variance
                for depth in range(1, planes[band] + 1):
                    coarse = max(place - per_plane * (planes[band] - depth), 0)
                    costs[band, 0, depth] += count * bits[coarse]
                    costs[band, 1, depth] += variance * tables[1, coarse]
    costs *= scale


@kernel
def frame_costs(residual, noise, planes, step, num_bits, model, places, costs):
    """Place the variances of all bands of a frame, and write what its planes cost and leave; see `refine`."""
    borders, weights, first, per_plane, refined_share, tables = model
    scale, share = num_bits / places.shape[1], refined_share * num_bits
    histograms = np.empty((places.shape[0], tables.shape[1]), np.int64)
    for block in range(weights.shape[0]):
        b, e = borders[block], borders[block + 1]
        of_block = weights[block]
        variance_places(residual[b:e], noise[b:e], of_block, step, first, places[b:e], histograms[b:e])
        bits = tables[2 + block]
        expected_costs(histograms[b:e], planes[b:e], step, per_plane, scale, tables, bits, costs[b:e])
    refine(costs[0, 1, : planes[0] + 1], residual[1:], share)


@kernel
def refine(squares, residual, share):
    """Subtract what planes of DC save of other bands, whose residual is given, from the errors they leave."""
    most, totals = 0.0, np.zeros(residual.shape[0])
    for k in range(residual.shape[1]):
        for band in range(totals.size):
            totals[band] += np.float64(residual[band, k])
    for band in range(totals.size):
        most += share * totals[band] / residual.shape[1]
    unknown = max(squares[0], 1e-9)
    for depth in range(squares.size):
        squares[depth] -= most * np.sqrt(max(1.0 - squares[depth] / unknown, 0.0))


@kernel
def least_depths(costs, planes, bit_cost, depths):
    """Choose the planes of each band that cost least; return number, bits, and the error that they save."""
    num_planes, bits, saved = 0, 0.0, 0.0
    for band in range(planes.size):
        least = np.inf
        for depth in range(planes[band] + 1):
            total = costs[band, 1, depth] + bit_cost * costs[band, 0, depth]
            if total < least:
                least, depths[band] = total, depth
        num_planes += depths[band]
        bits += costs[band, 0, depths[band]]
        saved += costs[band, 1, 0] - costs[band, 1, depths[band]]
    return num_planes, bits, saved


@kernel
def shortest_length(bits):
    """Return the length of the shortest syndrome that is expected to serve for an ideal code length."""
    return CODE_RATIO[0] * bits + CODE_RATIO[1] * np.sqrt(bits)


@kernel
def choose_planes(costs, planes, num_bits, borders, worth, depths, lengths):
    """Choose the planes that pay, and the lengths of the syndromes, of all blocks of bands."""
    multiplier, bit_cost, least, (usual, margin) = worth
    for block in range(lengths.size):
        b, e = borders[block], borders[block + 1]
        num_planes, bits, saved = least_depths(costs[b:e], planes[b:e], bit_cost * multiplier, depths[b:e])
        size, need = num_bits * num_planes, shortest_length(bits)
        uncertain = need + RATE_MARGIN_BITS * num_bits
        lengths[block] = min(need + margin * uncertain, 1.1 * size)
        paid = min(need + usual * uncertain, 1.1 * size) + BLOCK_BITS
        if size > MAX_BLOCK_BITS or lengths[block] > LONGEST or saved < least[block] * multiplier * paid:
            depths[b:e] = 0
            lengths[block] = 0.0


@kernel
def remaining_noise(places, planes, depths, step, per_plane, tables, noise):
    """Write the squared error of each block that is left, by the planes of each band that are known."""
    for band in range(places.shape[0]):
        missing = per_plane * (planes[band] - depths[band])
        for k in range(places.shape[1]):
            place = np.int64(places[band, k])
            left = tables[0, place] * step * step
            noise[band, k] = left * tables[1, max(place - missing, 0)] if depths[band] > 0 else left


@kernel
def choose(errors, bands, model, worth, costs, sent, left):
    """Write what planes of a frame cost and leave, which are sent, and what these leave in each block.

    `errors`: residual and noise; `bands`: their planes, finest step, and bits of a plane; `sent`: planes of
    each band, and length of the syndrome of each block.
    """
    (residual, noise), (planes, step, num_bits), (depths, lengths) = errors, bands, sent
    places = np.empty(residual.shape, np.int16)
    frame_costs(residual, noise, planes, step, num_bits, model, places, costs)
    choose_planes(costs, planes, num_bits, model.borders, worth, depths, lengths)
    remaining_noise(places, planes, depths, step, model.per_plane, model.tables, left)
