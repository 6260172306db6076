"""Edges as chains from vertex to vertex, and chains as bytes: by code words of the thesis, or adaptively.

By code words, a chain is its first vertex, direction and length, and a word for each differential direction:
10, 0, 11 for -1, 0, 1. Adaptively, starts are distances from one to the next, and each step is coded in
contexts of the last steps and straight runs: end, straight on, side of the turn; not onto coded edges. If
edges bound a mask, a code of the regions inside follows.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy import RangeCoder, code_exp_golomb, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS
from dvc.entropy.mixing import code_mixed, new_mixture
from dvc.entropy.range_coder import code_decision
from dvc.errors import BitstreamError, ConfigError
from dvc.images.edge_maps import (
    EdgeMaps,
    Mask,
    code_mask,
    degree,
    has_element,
    is_inside,
    next_vertex,
    set_element,
)

_WEIGHT = 0.4
_LENGTH_BITS = 24
_CHAINS_PER_BYTE, _FREE_CHAINS = 4, 64  # a chain has two bits at least, and zeros at the end are not written
_SIGN, _ZERO, _EXPONENTS = 0, 1, 2
_NUM_COUNTS = 2 + 2 * NUM_EXPONENTS

NUM_HISTORIES = 3**6
MAX_RUN = 11
NUM_RUNS = (MAX_RUN + 1) * (MAX_RUN + 1) * 3

# Contexts of three decisions: a chain ends, continues straight, turns left; three tables each.
_DECISIONS: Any = np.arange(3)  # no literals, for each of which numba compiles
END, STRAIGHT, TURN = _DECISIONS
_SIZES = NUM_HISTORIES + NUM_RUNS + 81
_VALUES: Any = np.arange(2, dtype=np.uint8)
_OFF, _ON = _VALUES
NUM_CONTEXTS = 3 * _SIZES
NUM_MIXTURES = 6


@dataclass(frozen=True, eq=False)
class Chains:
    """Edges as chains."""

    shape: tuple[int, int]  # rows and columns of the plane
    starts: NDArray[np.int64]  # first vertices of chains, row by row, not decreasing
    lengths: NDArray[np.int64]  # edge elements of each, at least 1
    directions: NDArray[np.int8]  # directions of all elements, chain by chain

    def parts(self) -> list[NDArray[np.int8]]:
        """Return the directions of each chain."""
        return np.split(self.directions, np.cumsum(self.lengths)[:-1]) if len(self.lengths) else []

    def take(self, indices: NDArray[np.int64]) -> Self:
        """Return some chains in a given order."""
        parts = self.parts()
        directions = np.concatenate([self.directions[:0], *(parts[k] for k in indices)])
        return replace(
            self, starts=self.starts[indices], lengths=self.lengths[indices], directions=directions
        )


def trace(edges: EdgeMaps) -> Chains:
    """Return edges as chains, as few as possible; the inverse of `draw`."""
    number = edges.count()
    starts, lengths = np.zeros(number, np.int64), np.zeros(number, np.int64)
    directions = np.zeros(number, np.int8)
    below, right = edges.between_rows.copy(), edges.between_columns.copy()
    found = trace_edges(below, right, starts, lengths, directions)
    chains = Chains(edges.shape, starts[:found], lengths[:found], directions)
    return chains.take(np.argsort(chains.starts, kind="stable"))


def draw(chains: Chains) -> EdgeMaps:
    """Return the edges of chains; the inverse of `trace`."""
    edges = EdgeMaps.none(chains.shape)
    columns = chains.shape[1] + 1
    for start, directions in zip(chains.starts, chains.parts(), strict=True):
        row, column = divmod(int(start), columns)
        if not draw_chain(edges.between_rows, edges.between_columns, row, column, directions):
            raise ValueError("a chain leaves the plane")
    return edges


class EdgeCode(IntEnum):
    """Codes of chains."""

    FIXED = 0
    ADAPTIVE = 1


def encode(chains: Chains, code: EdgeCode, mask: Mask | None = None) -> bytes:
    """Code chains; the inverse of `decode`, or with a mask of `decode_masked`."""
    if not fits(chains, code):
        raise ConfigError(f"code words take at most 2^{_LENGTH_BITS} - 1 chains, and as many edges to each")
    coder = RangeCoder.writer()
    edges = _CODES[code](coder, chains, len(chains.starts))
    if mask is not None:
        code_mask(coder, edges, mask)
    return coder.to_bytes(shortest=True)


def fits(chains: Chains, code: EdgeCode) -> bool:
    """Return whether chains can be coded: the numbers of code words have 24 bits."""
    largest = max(len(chains.lengths), int(chains.lengths.max(initial=0)))
    return code is EdgeCode.ADAPTIVE or largest < 2**_LENGTH_BITS


def decode(data: bytes, shape: tuple[int, int], code: EdgeCode) -> EdgeMaps:
    """Read the edges of chains."""
    edges = _read(RangeCoder.reader(data), shape, code, len(data))
    if not edges.count():
        raise BitstreamError("the edges are damaged: none are coded")
    return edges


def decode_masked(data: bytes, shape: tuple[int, int], code: EdgeCode) -> tuple[EdgeMaps, Mask]:
    """Read the edges of chains, and the mask that they bound."""
    coder = RangeCoder.reader(data)
    edges = _read(coder, shape, code, len(data))
    return edges, code_mask(coder, edges)


def _read(coder: RangeCoder, shape: tuple[int, int], code: EdgeCode, num_bytes: int) -> EdgeMaps:
    nothing = np.zeros(0, np.int64)
    most = _CHAINS_PER_BYTE * num_bytes + _FREE_CHAINS
    edges = _CODES[code](coder, Chains(shape, nothing, nothing, np.zeros(0, np.int8)), most)
    coder.check()
    return edges


def _code_fixed(coder: RangeCoder, chains: Chains, most: int) -> EdgeMaps:
    """Write or read chains by code words."""
    edges = EdgeMaps.none(chains.shape)
    height, width = chains.shape
    row_bits, column_bits = height.bit_length(), width.bit_length()
    number = coder.uniform(2**_LENGTH_BITS, len(chains.starts))
    length_bits = coder.uniform(32, int(chains.lengths.max(initial=1)).bit_length())
    if length_bits > _LENGTH_BITS or number > most:
        raise BitstreamError("the edges are damaged")
    parts = chains.parts() if len(chains.starts) else []
    for k in range(number):
        start = divmod(int(chains.starts[k]), width + 1) if parts else (0, 0)
        given = parts[k] if parts else np.zeros(1, np.int8)
        row, column = coder.uniform(2**row_bits, start[0]), coder.uniform(2**column_bits, start[1])
        first = coder.uniform(4, int(given[0]))
        length = coder.uniform(2**length_bits, len(given))
        if row > height or column > width or not 0 < length <= 2 * height * width:
            raise BitstreamError("the edges are damaged")
        directions = np.full(length, first, np.int8)
        directions[: len(given)] = given
        directions[0] = first
        code_words(coder.room_for(2 * length), directions)
        coder.check()
        if not draw_chain(edges.between_rows, edges.between_columns, row, column, directions):
            raise BitstreamError("an edge leaves the picture")
    return edges


def _code_adaptive(coder: RangeCoder, chains: Chains, most: int) -> EdgeMaps:
    """Write or read chains in contexts."""
    edges = EdgeMaps.none(chains.shape)
    height, width = chains.shape
    counts = context_counts(np.full(_NUM_COUNTS, 50))
    number = _code_number(coder, counts, len(chains.starts))
    if number > most:
        raise BitstreamError("the edges are damaged")
    counts = context_counts(np.full(_NUM_COUNTS, 50))
    mixture = new_mixture(NUM_CONTEXTS, NUM_MIXTURES, _WEIGHT)
    room = np.zeros(2 * height * width, np.int8)
    room[: len(chains.directions)] = chains.directions
    before, offset = 0, 0
    for k in range(number):
        given = k < len(chains.starts)
        start = before + _code_number(coder, counts, int(chains.starts[k]) - before if given else 0)
        row, column = divmod(start, width + 1)
        if row > height or offset >= len(room):
            raise BitstreamError("the edges are damaged")
        before = start
        room[offset] = coder.uniform(4, int(room[offset]))
        length = int(chains.lengths[k]) if given else 0
        state = coder.room_for(3 * length + 3 if given else 0)
        maps = edges.between_rows, edges.between_columns
        length = code_chain(state, mixture, *maps, row, column, room[offset:], length)
        coder.check()
        if length < 0:
            raise BitstreamError("an edge leaves the picture")
        offset += length
    return edges


def _code_number(coder: RangeCoder, counts: NDArray[np.int64], value: int) -> int:
    state = coder.room_for(MAX_DECISIONS)
    number = code_exp_golomb(state, counts, _ZERO, _SIGN, _EXPONENTS, _EXPONENTS + NUM_EXPONENTS, value)
    coder.check()
    if number < 0:
        raise BitstreamError("the edges are damaged")
    return int(number)


_CODES = {EdgeCode.FIXED: _code_fixed, EdgeCode.ADAPTIVE: _code_adaptive}


@kernel
def follow(below, right, row, column, directions, count):
    """Follow a chain from a vertex to its end, straight if possible, and erase it; return the count."""
    last = np.int64(-1)
    turn = 0
    while True:
        chosen = np.int64(-1)
        if last < 0:
            for direction in range(4):
                if chosen < 0 and has_element(below, right, row, column, direction):
                    chosen = direction
        elif has_element(below, right, row, column, last):
            chosen = last
        else:
            first = (last - turn) % 4 if turn != 0 else (last + 1) % 4
            if has_element(below, right, row, column, first):
                chosen = first
            elif has_element(below, right, row, column, (first + 2) % 4):
                chosen = (first + 2) % 4
        if chosen < 0:
            return count
        set_element(below, right, row, column, chosen, _OFF)
        directions[count] = chosen
        count += 1
        if last >= 0 and chosen != last:
            turn = (chosen - last + 1) % 4 - 1
        last = chosen
        row, column = next_vertex(row, column, chosen)


@kernel
def trace_edges(below, right, starts, lengths, directions):
    """Decompose edges, which are erased, into as few chains as possible; return their number."""
    height, width = below.shape
    chains = 0
    count = np.int64(0)
    for closed in range(2):
        for row in range(height + 1):
            for column in range(width + 1):
                while True:
                    number = degree(below, right, row, column)
                    if number == 0 or (closed == 0 and number % 2 == 0):
                        break
                    after = follow(below, right, row, column, directions, count)
                    starts[chains] = row * (width + 1) + column
                    lengths[chains] = after - count
                    count = after
                    chains += 1
    return chains


@kernel
def draw_chain(below, right, row, column, directions):
    """Set the edges of a chain; return whether it stays inside."""
    for k in range(len(directions)):
        direction = np.int64(directions[k])
        if not is_inside(below, row, column, direction):
            return False
        set_element(below, right, row, column, direction, _ON)
        row, column = next_vertex(row, column, direction)
    return True


@kernel
def _is_open(below, right, row, column, direction):
    """Return whether a new edge can lead from a vertex in a direction."""
    return is_inside(below, row, column, direction) and not has_element(below, right, row, column, direction)


@kernel
def _code_step(coder, mixture, kind, seen, runs, run, decision):
    """Code a decision in contexts of a few last steps, of more of them, and of the last runs."""
    base = kind * _SIZES
    second, third = base + 81 + seen, base + 81 + NUM_HISTORIES + runs
    return code_mixed(coder, mixture, base + seen % 81, second, third, 2 * kind + min(run, 1), decision)


@kernel
def code_chain(coder, mixture, below, right, row, column, directions, length):
    """Code the directions of a chain after the first one, and draw all; return its length."""
    last = np.int64(directions[0])
    if not _is_open(below, right, row, column, last):
        return -1
    history = NUM_HISTORIES // 2
    zero = np.int64(0)
    run, run_before, same, turn = zero, zero, zero, zero
    count = 1
    while True:
        set_element(below, right, row, column, last, _ON)
        row, column = next_vertex(row, column, last)
        straight = _is_open(below, right, row, column, last)
        left = _is_open(below, right, row, column, (last + 1) % 4)
        after = _is_open(below, right, row, column, (last + 3) % 4)
        if not (straight or left or after) or count >= len(directions):
            return count
        touched = zero  # whether the vertex has other edges; a chain is likely to end there
        for direction in range(4):
            if (direction + 2) % 4 != last and has_element(below, right, row, column, direction):
                touched = touched | 1
        seen = history if turn >= 0 else NUM_HISTORIES - 1 - history  # as if the last turn were to the left
        runs = (run * (MAX_RUN + 1) + run_before) * 3 + same + 1
        base = END * _SIZES
        second, third = base + 2 + touched * 3 + seen % 3, base + 8 + touched * 12 + run
        if code_mixed(coder, mixture, base + touched, second, third, touched, int(count == length)):
            return count
        target = (np.int64(directions[count]) - last + 1) % 4 - 1 if count < length else 0
        # among the possible steps: 0 straight, 1 to the left, -1 to the right
        is_straight = straight and not (left or after)
        if straight and not is_straight:
            is_straight = bool(_code_step(coder, mixture, STRAIGHT, seen, runs, run, int(target == 0)))
        step = np.int64(0)
        if not is_straight:
            step = 1 if left else -1
            if left and after:
                again = _code_step(coder, mixture, TURN, seen, runs, run, int((target > 0) == (turn >= 0)))
                step = 1 if (again > 0) == (turn >= 0) else -1
        history = (history * 3 + step + 1) % NUM_HISTORIES
        if step == 0:
            run = min(run + 1, MAX_RUN)
        else:
            same = 0 if turn == 0 else (1 if turn == step else -1)
            turn, run_before, run = step, run, 0
        last = (last + step) % 4
        directions[count] = last
        count += 1


@kernel
def code_words(coder, directions):
    """Write or read the differential directions of a chain (4.6), (4.7) by the words 10, 0, 11."""
    for k in range(1, len(directions)):
        last = np.int64(directions[k - 1])
        step = (np.int64(directions[k]) - last + 1) % 4 - 1
        if code_decision(coder, 0.5, int(step != 0)):
            step = 1 if code_decision(coder, 0.5, int(step > 0)) else -1
        else:
            step = 0
        directions[k] = (last + step) % 4
