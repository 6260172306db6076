"""Which bit of a plane enters the trellis at each step: all in order, then all interleaved."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.permutations import random_permutation

NUM_SECTIONS = 2
"""Times that each bit enters; the register starts anew before each."""


@lru_cache(maxsize=16)
def interleaved(num_bits: int, seed: int) -> NDArray[np.int32]:
    """Return the bit that enters at each of 2 N steps."""
    if num_bits < 1 or seed < 0:
        raise ValueError(f"`num_bits` must be >= 1 and `seed` >= 0, got {num_bits} and {seed}")
    bits = np.concatenate([np.arange(num_bits, dtype=np.int32), random_permutation(2 * seed + 2, num_bits)])
    bits.flags.writeable = False
    return bits


def section_starts(num_bits: int) -> NDArray[np.int64]:
    """Return the steps at which the register starts anew."""
    return np.arange(NUM_SECTIONS, dtype=np.int64) * num_bits
