"""Where the copies of every bit enter the trellis."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.permutations import random_keys, random_permutation
from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.codes import TurboCode

MAX_SEGMENT_BITS = 16384
"""Longer planes are divided, so that their parity equations can still be solved."""
MAX_SPREAD_COPIES = 3
"""Bits with more copies than this may be neighbours more than once."""
NUM_TRIES = 8
"""Swaps tried for a copy that is crowded."""


@dataclass(frozen=True)
class CopyLayout:
    """The input sequence of the recursive code."""

    bit_at_step: NDArray[np.int32]  # index of the plane's bit that enters at each trellis step
    section_starts: tuple[int, ...]  # steps at which the register is reset to zero; the first is 0
    segment_starts: tuple[int, ...]  # steps at which independent codewords start; see `num_segments`

    @property
    def num_steps(self) -> int:
        """Length T of all trellis sections together."""
        return self.bit_at_step.size


def copy_counts(code: TurboCode, num_bits: int, seed: int) -> NDArray[np.int32]:
    """Say how often each bit of a plane enters the trellis."""
    counts = np.zeros(num_bits, np.int32)
    done, filled = 0.0, 0
    for fraction, times in code.copies:
        done += fraction
        end = min(num_bits, round(done * num_bits))
        counts[filled:end] = times
        filled = end
    counts[filled:] = code.copies[-1][1]
    return counts[random_permutation(2 * seed + 1, num_bits)]


def _spread(bits: NDArray[np.int32], num_bits: int, spread: int, seed: int) -> NDArray[np.int32]:
    """Keep copies of a bit apart, and bits with few copies from being neighbours twice."""
    spread = min(spread, math.isqrt(bits.size) // 3)
    if spread < 1:
        return bits
    bits = bits.copy()
    first_copy = np.concatenate([[0], np.cumsum(np.bincount(bits, minlength=num_bits))])
    steps_of_bit = np.argsort(bits, kind="stable")
    partners = (random_keys(2 * seed + 2, NUM_TRIES * bits.size) % np.uint64(bits.size)).astype(np.int64)
    _kernels.spread_copies(bits, first_copy, steps_of_bit, spread, MAX_SPREAD_COPIES, partners)
    return bits


def num_segments(num_bits: int) -> int:
    """Say into how many independent codewords a plane is divided."""
    return max(1, -(-num_bits // MAX_SEGMENT_BITS))


def _segment_steps(code: TurboCode, num_bits: int, seed: int) -> tuple[NDArray[np.int32], list[int]]:
    """Lay out one segment: the bit at every step, and the steps at which sections start."""
    if code.layout == "parallel":
        times = code.copies[0][1]
        parts = [np.arange(num_bits, dtype=np.int32)]
        parts += [random_permutation(2 * (seed + k), num_bits) for k in range(1, times)]
        return np.concatenate(parts), [k * num_bits for k in range(times)]
    repeated = np.repeat(np.arange(num_bits, dtype=np.int32), copy_counts(code, num_bits, seed))
    return _spread(repeated[random_permutation(2 * seed, repeated.size)], num_bits, code.spread, seed), [0]


@lru_cache(maxsize=64)
def copy_layout(code: TurboCode, num_bits: int, seed: int) -> CopyLayout:
    """Lay out the copies of a plane's bits along the trellis."""
    if num_bits < 1 or seed < 0:
        raise ValueError(f"`num_bits` must be >= 1 and `seed` >= 0, got {num_bits} and {seed}")
    segments = num_segments(num_bits)
    parts: list[NDArray[np.int32]] = []
    starts: list[int] = []
    segment_starts: list[int] = []
    end = size = 0
    for segment in range(segments):
        bits = np.arange(segment, num_bits, segments, dtype=np.int32)
        if bits.size != size:  # the first segments may hold one bit more than the others
            steps, sections = _segment_steps(code, bits.size, seed)
            size = bits.size
        segment_starts.append(end)
        starts += [end + section for section in sections]
        parts.append(bits[steps])
        end += steps.size
    layout = np.concatenate(parts)
    layout.flags.writeable = False
    return CopyLayout(layout, tuple(starts), tuple(segment_starts))
