"""Numbers of bits in one byte, sixteen to the octave."""

from bisect import bisect_left
from functools import cache

LENGTH_CODE_BITS = 8
_LENGTHS_PER_OCTAVE = 16


def length_of_code(code: int) -> int:
    """Return the length that a code stands for; inverse of `length_code`."""
    if code == 0:
        return 0
    octave, step = divmod(code - 1, _LENGTHS_PER_OCTAVE)
    return (_LENGTHS_PER_OCTAVE + step) << octave


@cache
def lengths() -> tuple[int, ...]:
    """Return the lengths of all codes."""
    return tuple(map(length_of_code, range(1 << LENGTH_CODE_BITS)))


def length_code(num_bits: float) -> int:
    """Return the code of the least length that is not below one, at most the longest."""
    if num_bits <= 0:
        return 0
    return bisect_left(lengths(), num_bits, 1, (1 << LENGTH_CODE_BITS) - 1)
