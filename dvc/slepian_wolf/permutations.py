"""Pseudo-random words and permutations that are the same on every platform and library version."""

import numpy as np
from numpy.typing import NDArray


def random_keys(seed: int, count: int) -> NDArray[np.uint64]:
    """Return pseudo-random words that are the same on every platform and library version."""
    offset = np.uint64((seed * 0xD1B54A32D192ED03 + 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF)
    z = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + offset
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def random_permutation(seed: int, count: int) -> NDArray[np.int32]:
    """Return a pseudo-random permutation that is the same on every platform and library version."""
    return np.argsort(random_keys(seed, count)).astype(np.int32)  # keys differ, so that any sort will do
