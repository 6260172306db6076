"""Pseudo-random orders of a plane's bits, and the parities of all that comes first in them."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.turbo.cascade import _kernels
from dvc.turbo.codes import NUM_ORDERS
from dvc.turbo.interleaver import random_permutation


@lru_cache(maxsize=16)
def bit_orders(num_bits: int, seed: int) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the orders of the bits of a plane.

    Parameters
    ----------
    num_bits : int
        Length N of the plane.
    seed : int
        Seed that encoder and decoder share.

    Returns
    -------
    orders : ndarray of shape (NUM_ORDERS, N), uint32
        Bit at each position of each order; read-only.
    ranks : ndarray of shape (NUM_ORDERS, N), uint32
        Position of each bit in each order; read-only.
    """
    first_seed = (seed + 1) << 8  # apart from those of the turbo codes' interleavers
    permutations = [random_permutation(first_seed + number, num_bits) for number in range(NUM_ORDERS)]
    orders = np.stack(permutations).astype(np.uint32)  # unsigned, which spares a test of every index
    ranks = np.argsort(orders, axis=1, kind="stable").astype(np.uint32)
    orders.flags.writeable = ranks.flags.writeable = False
    return orders, ranks


def prefix_parities(
    words: NDArray[np.uint64], order: int, seed: int, released: NDArray[np.uint64] | None = None
) -> NDArray[np.uint64]:
    """Add up the bits of up to 64 planes at once, modulo 2, one machine word per bit position.

    Parameters
    ----------
    words : ndarray of shape (N,), uint64
        Bit p of word n is bit n of plane p.
    order : int
        Number of the order in which they are added up.
    seed : int
        Seed that encoder and decoder share.
    released : ndarray of shape (N,), uint64, optional
        Where to write the parities.

    Returns
    -------
    ndarray of shape (N,), uint64
        Bit p of word j is the parity of plane p up to, and including, position j; `released` if it is given.
    """
    orders, _ = bit_orders(words.size, seed)
    if released is None:
        released = np.empty(words.size, np.uint64)
    _kernels.prefix_parities(words, orders[order], released)
    return released
