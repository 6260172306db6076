"""The order in which parity bits are released: positions of the puncturing period, each of both streams."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.turbo.interleaver import NUM_SECTIONS


def spread_order(count: int) -> NDArray[np.int64]:
    """Order the integers below `count` so that every prefix is spread out (bit-reversed counting)."""
    width = max(1, (count - 1).bit_length())
    numbers = np.arange(1 << width, dtype=np.int64)
    reverse = np.zeros_like(numbers)
    for bit in range(width):
        reverse |= ((numbers >> bit) & 1) << (width - 1 - bit)
    return reverse[reverse < count]


@lru_cache(maxsize=16)
def release_order(num_bits: int, period: int) -> NDArray[np.int32]:
    """Return the N trellis steps whose parity is released, in order of release."""
    steps = [
        section * num_bits + np.arange(offset, num_bits, period, dtype=np.int32)
        for offset in spread_order(period)
        for section in range(NUM_SECTIONS)
    ]
    order = np.concatenate(steps)[:num_bits].astype(np.int32)
    order.flags.writeable = False
    return order
