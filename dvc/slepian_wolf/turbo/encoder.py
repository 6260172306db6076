"""Turbo encoding of up to 64 bit planes together, one machine word per bit position."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.codes import TurboCode
from dvc.slepian_wolf.turbo.interleaver import interleaved, section_starts
from dvc.slepian_wolf.turbo.puncturing import release_order
from dvc.slepian_wolf.words import by_words


@lru_cache(maxsize=16)
def _release_layout(
    code: TurboCode, num_bits: int, seed: int
) -> tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.int64]]:
    """Return the bit read at each step, where its parity is released, and where sections start."""
    order = release_order(num_bits, code.period)
    num_steps = int(order.max()) + 1
    next_release = np.full(num_steps, num_steps)
    next_release[order] = order
    next_release = np.minimum.accumulate(next_release[::-1])[::-1]
    slot_at_step = np.empty(num_steps, np.int64)
    slot_at_step[order] = np.arange(num_bits)
    small = np.uint16 if num_bits <= 1 << 16 else np.int32  # tables that stay in the cache
    starts = np.minimum(section_starts(num_bits), num_steps)
    return (
        interleaved(num_bits, seed)[:num_steps].astype(small),
        slot_at_step[next_release].astype(small),
        starts,
    )


def encode_words(
    words: NDArray[np.uint64], code: TurboCode, seed: int, parity: NDArray[np.uint64] | None = None
) -> NDArray[np.uint64]:
    """Return the parity of up to 64 bit planes at once, in order of release."""
    bit_at_step, slot_at_step, starts = _release_layout(code, words.size, seed)
    parity = np.empty(words.size, np.uint64) if parity is None else parity
    _kernels.encode_words(words, bit_at_step, slot_at_step, starts, code.feedback, code.feedforward, parity)
    return parity


def encode_planes(bits: NDArray[np.uint8], code: TurboCode, seed: int) -> NDArray[np.uint8]:
    """Return the parity of bit planes in order of release."""
    return by_words(bits, lambda words: encode_words(words, code, seed))
