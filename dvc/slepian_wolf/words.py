"""Bit planes in machine words: one word per bit position, one bit of it per plane."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels


def by_words(
    bits: NDArray[np.uint8],
    function: Callable[[NDArray[np.uint64]], NDArray[np.uint64]],
    num_results: int | None = None,
) -> NDArray[np.uint8]:
    """Apply to bit planes what works on 64 of them at once."""
    _check_planes(bits)
    num_results = bits.shape[1] if num_results is None else num_results
    results = np.empty((bits.shape[0], num_results), np.uint8)
    words = np.empty(bits.shape[1], np.uint64)
    positions = np.arange(num_results, dtype=np.int32)
    for first in range(0, bits.shape[0], 64):
        group = slice(first, min(first + 64, bits.shape[0]))
        _kernels.pack_words(bits[group], words)
        _kernels.gather_bits(function(words), positions, results[group])
    return results


def _check_planes(bits: NDArray[np.uint8]) -> None:
    if not isinstance(bits, np.ndarray) or bits.dtype != np.uint8:
        raise TypeError(f"`bits` must be an array of uint8, got {getattr(bits, 'dtype', type(bits))}")
    if bits.ndim != 2 or bits.shape[1] < 1:
        raise ValueError(f"`bits` must have shape (planes, bits >= 1), got {bits.shape}")
    if bits.size and bits.max() > 1:
        raise ValueError(f"`bits` must hold 0 and 1 only, got {bits.max()}")
