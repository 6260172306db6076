"""Turbo encoding of all bit planes of a frame together, one machine word per bit position."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.turbo import _kernels
from dvc.turbo.codes import TurboCode
from dvc.turbo.interleaver import copy_layout
from dvc.turbo.puncturing import release_order


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


@lru_cache(maxsize=64)
def _release_layout(
    code: TurboCode, num_bits: int, seed: int
) -> tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.int64]]:
    """Return the bit read at each step, where its parity is released, and where sections start."""
    layout, order = copy_layout(code, num_bits, seed), release_order(code, num_bits)
    num_steps = int(order.max()) + 1
    next_release = np.full(num_steps, num_steps)
    next_release[order] = order
    next_release = np.minimum.accumulate(next_release[::-1])[::-1]
    slot_at_step = np.empty(num_steps, np.int64)
    slot_at_step[order] = np.arange(num_bits)
    small = np.uint16 if num_bits <= 1 << 16 else np.int32  # tables that stay in the cache
    starts = np.minimum(np.array(layout.section_starts, np.int64), num_steps)
    return layout.bit_at_step[:num_steps].astype(small), slot_at_step[next_release].astype(small), starts


def encode_words(
    words: NDArray[np.uint64],
    code: TurboCode,
    interleaver_seed: int,
    released: NDArray[np.uint64] | None = None,
) -> NDArray[np.uint64]:
    """Return the parity of up to 64 bit planes at once, one machine word per bit position."""
    bit_at_step, slot_at_step, starts = _release_layout(code, words.size, interleaver_seed)
    parity = np.empty(words.size, np.uint64) if released is None else released
    _kernels.encode_words(words, bit_at_step, slot_at_step, starts, code.feedback, code.feedforward, parity)
    return parity


def encode_planes(bits: NDArray[np.uint8], code: TurboCode, interleaver_seed: int) -> NDArray[np.uint8]:
    """Return the parity of bit planes in order of release."""
    return by_words(bits, lambda words: encode_words(words, code, interleaver_seed))
