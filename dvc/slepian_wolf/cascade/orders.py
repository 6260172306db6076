"""Pseudo-random orders of a plane's bits, and the parities of all that comes first in them."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.cascade import _kernels
from dvc.slepian_wolf.permutations import random_permutation

NUM_ORDERS = 8
"""Orders of a plane's bits that encoder and decoder share."""


@lru_cache(maxsize=16)
def bit_orders(num_bits: int, seed: int) -> NDArray[np.uint32]:
    """Return the orders of the bits of a plane."""
    first_seed = (seed + 1) << 8  # apart from those of the turbo codes' interleavers
    permutations = [random_permutation(first_seed + number, num_bits) for number in range(NUM_ORDERS)]
    orders = np.stack(permutations).astype(np.uint32)  # unsigned, which spares a test of every index
    orders.flags.writeable = False
    return orders


def prefix_parities(
    words: NDArray[np.uint64], order: int, seed: int, released: NDArray[np.uint64] | None = None
) -> NDArray[np.uint64]:
    """Add up the bits of up to 64 planes at once, modulo 2, one machine word per bit position."""
    if released is None:
        released = np.empty(words.size, np.uint64)
    _kernels.prefix_parities(words, bit_orders(words.size, seed)[order], released)
    return released
