"""Cyclic redundancy checks over bit planes, all planes of a frame together."""

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels
from dvc.slepian_wolf.words import by_words

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
    planes = np.atleast_2d(bits)
    planes = planes.reshape(-1, planes.shape[-1])
    checks = by_words(planes, lambda words: crc_words(words, num_bits), num_bits)
    return checks.reshape(*np.shape(bits)[:-1], num_bits)


def joint_check(checks: NDArray[np.uint8] | NDArray[np.uint64]) -> NDArray[np.uint8]:
    """Return check bits of several planes together."""
    words = checks.astype(np.uint64, copy=False).ravel()
    return crc_words(words, checks.shape[1]).astype(np.uint8)
