"""Compiled loops of the block-motion methods; validated and described by their callers.

References are *phase planes*: ``planes[py, px, y + margin, x + margin]`` is the sample at
(y + py / 4, x + px / 4). Positions and vectors are in quarter samples, (vertical, horizontal).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.arrays import Bytes


class Blocks(NamedTuple):
    """Positions of blocks, and their compared squares, in whole samples."""

    margin: int  # around the frame in its planes
    block: int  # side of a block
    window: int  # side of the square around it that is compared


class Steps(NamedTuple):
    """Displacements that are tried around another one."""

    radius: int  # how many steps to each side
    step: int  # in quarter samples
    smoothness: float  # what being far from the start, or from the neighbours, costs
    enough: float = 0.0  # mean absolute difference, in levels, that is not searched any further


class Searched(NamedTuple):
    """Phase planes to compare, one or sixteen, and their sums over all squares of half the window."""

    samples: Bytes
    sums: NDArray[np.uint16]


@kernel
def _six_taps(a, b, c, d, e, f):
    return (a + f) - 5 * (b + e) + 20 * (c + d)


@kernel
def _half_samples(padded, across, rows):
    """Write `rows` (2, 2, H + 1, W + 1): whole and half rows, at whole and half columns, as H.264 does."""
    height, width = rows.shape[2:]
    for y in range(across.shape[0]):
        line = padded[y]
        for x in range(across.shape[1]):
            across[y, x] = _six_taps(
                np.int16(line[x]), np.int16(line[x + 1]), np.int16(line[x + 2]),
                np.int16(line[x + 3]), np.int16(line[x + 4]), np.int16(line[x + 5]),
            )  # fmt: skip
    for y in range(height):
        a, b, c = padded[y], padded[y + 1], padded[y + 2]
        d, e, f = padded[y + 3], padded[y + 4], padded[y + 5]
        for x in range(width):
            rows[0, 0, y, x] = c[x + 2]
            down = _six_taps(
                np.int32(a[x + 2]), np.int32(b[x + 2]), np.int32(c[x + 2]),
                np.int32(d[x + 2]), np.int32(e[x + 2]), np.int32(f[x + 2]),
            )  # fmt: skip
            rows[1, 0, y, x] = min(max((down + 16) >> 5, 0), 255)
            rows[0, 1, y, x] = min(max((np.int32(across[y + 2, x]) + 16) >> 5, 0), 255)
            both = _six_taps(
                np.int32(across[y, x]), np.int32(across[y + 1, x]), np.int32(across[y + 2, x]),
                np.int32(across[y + 3, x]), np.int32(across[y + 4, x]), np.int32(across[y + 5, x]),
            )  # fmt: skip
            rows[1, 1, y, x] = min(max((both + 512) >> 10, 0), 255)


@kernel
def _mean(first, second, mean):
    for x in range(mean.size):
        mean[x] = (np.uint16(first[x]) + np.uint16(second[x]) + np.uint16(1)) >> np.uint16(1)


@kernel
def quarter_samples(padded, planes):
    """Write phase planes (4, 4, H, W) of a plane that is padded by two samples before, and four behind."""
    height, width = planes.shape[2:]
    across = np.empty((height + 6, width + 1), np.int16)
    rows = np.empty((2, 2, height + 1, width + 1), np.uint8)
    _half_samples(padded, across, rows)
    line = np.empty((2, width + 1), np.uint8)
    for y in range(height):
        for phase in range(4):
            for half in range(2):
                first = rows[phase >> 1, half, y]
                second = rows[1, half, y] if phase == 1 else rows[0, half, y + 1]
                if phase & 1:
                    _mean(first, second, line[half])
                else:
                    for x in range(width + 1):
                        line[half, x] = first[x]
            for x in range(width):
                planes[phase, 0, y, x], planes[phase, 2, y, x] = line[0, x], line[1, x]
            _mean(line[0], line[1], planes[phase, 1, y])
            _mean(line[1], line[0, 1:], planes[phase, 3, y])


@inlined_kernel
def _square_sad(planes_a, row_a, column_a, planes_b, row_b, column_b, size):
    """SAD of two squares of 8 to 15 samples, two vectors of 8 a row; the caller's side is a constant."""
    phase_a = np.uintp(row_a & 3), np.uintp(column_a & 3)
    phase_b = np.uintp(row_b & 3), np.uintp(column_b & 3)
    ya, xa, yb, xb = row_a >> 2, column_a >> 2, row_b >> 2, column_b >> 2
    total = np.int32(0)
    for column in range(8):
        mask = np.uint8(255) if column >= 16 - size else np.uint8(0)
        for row in range(size):
            line_a, line_b = np.uintp(ya + row), np.uintp(yb + row)
            one = planes_a[phase_a[0], phase_a[1], line_a, np.uintp(xa + column)]
            other = planes_b[phase_b[0], phase_b[1], line_b, np.uintp(xb + column)]
            late = planes_a[phase_a[0], phase_a[1], line_a, np.uintp(xa + size - 8 + column)] & mask
            other_late = planes_b[phase_b[0], phase_b[1], line_b, np.uintp(xb + size - 8 + column)] & mask
            total = np.int32(total + abs(np.int32(np.int32(one) - np.int32(other))))
            total = np.int32(total + abs(np.int32(np.int32(late) - np.int32(other_late))))
    return np.int64(total)


