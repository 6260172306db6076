"""Cyclic redundancy check by long division, bit by bit."""

import numpy as np
from numpy.typing import NDArray


def crc_remainder(bits: NDArray[np.uint8], polynomial: int, width: int) -> NDArray[np.uint8]:
    """Return ``bits * x**width`` modulo ``x**width + polynomial``, highest power first."""
    dividend = [int(bit) for bit in bits] + [0] * width
    divisor = [1] + [polynomial >> (width - 1 - i) & 1 for i in range(width)]
    for i in range(bits.size):
        if dividend[i]:
            for j, coefficient in enumerate(divisor):
                dividend[i + j] ^= coefficient
    return np.array(dividend[-width:], np.uint8)
