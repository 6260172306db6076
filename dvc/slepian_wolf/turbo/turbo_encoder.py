"""Tables of turbo encoding: trellises of codes, orders of their steps, and the release of parity."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.checks import random_permutation

FEEDBACK, FEEDFORWARD, PERIOD = 0b11001, 0b11011, 48
"""(1 + D + D^3 + D^4) / (1 + D^3 + D^4), twice, and the puncturing period of [Artigas2007]."""
NUM_SECTIONS = 2
"""Number of times that each bit enters; the register is reset before each pass."""


@dataclass(frozen=True)
class Trellis:
    """Transitions of one RSC code; `state` holds the register with its newest bit in bit 0."""

    next_state: NDArray[np.int64]  # state after input bit 0 or 1
    output: NDArray[np.int64]  # parity bit that the transition emits
    # bit s is the input, and the parity, of the transition that leaves state s by shifting a 0 in; the other
    # one has both inverted
    input_mask: int
    parity_mask: int


@lru_cache(maxsize=64)
def trellis(feedback: int, feedforward: int) -> Trellis:
    """Tabulate the transitions of an RSC code; bit i of a polynomial is the coefficient of D^i."""
    num_states = 1 << max(feedback.bit_length(), feedforward.bit_length()) - 1
    next_state = np.zeros((num_states, 2), np.int64)
    output = np.zeros((num_states, 2), np.int64)
    input_mask = parity_mask = 0
    for state in range(num_states):
        for bit in range(2):
            fed = bit ^ ((state & (feedback >> 1)).bit_count() & 1)
            output[state, bit] = fed ^ ((state & (feedforward >> 1)).bit_count() & 1)
            next_state[state, bit] = ((state << 1) | fed) & (num_states - 1)
            if fed == 0:
                input_mask |= bit << state
                parity_mask |= int(output[state, bit]) << state
    next_state.flags.writeable = output.flags.writeable = False
    return Trellis(next_state, output, input_mask, parity_mask)


@lru_cache(maxsize=16)
def interleaved(num_bits: int, seed: int) -> NDArray[np.int32]:
    """Return the bit that enters at each of 2 N steps."""
    bits = np.concatenate([np.arange(num_bits, dtype=np.int32), random_permutation(2 * seed + 2, num_bits)])
    bits.flags.writeable = False
    return bits


def section_starts(num_bits: int) -> NDArray[np.int64]:
    """Return the steps that begin with a reset of the register."""
    return np.arange(NUM_SECTIONS, dtype=np.int64) * num_bits


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
    """Return the N trellis steps that release parity, in order of release."""
    steps = [
        section * num_bits + np.arange(offset, num_bits, period, dtype=np.int32)
        for offset in spread_order(period)
        for section in range(NUM_SECTIONS)
    ]
    order = np.concatenate(steps)[:num_bits].astype(np.int32)
    order.flags.writeable = False
    return order


@lru_cache(maxsize=16)
def release_layout(
    num_bits: int, seed: int
) -> tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.int64]]:
    """Return the bit read at each step, where its parity is released, and where sections start."""
    order = release_order(num_bits, PERIOD)
    num_steps = int(order.max()) + 1
    next_release = np.full(num_steps, num_steps)
    next_release[order] = order
    next_release = np.minimum.accumulate(next_release[::-1])[::-1]
    slot_at_step = np.empty(num_steps, np.int64)
    slot_at_step[order] = np.arange(num_bits)
    small = np.uint16 if num_bits <= 1 << 16 else np.int32  # tables that stay in the cache
    starts = np.minimum(section_starts(num_bits), num_steps)
    return (
        interleaved(num_bits, seed)[:num_steps].astype(small),
        slot_at_step[next_release].astype(small),
        starts,
    )
