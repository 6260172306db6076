"""Compiled loops of what tracks leave to be told; validated and described by their callers."""

import numpy as np

from dvc._jit import inlined_kernel, kernel

NEAREST = 3  # points whose motion is blended
_NEAR = 16.0  # squared distance, in pixels, up to which they count alike
SIDE = 8  # of a sampled block
DIRECTIONS = 3  # from the left, from above, from both


@kernel
def nearest_points(points, corners, distances, nearest):
    """List the `NEAREST` points nearest to the centre of each block; -1 where there are not so many."""
    distances[:] = np.inf
    nearest[:] = -1
    for k in range(corners.shape[0]):
        y, x = corners[k, 0] + 0.5 * SIDE, corners[k, 1] + 0.5 * SIDE
        for i in range(points.shape[0]):
            distance = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
            if distance < distances[k, NEAREST - 1]:
                place = NEAREST - 1
                while place > 0 and distances[k, place - 1] > distance:
                    distances[k, place] = distances[k, place - 1]
                    nearest[k, place] = nearest[k, place - 1]
                    place -= 1
                distances[k, place], nearest[k, place] = distance, i


@kernel
def blend_motion(distances, nearest, displacements, motion):
    """Blend the motion of the nearest points of each block: (x, y) in half pixels; none without points."""
    for k in range(motion.shape[0]):
        total, sum_x, sum_y = 0.0, 0.0, 0.0
        for place in range(NEAREST):
            i = nearest[k, place]
            if i >= 0:
                weight = 1.0 / (distances[k, place] + _NEAR)
                total += weight
                sum_x += weight * displacements[i, 0]
                sum_y += weight * displacements[i, 1]
        motion[k] = 0
        if total > 0.0:
            motion[k, 0] = np.int64(np.floor(2.0 * sum_x / total + 0.5))
            motion[k, 1] = np.int64(np.floor(2.0 * sum_y / total + 0.5))


@kernel
def add_half_samples(image, corners, motion, blocks):
    """Add four times the blocks of `image` at their corners, moved by half pixels, borders repeated."""
    height, width = image.shape
    for k in range(corners.shape[0]):
        y, x = 2 * corners[k, 0] + motion[k, 1], 2 * corners[k, 1] + motion[k, 0]
        y0, x0, fraction_y, fraction_x = y >> 1, x >> 1, y & 1, x & 1
        if y0 >= 0 and x0 >= 0 and y0 + SIDE + fraction_y <= height and x0 + SIDE + fraction_x <= width:
            for row in range(SIDE):
                above, below = y0 + row, y0 + row + fraction_y
                for column in range(SIDE):
                    left, right = x0 + column, x0 + column + fraction_x
                    blocks[k, row, column] += (
                        np.int32(image[above, left])
                        + np.int32(image[above, right])
                        + np.int32(image[below, left])
                        + np.int32(image[below, right])
                    )
        else:
            for row in range(SIDE):
                above = min(max(y0 + row, 0), height - 1)
                below = min(max(y0 + row + fraction_y, 0), height - 1)
                for column in range(SIDE):
                    left = min(max(x0 + column, 0), width - 1)
                    right = min(max(x0 + column + fraction_x, 0), width - 1)
                    blocks[k, row, column] += (
                        np.int32(image[above, left])
                        + np.int32(image[above, right])
                        + np.int32(image[below, left])
                        + np.int32(image[below, right])
                    )


@kernel
def subtract_samples(image, corners, factor, blocks):
    """Subtract `factor` times the blocks of `image` at their corners."""
    for k in range(corners.shape[0]):
        for row in range(SIDE):
            for column in range(SIDE):
                sample = np.int32(image[corners[k, 0] + row, corners[k, 1] + column])
                blocks[k, row, column] -= factor * sample


@inlined_kernel
def _transform(block, y0, x0, half, core):
    """Write the integer core of the 4x4 transform of a part of a block."""
    for x in range(4):
        a, b = block[y0, x0 + x], block[y0 + 1, x0 + x]
        c, d = block[y0 + 2, x0 + x], block[y0 + 3, x0 + x]
        half[0, x], half[1, x] = a + b + c + d, 2 * (a - d) + b - c
        half[2, x], half[3, x] = a - b - c + d, a - d - 2 * (b - c)
    for y in range(4):
        a, b, c, d = half[y, 0], half[y, 1], half[y, 2], half[y, 3]
        core[y, 0], core[y, 1] = a + b + c + d, 2 * (a - d) + b - c
        core[y, 2], core[y, 3] = a - b - c + d, a - d - 2 * (b - c)


