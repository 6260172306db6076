"""Compiled loops of the Wyner-Ziv encoder: transform and quantisation of a frame into words of bits."""

import numpy as np

from dvc._jit import kernel


@kernel
def transform_blocks(samples, scale, coefficients):  # type: ignore[no-untyped-def]
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
def pack_uniform(coefficients, step, num_planes, first_plane, words):  # type: ignore[no-untyped-def]
    """Quantise a DC band and put its planes into `words` (N, W), plane p in bit p % 64 of column p // 64."""
    last = (1 << num_planes) - 1
    for n in range(coefficients.size):
        number = min(max(np.int64(coefficients[n] / step), 0), last)
        put_bits(number, num_planes, first_plane, words, n)


@kernel
def pack_dead_zone(coefficients, step, num_planes, first_plane, words):  # type: ignore[no-untyped-def]
    """Quantise an AC band (doubled zero bin) and put its planes into `words`."""
    largest = (1 << (num_planes - 1)) - 1
    for n in range(coefficients.size):
        value = coefficients[n]
        if value >= 0.0:
            number = largest + min(np.int64(value / step), largest)
        else:
            number = largest - min(max(np.int64(np.ceil(-value / step)) - 1, 0), largest)
        put_bits(number, num_planes, first_plane, words, n)


@kernel
def put_bits(number, num_planes, first_plane, words, n):  # type: ignore[no-untyped-def]
    """Set the planes of one coefficient, most significant first."""
    for p in range(num_planes):
        plane = first_plane + p
        bit = np.uint64((number >> (num_planes - 1 - p)) & 1)
        words[n, plane >> 6] |= bit << np.uint64(plane & 63)
