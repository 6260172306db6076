"""The 4x4 integer transform of H.264 [Malvar2003], scaled to be orthonormal, over whole frames.

A frame becomes 16 *bands* in zigzag order; band ``b`` holds one coefficient of every 4x4 block, blocks in
raster order. The core is exact integer arithmetic, so that both sides get the same numbers on any processor.
The DC coefficient of 8-bit samples lies in [0, 1020].
"""
# mypy: allow-untyped-defs, no-check-untyped-defs

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.config import ZIGZAG

Samples = NDArray[Any]
"""Integers or floats."""

BLOCK = 4
NUM_BANDS = BLOCK * BLOCK
ORDER = np.argsort(ZIGZAG).reshape(BLOCK, BLOCK)
_NORM = 1.0 / np.sqrt([4, 10, 4, 10])  # lengths of the rows of the core
SCALE = np.outer(_NORM, _NORM)
"""Factors that make the coefficients of the integer core orthonormal, by row and column in the block."""
BAND_SCALE: NDArray[np.float64] = SCALE.ravel()[list(ZIGZAG)]
"""The same by band."""


def band_shape(height: int, width: int) -> tuple[int, int]:
    """Return how many rows and columns of 4x4 blocks cover a frame."""
    return -(-height // BLOCK), -(-width // BLOCK)


def pad_to_blocks(luma: Samples) -> Samples:
    """Replicate the last row and column until both sides are multiples of 4."""
    rows, columns = band_shape(*luma.shape)
    missing = (rows * BLOCK - luma.shape[0], columns * BLOCK - luma.shape[1])
    if missing == (0, 0):
        return luma
    return np.pad(luma, ((0, missing[0]), (0, missing[1])), mode="edge")


def integer_core(luma: NDArray[np.uint8]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Transform a frame into bands of integers, which are not scaled yet."""
    if luma.dtype != np.uint8:
        raise TypeError(f"`luma` must be uint8, got {luma.dtype}")
    padded = pad_to_blocks(luma)
    rows, columns = band_shape(*padded.shape)
    quads = np.ascontiguousarray(padded).view("<u4")
    if not (quads.flags.aligned and quads.flags.writeable):
        quads = quads.copy()  # compiled code is that for arrays which are both
    core = np.empty((NUM_BANDS, rows * columns), np.int16)
    extremes = np.empty((NUM_BANDS, 2), np.int16)
    _transform_samples(quads, ORDER, core, extremes)
    return core, extremes


def forward(luma: Samples) -> NDArray[np.float64]:
    """Transform a frame into bands; inverse of `inverse`."""
    padded = pad_to_blocks(luma)
    shape = band_shape(*padded.shape)
    bands = np.empty((NUM_BANDS, shape[0] * shape[1]))
    _transform_blocks(np.ascontiguousarray(padded, np.float64), SCALE, ORDER, bands)
    return bands.reshape(NUM_BANDS, *shape)


def inverse(bands: NDArray[np.float64], height: int, width: int) -> NDArray[np.float64]:
    """Transform bands back into a frame; inverse of `forward`."""
    if bands.shape != (NUM_BANDS, *band_shape(height, width)):
        raise ValueError(f"`bands` has shape {bands.shape}, which does not fit a frame of {width}x{height}")
    scaled: list[list[NDArray[np.float64]]] = [[np.empty(0)] * BLOCK for _ in range(BLOCK)]
    for band, position in enumerate(ZIGZAG):
        y, x = divmod(position, BLOCK)
        scaled[y][x] = bands[band] * SCALE[y, x]
    vertical = [_inverse_butterfly(*(scaled[y][x] for y in range(BLOCK))) for x in range(BLOCK)]
    samples = np.empty((bands.shape[1], BLOCK, bands.shape[2], BLOCK))
    for y in range(BLOCK):
        line = _inverse_butterfly(*(vertical[x][y] for x in range(BLOCK)))
        for x in range(BLOCK):
            samples[:, y, :, x] = line[x]
    return samples.reshape(bands.shape[1] * BLOCK, bands.shape[2] * BLOCK)[:height, :width]


def _inverse_butterfly(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], d: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    return a + 2 * b + c + d, a + b - c - 2 * d, a - b - c + 2 * d, a - 2 * b + c - d


def to_uint8(samples: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Round to the nearest of [0, 255]."""
    return np.clip(np.floor(samples + 0.5), 0, 255).astype(np.uint8)


@inlined_kernel
def _transform_four(a, b, c, d):
    """Transform four numbers: one side of the 4x4 integer transform, not scaled."""
    outer, inner, outer_odd, inner_odd = a + d, b + c, a - d, b - c
    return outer + inner, 2 * outer_odd + inner_odd, outer - inner, outer_odd - 2 * inner_odd


@kernel
def _transform_lines(first, second, third, fourth):
    """Do what `_transform_four` does to four lines, in place; int16, which holds samples and sums of them."""
    for n in range(first.size):
        a, b, c, d = first[n], second[n], third[n], fourth[n]
        outer, outer_odd = np.int16(a + d), np.int16(a - d)
        inner, inner_odd = np.int16(b + c), np.int16(b - c)
        first[n], second[n] = outer + inner, np.int16(outer_odd + outer_odd) + inner_odd
        third[n], fourth[n] = outer - inner, outer_odd - np.int16(inner_odd + inner_odd)


@kernel
def _transform_samples(quads, order, core, extremes):
    """4x4 integer transform, not scaled, to int16 `core` (16, N), with the `extremes` (16, 2) of bands."""
    columns = quads.shape[1]
    for y in range(quads.shape[0]):
        line, start = quads[y], y // 4 * columns
        first, second = core[order[y % 4, 0]][start:], core[order[y % 4, 1]][start:]
        third, fourth = core[order[y % 4, 2]][start:], core[order[y % 4, 3]][start:]
        for x in range(columns):
            quad = line[x]
            first[x], second[x] = quad & np.uint32(255), (quad >> np.uint32(8)) & np.uint32(255)
            third[x], fourth[x] = (quad >> np.uint32(16)) & np.uint32(255), quad >> np.uint32(24)
    for x in range(4):
        _transform_lines(core[order[0, x]], core[order[1, x]], core[order[2, x]], core[order[3, x]])
    for y in range(4):
        _transform_lines(core[order[y, 0]], core[order[y, 1]], core[order[y, 2]], core[order[y, 3]])
        for x in range(4):
            line = core[order[y, x]]
            least = greatest = line[0]
            for n in range(line.size):
                least, greatest = min(least, line[n]), max(greatest, line[n])
            extremes[order[y, x], 0], extremes[order[y, x], 1] = least, greatest


@kernel
def _transform_blocks(samples, scale, order, bands):
    """4x4 transform of float64; `scale` and `order` (band of each coefficient): (4, 4)."""
    columns = samples.shape[1] // 4
    half = np.empty((4, 4), samples.dtype)
    for block in range(bands.shape[1]):
        y0, x0 = 4 * (block // columns), 4 * (block % columns)
        for x in range(4):
            a, b = samples[y0, x0 + x], samples[y0 + 1, x0 + x]
            c, d = samples[y0 + 2, x0 + x], samples[y0 + 3, x0 + x]
            half[0, x], half[1, x], half[2, x], half[3, x] = _transform_four(a, b, c, d)
        for y in range(4):
            a, b, c, d = _transform_four(half[y, 0], half[y, 1], half[y, 2], half[y, 3])
            bands[order[y, 0], block], bands[order[y, 1], block] = a * scale[y, 0], b * scale[y, 1]
            bands[order[y, 2], block], bands[order[y, 3], block] = c * scale[y, 2], d * scale[y, 3]
