"""Pseudo-random orders of the bits of a run, and the parities of all that comes first in them."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.cascade import _kernels
from dvc.slepian_wolf.checks import random_permutation

NUM_ORDERS = 8
"""Orders of the bits that encoder and decoder share."""


@lru_cache(maxsize=8 * NUM_ORDERS)
def _order_of_power(number: int, exponent: int, seed: int) -> NDArray[np.uint32]:
    """Return an order of a number of bits that is a power of two."""
    first_seed = (seed + 1) << 8  # apart from those of the turbo codes' interleavers
    order = random_permutation(first_seed + number, 1 << exponent).astype(np.uint32)
    order.flags.writeable = False
    return order


def bit_order(number: int, num_bits: int, seed: int) -> NDArray[np.uint32]:
    """Return an order of bits: that of the next power of two, without the bits that are too many."""
    order = _order_of_power(number, (num_bits - 1).bit_length(), seed)
    return order if order.size == num_bits else order[order < num_bits]


def prefix_parities(
    words: NDArray[np.uint64], order: int, seed: int, released: NDArray[np.uint64] | None = None
) -> NDArray[np.uint64]:
    """Add up the bits of up to 64 planes at once, modulo 2, one machine word per bit position."""
    if released is None:
        released = np.empty(words.size, np.uint64)
    exponent = (words.size - 1).bit_length()
    _kernels.prefix_parities(words, _order_of_power(order, exponent, seed), released)
    return released