@inlined_kernel
def block_sad(planes_a, row_a, column_a, planes_b, row_b, column_b, size):
    """SAD of two blocks at quarter samples of padded planes; to stop early takes longer than vectors do."""
    if size == 8:
        return _square_sad(planes_a, row_a, column_a, planes_b, row_b, column_b, 8)
    if size == 12:
        return _square_sad(planes_a, row_a, column_a, planes_b, row_b, column_b, 12)
    total = np.int64(0)
    if size in (16, 24):
        for k in range(4):
            down, right = 2 * size * (k >> 1), 2 * size * (k & 1)
            quarter = row_a + down, column_a + right, row_b + down, column_b + right
            if size == 16:
                total += _square_sad(planes_a, quarter[0], quarter[1], planes_b, quarter[2], quarter[3], 8)
            else:
                total += _square_sad(planes_a, quarter[0], quarter[1], planes_b, quarter[2], quarter[3], 12)
        return total
    plane_a, plane_b = planes_a[row_a & 3, column_a & 3], planes_b[row_b & 3, column_b & 3]
    for y in range(size):
        for x in range(size):
            one = plane_a[(row_a >> 2) + y, (column_a >> 2) + x]
            other = plane_b[(row_b >> 2) + y, (column_b >> 2) + x]
            total += abs(np.int64(one) - np.int64(other))
    return total


@kernel
def clamp_position(position, size, length):
    """Keep a block of `size` samples inside `length` samples; quarter samples, one sample spare."""
    return min(max(position, 0), 4 * (length - size - 1))


@kernel
def forward_search(pair, blocks, steps, starts, vectors):
    """Full search of every block of frame b in frame a around `starts`, favouring short corrections."""
    planes_a, planes_b = pair
    margin, block, window = blocks
    radius, step, smoothness, _ = steps
    height, width = planes_a.shape[2], planes_a.shape[3]
    border = (window - block) // 2
    for i in range(vectors.shape[0]):
        for j in range(vectors.shape[1]):
            row = clamp_position(4 * (margin + i * block - border), window, height)
            column = clamp_position(4 * (margin + j * block - border), window, width)
            best = np.float64(1e18)
            best_v, best_h = 0, 0
            for v in range(-radius, radius + 1):
                for h in range(-radius, radius + 1):
                    dv, dh = starts[i, j, 0] + v * step, starts[i, j, 1] + h * step
                    row_a = clamp_position(row - dv, window, height)
                    column_a = clamp_position(column - dh, window, width)
                    weight = 1.0 + smoothness * np.sqrt(np.float64(v * v + h * h))
                    sad = block_sad(planes_b, row, column, planes_a, row_a, column_a, window)
                    if (sad + window) * weight < best:
                        best = (sad + window) * weight
                        best_v, best_h = dv, dh
            vectors[i, j, 0] = best_v
            vectors[i, j, 1] = best_h


