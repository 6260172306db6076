"""The order in which parity bits are released; a prefix of it is a good punctured code at every rate."""

import itertools
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.turbo.codes import TurboCode
from dvc.slepian_wolf.turbo.interleaver import copy_layout


def spread_order(count: int) -> NDArray[np.int64]:
    """Order the integers below `count` so that every prefix is spread out (bit-reversed counting)."""
    width = max(1, (count - 1).bit_length())
    numbers = np.arange(1 << width, dtype=np.int64)
    reverse = np.zeros_like(numbers)
    for bit in range(width):
        reverse |= ((numbers >> bit) & 1) << (width - 1 - bit)
    return reverse[reverse < count]


def _joined_order(num_steps: int, num_bits: int, grid_rate: float) -> NDArray[np.int64]:
    """Release `grid_rate * num_bits` evenly spaced steps first, then the middles of the gaps, and so on."""
    grid = max(1, round(grid_rate * num_bits))
    coarse = spread_order(grid)
    levels = [coarse]
    parts = 1
    while parts * grid < 2 * num_bits:
        levels += [coarse + (2 * k + 1) / (2 * parts) for k in spread_order(parts)]
        parts *= 2
    steps = num_steps - 1 - np.floor(np.concatenate(levels) * (num_steps / grid)).astype(np.int64)
    _, first = np.unique(steps, return_index=True)
    order: NDArray[np.int64] = steps[np.sort(first)]
    return np.concatenate([order, np.setdiff1d(np.arange(num_steps), order)])


def _parallel_order(num_bits: int, num_sections: int, period: int) -> NDArray[np.int64]:
    """Release per request the next position of every period, of all parity streams."""
    parts = []
    for offset in spread_order(period):
        for section in range(num_sections):
            parts.append(section * num_bits + np.arange(offset, num_bits, period))
    return np.concatenate(parts)


@lru_cache(maxsize=64)
def release_order(code: TurboCode, num_bits: int) -> NDArray[np.int32]:
    """Return the trellis steps whose parity is released, in order of release."""
    layout = copy_layout(code, num_bits, 0)
    starts = [*layout.segment_starts, layout.num_steps]
    segments = len(layout.segment_starts)
    order = np.empty(num_bits, np.int32)
    for segment, (start, end) in enumerate(itertools.pairwise(starts)):
        size = len(range(segment, num_bits, segments))
        if code.layout == "parallel":
            steps = _parallel_order(size, (end - start) // size, code.period)
        else:
            steps = _joined_order(end - start, size, code.grid_rate)
        order[segment::segments] = start + steps[:size]
    order.flags.writeable = False
    return order


def puncture(
    parity: NDArray[np.uint8], order: NDArray[np.int32], start: int, count: int
) -> NDArray[np.uint8]:
    """Select parity bits `start` to ``start + count`` in release order; inverse of `depuncture`."""
    if start < 0 or count < 0 or start + count > order.size:
        raise ValueError(f"range {start}+{count} is outside the {order.size} bits that can be released")
    return parity[order[start : start + count]]


def depuncture(received: NDArray[np.uint8], order: NDArray[np.int32], num_steps: int) -> NDArray[np.int8]:
    """Put received parity bits back at their trellis steps; inverse of `puncture` from the first bit on."""
    if received.size > order.size:
        raise ValueError(f"`received` has {received.size} bits, but only {order.size} can be released")
    parity = np.full(num_steps, -1, np.int8)
    parity[order[: received.size]] = received
    return parity
