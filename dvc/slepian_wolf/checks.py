"""Cyclic redundancy checks over bit planes, all planes of a frame together."""

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels

POLYNOMIALS = {8: 0x07, 12: 0x80F, 16: 0x1021, 24: 0x864CFB, 32: 0x04C11DB7}
"""Generator without its leading term, by number of check bits; registers start at zero."""
CRC_BITS = 16
"""Check bits of every plane that encoders compute."""


def crc_words(words: NDArray[np.uint64], num_bits: int) -> NDArray[np.uint64]:
    """Compute the check bits of up to 64 planes at once, one machine word per bit position."""
    if num_bits not in POLYNOMIALS:
        raise ValueError(f"`num_bits` must be one of {sorted(POLYNOMIALS)}, got {num_bits}")
    register = np.empty(num_bits, np.uint64)
    _kernels.crc_words(words, POLYNOMIALS[num_bits], num_bits, register)
    return register


def crc(bits: NDArray[np.uint8], num_bits: int) -> NDArray[np.uint8]:
    """Compute the check bits of every plane."""
    if not isinstance(bits, np.ndarray) or bits.dtype != np.uint8:
        raise TypeError(f"`bits` must be an array of uint8, got {getattr(bits, 'dtype', type(bits))}")
    if bits.ndim < 1 or bits.shape[-1] < 1:
        raise ValueError(f"`bits` must have shape (..., bits >= 1), got {bits.shape}")
    if bits.size and bits.max() > 1:
        raise ValueError(f"`bits` must hold 0 and 1 only, got {bits.max()}")
    planes = bits.reshape(-1, bits.shape[-1])
    checks = np.empty((len(planes), num_bits), np.uint8)
    words, positions = np.empty(planes.shape[1], np.uint64), np.arange(num_bits, dtype=np.int32)
    for first in range(0, len(planes), 64):
        _kernels.pack_words(planes[first : first + 64], words)
        _kernels.gather_bits(crc_words(words, num_bits), positions, checks[first : first + 64])
    return checks.reshape(*bits.shape[:-1], num_bits)


def joint_check(checks: NDArray[np.uint8] | NDArray[np.uint64]) -> NDArray[np.uint8]:
    """Return check bits of several planes together."""
    words = checks.astype(np.uint64, copy=False).ravel()
    return crc_words(words, checks.shape[1]).astype(np.uint8)


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