@kernel
def bilateral_sad(pair, instant, row, column, dv, dh, window):
    """Difference of the two references along one linear trajectory through a block of the missing frame."""
    planes_a, planes_b = pair
    numerator, denominator = instant
    height, width = planes_a.shape[2], planes_a.shape[3]
    # The displacement towards the first reference, at position numerator / denominator.
    row_a = row - (2 * dv * numerator + denominator) // (2 * denominator)
    column_a = column - (2 * dh * numerator + denominator) // (2 * denominator)
    row_b, column_b = row_a + dv, column_a + dh
    outside = 0
    for position, length in ((row_a, height), (row_b, height), (column_a, width), (column_b, width)):
        outside += position < 0 or position > 4 * (length - window - 1)
    if outside:
        return np.int64(1) << 40
    return block_sad(planes_a, row_a, column_a, planes_b, row_b, column_b, window)


@kernel
def neighbourhood(field, i, j, vectors):
    """Write a vector and its eight neighbours, the border repeated: (9, 2)."""
    last_row, last_column = field.shape[0] - 1, field.shape[1] - 1
    vectors[0, 0], vectors[0, 1] = field[i, j, 0], field[i, j, 1]
    count = 1
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            if dy != 0 or dx != 0:
                row, column = min(max(i + dy, 0), last_row), min(max(j + dx, 0), last_column)
                vectors[count, 0], vectors[count, 1] = field[row, column, 0], field[row, column, 1]
                count += 1


@kernel
def vector_median(field, median):
    """Write the vector of each 3x3 neighbourhood with the least sum of distances to the other ones."""
    vectors = np.empty((9, 2), np.int64)
    for i in range(field.shape[0]):
        for j in range(field.shape[1]):
            neighbourhood(field, i, j, vectors)
            least, best = np.int64(1) << 62, 0
            for k in range(9):
                total = np.int64(0)
                for m in range(9):
                    total += abs(vectors[k, 0] - vectors[m, 0]) + abs(vectors[k, 1] - vectors[m, 1])
                if total < least:
                    least, best = total, k
            median[i, j, 0], median[i, j, 1] = vectors[best, 0], vectors[best, 1]


@kernel
def refine_bilateral(pair, instant, blocks, steps, fields, vectors):
    """Choose displacements of a field, or its medians, and steps from them by the bilateral difference."""
    field, medians = fields
    margin, block, window = blocks
    radius, step, smoothness, _ = steps
    height, width = pair[0].shape[2], pair[0].shape[3]
    border = (window - block) // 2
    candidates = np.zeros((11, 2), np.int64)  # the last one is no motion
    for i in range(vectors.shape[0]):
        for j in range(vectors.shape[1]):
            row = clamp_position(4 * (margin + i * block - border), window, height)
            column = clamp_position(4 * (margin + j * block - border), window, width)
            neighbourhood(medians, i, j, candidates)
            candidates[9, 0], candidates[9, 1] = field[i, j, 0], field[i, j, 1]
            best = np.int64(1) << 41
            best_v, best_h = candidates[0, 0], candidates[0, 1]
            for k in range(11):
                dv, dh = candidates[k, 0], candidates[k, 1]
                cost = smoothness_cost(candidates, dv, dh, smoothness)
                if cost < best:
                    cost += bilateral_sad(pair, instant, row, column, dv, dh, window)
                if cost < best:
                    best, best_v, best_h = cost, dv, dh
            centre_v, centre_h = best_v, best_h
            for v in range(-radius, radius + 1):
                for h in range(-radius, radius + 1):
                    dv, dh = centre_v + v * step, centre_h + h * step
                    cost = smoothness_cost(candidates, dv, dh, smoothness)
                    if cost < best:
                        cost += bilateral_sad(pair, instant, row, column, dv, dh, window)
                    if cost < best:
                        best, best_v, best_h = cost, dv, dh
            vectors[i, j, 0] = best_v
            vectors[i, j, 1] = best_h


