"""The 4x4 integer transform of H.264, scaled to be orthonormal, over whole frames.

A frame becomes 16 *bands* in zigzag order; band ``b`` holds one coefficient of every 4x4 block, blocks in
raster order. The core is exact integer arithmetic, so that both sides get the same numbers on any processor.
The DC coefficient of 8-bit samples lies in [0, 1020].

References
----------
[Malvar2003] H. Malvar et al., "Low-complexity transform and quantization in H.264/AVC", 2003.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.config import ZIGZAG
from dvc.wynerziv import _kernels

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
    _kernels.transform_samples(quads, ORDER, core, extremes)
    return core, extremes


def forward(luma: Samples) -> NDArray[np.float64]:
    """Transform a frame into bands; inverse of `inverse`."""
    padded = pad_to_blocks(luma)
    shape = band_shape(*padded.shape)
    bands = np.empty((NUM_BANDS, shape[0] * shape[1]))
    _kernels.transform_blocks(np.ascontiguousarray(padded, np.float64), SCALE, ORDER, bands)
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