@kernel
def energies(blocks, unit, scale, order, means):
    """Write the mean squared coefficient of each band in each block of samples, `unit` to a grey level."""
    half, core = np.empty((4, 4), np.int32), np.empty((4, 4), np.int32)
    squares, weights = np.empty((4, 4)), np.empty((4, 4))
    for y in range(4):
        for x in range(4):
            weights[y, x] = (scale[y, x] / unit) ** 2 / ((SIDE // 4) * (SIDE // 4))
    for k in range(blocks.shape[0]):
        squares[:] = 0.0
        for y0 in range(0, SIDE, 4):
            for x0 in range(0, SIDE, 4):
                _transform(blocks[k], y0, x0, half, core)
                for y in range(4):
                    for x in range(4):
                        squares[y, x] += np.float64(core[y, x]) * np.float64(core[y, x])
        for y in range(4):
            for x in range(4):
                means[order[y, x], k] = squares[y, x] * weights[y, x]


@inlined_kernel
def _intra_residual(image, y0, x0, direction, block):
    """Write eight times a block less what its neighbours predict, by 4x4 parts."""
    for y in range(0, SIDE, 4):
        for x in range(0, SIDE, 4):
            above, left = max(y0 + y - 1, 0), max(x0 + x - 1, 0)
            around = 0
            for i in range(4):
                around += np.int32(image[y0 + y + i, left]) + np.int32(image[above, x0 + x + i])
            for row in range(4):
                for column in range(4):
                    predicted = around
                    if direction == 0:
                        predicted = 8 * np.int32(image[y0 + y + row, left])
                    elif direction == 1:
                        predicted = 8 * np.int32(image[above, x0 + x + column])
                    sample = np.int32(image[y0 + y + row, x0 + x + column])
                    block[y + row, x + column] = 8 * sample - predicted


@kernel
def intra_errors(image, corners, step, rounding, scale, order, errors):
    """Write the mean squared error of quantised intra residuals, by blocks and bands.

    Each block is predicted in the direction that leaves the smallest coefficients.
    """
    half, core = np.empty((4, 4), np.int32), np.empty((4, 4), np.int32)
    block, squares = np.empty((SIDE, SIDE), np.int32), np.empty(16)
    for k in range(corners.shape[0]):
        least = np.inf
        for direction in range(DIRECTIONS):
            _intra_residual(image, corners[k, 0], corners[k, 1], direction, block)
            squares[:] = 0.0
            total = 0.0
            for y0 in range(0, SIDE, 4):
                for x0 in range(0, SIDE, 4):
                    _transform(block, y0, x0, half, core)
                    for y in range(4):
                        for x in range(4):
                            size = abs(core[y, x]) * (0.125 * scale[y, x])
                            error = size - np.floor(size / step + rounding) * step
                            squares[order[y, x]] += 0.25 * error * error
                            total += size
            if total < least:
                least = total
                for band in range(16):
                    errors[band, k] = squares[band]


@kernel
def add_noise(corners, motion, grid, spacing, noise, total):
    """Add the noise of a reference where the blocks come from: that of the sampled block nearest to it."""
    for k in range(corners.shape[0]):
        row = (corners[k, 0] + (motion[k, 1] >> 1) + spacing // 2) // spacing
        column = (corners[k, 1] + (motion[k, 0] >> 1) + spacing // 2) // spacing
        place = min(max(row, 0), grid[0] - 1) * grid[1] + min(max(column, 0), grid[1] - 1)
        for band in range(total.shape[0]):
            total[band, k] += noise[band, place]


@kernel
def variance_places(residual, noise, weights, step, first, places, histograms):
    """Weigh residual and noise of all bands to variances in squared steps; tell and count their places."""
    variances = np.empty(residual.shape[1], np.float32)
    histograms[:] = 0
    for band in range(residual.shape[0]):
        for k in range(residual.shape[1]):
            variance = weights[0] * residual[band, k] + weights[1] * noise[band, k] + weights[2]
            variances[k] = variance / (step * step)
        bits = variances.view(np.int32)
        for k in range(residual.shape[1]):
            place = min(max((bits[k] >> 20) - first, 0), histograms.shape[1] - 1)
            places[band, k] = place
            histograms[band, place] += 1


@kernel
def expected_costs(histograms, planes, step, shift, tables, entropies, needs, errors):
    """Add up, by bands and numbers of planes that are known, what tables tell of all blocks.

    Entropies are those of the variances as they are and, for `needs`, `shift[1]` places lower; a plane is
    `shift[0]` places.
    """
    values, entropy, error = tables
    for band in range(histograms.shape[0]):
        for place in range(histograms.shape[1]):
            count = histograms[band, place]
            if count:
                variance = count * values[place] * step * step
                errors[band, 0] += variance
                for depth in range(1, planes[band] + 1):
                    coarse = place - shift[0] * (planes[band] - depth)
                    entropies[band, depth] += count * entropy[max(coarse, 0)]
                    needs[band, depth] += count * entropy[max(coarse - shift[1], 0)]
                    errors[band, depth] += variance * error[max(coarse, 0)]


@kernel
def remaining_noise(places, planes, depths, step, per_plane, tables, noise):
    """Write the squared error of each block that is left, by the planes of each band that are known."""
    values, _, error = tables
    for band in range(places.shape[0]):
        for k in range(places.shape[1]):
            noise[band, k] = values[places[band, k]] * step * step
            if depths[band] > 0:
                coarse = max(places[band, k] - per_plane * (planes[band] - depths[band]), 0)
                noise[band, k] *= error[coarse]