@kernel
def smoothness_cost(candidates, dv, dh, smoothness):
    """Cost of a displacement against the neighbours' (candidates 1..8): mean of the clipped distances."""
    total = 0
    for k in range(1, 9):
        distance = abs(candidates[k, 0] - dv) + abs(candidates[k, 1] - dh)
        total += min(distance, 32)
    return (total * smoothness) >> 5


@kernel
def box_sums(plane, side, sums):
    """Sum up all squares of samples: ``sums[y, x]`` is that of ``plane[y : y + side, x : x + side]``."""
    columns = np.zeros(plane.shape[1], np.uint16)
    for y in range(plane.shape[0]):
        for x in range(columns.size):
            columns[x] += plane[y, x]
        if y < side - 1:
            continue
        line = sums[y - side + 1]
        line[:] = np.uint16(0)
        for k in range(side):
            for x in range(line.size):
                line[x] += columns[x + k]
        for x in range(columns.size):
            columns[x] -= plane[y - side + 1, x]


@inlined_kernel
def quarter_sums(sums, row, column, half):
    """Sums of the four quarters of a block at a position in quarter samples."""
    py, px = np.uintp(row & 3), np.uintp(column & 3)
    top, left, bottom, right = row >> 2, column >> 2, (row >> 2) + half, (column >> 2) + half
    top, left, bottom, right = np.uintp(top), np.uintp(left), np.uintp(bottom), np.uintp(right)
    return (
        np.int64(sums[py, px, top, left]),
        np.int64(sums[py, px, top, right]),
        np.int64(sums[py, px, bottom, left]),
        np.int64(sums[py, px, bottom, right]),
    )


@kernel
def search_target(searched, reference, blocks, steps, offsets, costs):
    """Move offsets of blocks that match badly to the best match; sums of quarters bound SADs from below."""
    (target, target_sums), (planes, sums) = searched, reference
    margin, block, window = blocks
    radius, step, smoothness, enough = steps
    height, width = planes.shape[2], planes.shape[3]
    border, half = (window - block) // 2, window // 2
    for i in range(offsets.shape[0]):
        for j in range(offsets.shape[1]):
            row = 4 * min(margin + i * block - border, height - window - 1)
            column = 4 * min(margin + j * block - border, width - window - 1)
            start_v, start_h = offsets[i, j, 0], offsets[i, j, 1]
            row_r = clamp_position(row + start_v, window, height)
            column_r = clamp_position(column + start_h, window, width)
            best = block_sad(target, row, column, planes, row_r, column_r, window)
            costs[i, j] = best
            if best <= enough * window * window:
                continue
            a, b, c, d = quarter_sums(target_sums, row, column, half)
            for v in range(-radius, radius + 1):
                row_r = clamp_position(row + start_v + v * step, window, height)
                for h in range(-radius, radius + 1):
                    column_r = clamp_position(column + start_h + h * step, window, width)
                    cost = smoothness * step * (abs(v) + abs(h))
                    e, f, g, k = quarter_sums(sums, row_r, column_r, half)
                    if cost + abs(a - e) + abs(b - f) + abs(c - g) + abs(d - k) >= best:
                        continue
                    cost += block_sad(target, row, column, planes, row_r, column_r, window)
                    if cost < best:
                        best = cost
                        offsets[i, j, 0], offsets[i, j, 1] = start_v + v * step, start_h + h * step
            costs[i, j] = best


@kernel
def accumulate_blocks(planes, margin, block, taper, offsets, weights, total, total_weight):
    """Add blocks' displaced reference into `total`, tapered by an overlapping window twice their side."""
    height, width = planes.shape[2], planes.shape[3]
    size = 2 * block
    for i in range(offsets.shape[0]):
        for j in range(offsets.shape[1]):
            row = clamp_position(4 * (margin + i * block - block // 2) + offsets[i, j, 0], size, height)
            column = clamp_position(4 * (margin + j * block - block // 2) + offsets[i, j, 1], size, width)
            plane = planes[row & 3, column & 3]
            y0, x0 = row >> 2, column >> 2
            for y in range(size):
                for x in range(size):
                    weight = taper[y, x] * weights[i, j]
                    total[i * block + y, j * block + x] += weight * plane[y0 + y, x0 + x]
                    total_weight[i * block + y, j * block + x] += weight
