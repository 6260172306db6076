"""Compiled loops of the Wyner-Ziv encoder: transform and quantisation of a frame into words of bits."""

import numpy as np

from dvc._jit import kernel


@kernel
def transform_blocks(samples, scale, coefficients):
    """4x4 integer transform; `scale` (4, 4) and `coefficients` (16, N) in raster order of the block."""
    columns = samples.shape[1] // 4
    half = np.empty((4, 4), np.int64)
    for block in range(coefficients.shape[1]):
        y0, x0 = 4 * (block // columns), 4 * (block % columns)
        for x in range(4):
            a, b = np.int64(samples[y0, x0 + x]), np.int64(samples[y0 + 1, x0 + x])
            c, d = np.int64(samples[y0 + 2, x0 + x]), np.int64(samples[y0 + 3, x0 + x])
            outer, inner, outer_odd, inner_odd = a + d, b + c, a - d, b - c
            half[0, x], half[1, x] = outer + inner, 2 * outer_odd + inner_odd
            half[2, x], half[3, x] = outer - inner, outer_odd - 2 * inner_odd
        for y in range(4):
            a, b, c, d = half[y, 0], half[y, 1], half[y, 2], half[y, 3]
            outer, inner, outer_odd, inner_odd = a + d, b + c, a - d, b - c
            coefficients[4 * y, block] = (outer + inner) * scale[y, 0]
            coefficients[4 * y + 1, block] = (2 * outer_odd + inner_odd) * scale[y, 1]
            coefficients[4 * y + 2, block] = (outer - inner) * scale[y, 2]
            coefficients[4 * y + 3, block] = (outer_odd - 2 * inner_odd) * scale[y, 3]


@kernel
def pack_uniform(coefficients, step, num_planes, first_plane, words):
    """Quantise a DC band into `words` (W, N): plane p is bit 63 - p % 64 of row p // 64."""
    last = (1 << num_planes) - 1
    per_step = 1.0 / step
    numbers = np.empty(coefficients.size, np.uint64)
    for n in range(coefficients.size):
        numbers[n] = min(max(np.int64(coefficients[n] * per_step), 0), last)
    put_bits(numbers, num_planes, first_plane, words)


@kernel
def pack_dead_zone(coefficients, step, num_planes, first_plane, words):
    """Quantise an AC band (doubled zero bin) and put its planes into `words`."""
    largest = (1 << (num_planes - 1)) - 1
    per_step = 1.0 / step
    numbers = np.empty(coefficients.size, np.uint64)
    for n in range(coefficients.size):
        value = coefficients[n] * per_step
        above, below = np.int64(value), np.int64(-value)
        below -= np.int64(below > 0) & np.int64(below == -value)  # a border belongs to the bin above it
        numbers[n] = largest + min(max(above, 0), largest) - min(max(below, 0), largest)
    put_bits(numbers, num_planes, first_plane, words)


@kernel
def put_bits(numbers, num_planes, first_plane, words):
    """Set the planes of one band, most significant first; at once where they share a word."""
    row = first_plane >> 6
    spare = 64 * (row + 1) - first_plane - num_planes
    if spare >= 0:
        line = words[row]
        for n in range(numbers.size):
            line[n] |= numbers[n] << np.uint64(spare)
        return
    for p in range(num_planes):
        plane = first_plane + p
        line = words[plane >> 6]
        for n in range(numbers.size):
            bit = (numbers[n] >> np.uint64(num_planes - 1 - p)) & np.uint64(1)
            line[n] |= bit << np.uint64(63 - (plane & 63))
