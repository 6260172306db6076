"""Recursive systematic convolutional (RSC) codes of rate 1/2 as transition tables."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

MAX_MEMORY = 4
"""Longest shift register that the kernels accept (16 states)."""


@dataclass(frozen=True)
class Trellis:
    """Transitions of one RSC code; `state` holds the register with its newest bit in bit 0."""

    next_state: NDArray[np.int64]  # state after input bit 0 or 1
    output: NDArray[np.int64]  # parity bit that the transition emits
    # bit s is the input, and the parity, of the transition that leaves state s by shifting a 0 in; the other
    # one has both inverted
    input_mask: int
    parity_mask: int

    @property
    def num_states(self) -> int:
        """Number of states S, a power of two."""
        return len(self.next_state)


def memory(feedback: int, feedforward: int) -> int:
    """Return the register length of an RSC code and refuse polynomials that make none."""
    if not (feedback & 1 and feedforward & 1):
        raise ValueError(f"polynomials must have constant term 1, got {feedback:#b} and {feedforward:#b}")
    length = max(feedback.bit_length(), feedforward.bit_length()) - 1
    if feedback < 2 or not 1 <= length <= MAX_MEMORY:
        raise ValueError(
            f"register length must be 1..{MAX_MEMORY} with feedback, got {feedback:#b}, {feedforward:#b}"
        )
    if feedback.bit_length() <= length and feedforward.bit_length() <= length:
        raise ValueError("neither polynomial uses the oldest register bit")
    return length


def step(state: int, bit: int, feedback: int, feedforward: int) -> tuple[int, int]:
    """Push one bit through the encoder register."""
    length = memory(feedback, feedforward)
    fed = bit ^ ((state & (feedback >> 1)).bit_count() & 1)
    parity = fed ^ ((state & (feedforward >> 1)).bit_count() & 1)
    return ((state << 1) | fed) & ((1 << length) - 1), parity


@lru_cache(maxsize=64)
def trellis(feedback: int, feedforward: int) -> Trellis:
    """Tabulate the transitions of an RSC code."""
    num_states = 1 << memory(feedback, feedforward)
    next_state = np.zeros((num_states, 2), np.int64)
    output = np.zeros((num_states, 2), np.int64)
    input_mask = parity_mask = 0
    for state in range(num_states):
        for bit in range(2):
            next_state[state, bit], output[state, bit] = step(state, bit, feedback, feedforward)
            if next_state[state, bit] & 1 == 0:
                input_mask |= bit << state
                parity_mask |= int(output[state, bit]) << state
    next_state.flags.writeable = output.flags.writeable = False
    return Trellis(next_state, output, input_mask, parity_mask)
