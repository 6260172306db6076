"""Compiled loops of what tracks leave to be told; validated and described by their callers."""

import numpy as np

from dvc._jit import kernel

_NEAREST = 3  # points whose motion is blended
_NEAR = 16.0  # squared distance, in pixels, up to which they count alike


@kernel
def motion_field(points, displacements, block, field):
    """Blend the motion of the points nearest to the centre of each block: (x, y) in half pixels."""
    distances, nearest = np.empty(_NEAREST), np.empty(_NEAREST, np.int64)
    for row in range(field.shape[0]):
        for column in range(field.shape[1]):
            x, y = (column + 0.5) * block, (row + 0.5) * block
            distances[:] = np.inf
            for i in range(points.shape[0]):
                distance = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
                if distance < distances[_NEAREST - 1]:
                    place = _NEAREST - 1
                    while place > 0 and distances[place - 1] > distance:
                        distances[place], nearest[place] = distances[place - 1], nearest[place - 1]
                        place -= 1
                    distances[place], nearest[place] = distance, i
            total, sum_x, sum_y = 0.0, 0.0, 0.0
            for k in range(min(_NEAREST, points.shape[0])):
                weight = 1.0 / (distances[k] + _NEAR)
                total += weight
                sum_x += weight * displacements[nearest[k], 0]
                sum_y += weight * displacements[nearest[k], 1]
            field[row, column, 0] = np.int64(np.floor(2.0 * sum_x / total + 0.5))
            field[row, column, 1] = np.int64(np.floor(2.0 * sum_y / total + 0.5))


@kernel
def add_half_samples(image, x, y, block):
    """Add four times the block of `image` at (x, y), in half pixels, borders repeated, to `block`."""
    height, width = image.shape
    fraction_x, fraction_y = x & 1, y & 1
    for row in range(block.shape[0]):
        y0 = min(max((y >> 1) + row, 0), height - 1)
        y1 = min(max((y >> 1) + row + fraction_y, 0), height - 1)
        for column in range(block.shape[1]):
            x0 = min(max((x >> 1) + column, 0), width - 1)
            x1 = min(max((x >> 1) + column + fraction_x, 0), width - 1)
            block[row, column] += (
                np.int64(image[y0, x0])
                + np.int64(image[y0, x1])
                + np.int64(image[y1, x0])
                + np.int64(image[y1, x1])
            )


@kernel
def add_magnitudes(block, unit, scale, order, magnitudes):
    """Add the magnitudes of the 4x4 transforms of a block of samples, `unit` to a grey level, by bands."""
    half = np.empty((4, 4), np.int64)
    num_blocks = (block.shape[0] // 4) * (block.shape[1] // 4)
    for y0 in range(0, block.shape[0], 4):
        for x0 in range(0, block.shape[1], 4):
            for x in range(4):
                a, b = block[y0, x0 + x], block[y0 + 1, x0 + x]
                c, d = block[y0 + 2, x0 + x], block[y0 + 3, x0 + x]
                half[0, x], half[1, x] = a + b + c + d, 2 * (a - d) + b - c
                half[2, x], half[3, x] = a - b - c + d, a - d - 2 * (b - c)
            for y in range(4):
                a, b, c, d = half[y, 0], half[y, 1], half[y, 2], half[y, 3]
                per_unit = 1.0 / (unit * num_blocks)
                magnitudes[order[y, 0]] += abs(a + b + c + d) * scale[y, 0] * per_unit
                magnitudes[order[y, 1]] += abs(2 * (a - d) + b - c) * scale[y, 1] * per_unit
                magnitudes[order[y, 2]] += abs(a - b - c + d) * scale[y, 2] * per_unit
                magnitudes[order[y, 3]] += abs(a - d - 2 * (b - c)) * scale[y, 3] * per_unit


@kernel
def residual_magnitudes(luma, references, fields, motion_block, scale, order, magnitudes):
    """Write the mean magnitude of the residual's coefficients by blocks of 8x8 samples and bands.

    The residual is that of the mean of all references, each moved by its field.
    """
    magnitudes[:] = 0.0
    side = 8
    columns = luma.shape[1] // side
    residual = np.empty((side, side), np.int64)
    num_references = references.shape[0]
    for k in range(magnitudes.shape[0]):
        y0, x0 = side * (k // columns), side * (k % columns)
        residual[:] = 0
        for r in range(num_references):
            motion = fields[r, y0 // motion_block, x0 // motion_block]
            add_half_samples(references[r], 2 * x0 + motion[0], 2 * y0 + motion[1], residual)
        for row in range(side):
            for column in range(side):
                residual[row, column] -= 4 * num_references * np.int64(luma[y0 + row, x0 + column])
        add_magnitudes(residual, 4.0 * num_references, scale, order, magnitudes[k])
