"""Compiled loops over chains of edges: following them, coding their turns, weighing what they are worth."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.mixing import code_adaptive, code_mixed
from dvc.entropy.range_coder import code_decision
from dvc.images.column_lifting import lift_columns
from dvc.images.edge_maps import coarser
from dvc.images.edges.lattice import degree, has_element, is_inside, next_vertex, set_element

NUM_HISTORIES = 3**6
MAX_RUN = 11
NUM_RUNS = (MAX_RUN + 1) * (MAX_RUN + 1) * 3

# Contexts: whether a chain ends, goes straight on, and which way it turns; three tables each.
END, STRAIGHT, TURN = range(3)
_SIZES = NUM_HISTORIES + NUM_RUNS + 81
NUM_CONTEXTS = 3 * _SIZES
NUM_MIXTURES = 6

ROUNDED = 1.0 / 12.0
"""Squared error of a significant coefficient, in squared steps."""

# Numbers of a model: squared steps that a bit is worth; bits of a significant coefficient, more of them per
# octave above one step, and those of an edge and of a chain.
MULTIPLIER, SIGNIFICANCE, OCTAVE, ELEMENT, CHAIN = range(5)


class Pieces(NamedTuple):
    """Pieces of chains."""

    elements: NDArray[np.int64]  # vertex and direction of each edge of the pieces
    bounds: NDArray[np.int64]  # where each piece begins and ends
    order: NDArray[np.int64]  # in which they are weighed
    present: NDArray[np.uint8]  # 1 if a piece is in


class Surroundings(NamedTuple):
    """What pieces are weighed by."""

    plane: NDArray[np.float64]  # samples, in steps
    # weights, gain, and the scales of the low and the high band
    wavelet: tuple[NDArray[np.float64], float, float, float]
    order: int  # of the extrapolation
    model: NDArray[np.float64]  # of costs
    num_levels: int  # how many scales are looked at, and how far around a piece
    margin: int


@kernel
def follow(below, right, row, column, directions, count):
    """Follow a chain from a vertex to its end, straight on where it can, and erase it; return the count."""
    last = -1
    turn = 0
    while True:
        chosen = -1
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
        set_element(below, right, row, column, chosen, 0)
        directions[count] = chosen
        count += 1
        if last >= 0 and chosen != last:
            turn = (chosen - last + 1) % 4 - 1
        last = chosen
        row, column = next_vertex(row, column, chosen)


@kernel
def trace(below, right, starts, lengths, directions):
    """Decompose edges, which are erased, into as few chains as there are; return how many."""
    height, width = below.shape
    chains, count = 0, 0
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
def draw(below, right, row, column, directions):
    """Set the edges of a chain; return whether it stays inside."""
    for k in range(len(directions)):
        direction = np.int64(directions[k])
        if not is_inside(below, row, column, direction):
            return False
        set_element(below, right, row, column, direction, 1)
        row, column = next_vertex(row, column, direction)
    return True


@kernel
def _is_touched(below, right, row, column, last):
    """Return whether a vertex has edges other than the one that led there."""
    for direction in range(4):
        if (direction + 2) % 4 != last and has_element(below, right, row, column, direction):
            return 1
    return 0


@kernel
def _is_open(below, right, row, column, direction):
    """Return whether an edge that is not there yet can lead from a vertex in a direction."""
    return is_inside(below, row, column, direction) and not has_element(below, right, row, column, direction)


@kernel
def _code_end(coder, mixture, touched, seen, run, ended):
    """Code whether a chain ends, which is likely where it meets others."""
    base = END * _SIZES
    second, third = base + 2 + touched * 3 + seen % 3, base + 8 + touched * 12 + run
    return code_mixed(coder, mixture, base + touched, second, third, touched, ended)


@kernel
def _code_step(coder, mixture, kind, seen, runs, run, decision):
    """Code a decision on the way, in contexts of few last steps, of more of them, and of the last runs."""
    base = kind * _SIZES
    second, third = base + 81 + seen, base + 81 + NUM_HISTORIES + runs
    return code_mixed(coder, mixture, base + seen % 81, second, third, 2 * kind + min(run, 1), decision)


@kernel
def _code_turn(coder, mixture, ways, context, turn, target):
    """Code which of the ways that are open a chain takes: 0 straight on, 1 to the left, -1 to the right."""
    (straight, left, after), (seen, runs, run) = ways, context
    if straight:
        if not (left or after):
            return 0
        if _code_step(coder, mixture, STRAIGHT, seen, runs, run, int(target == 0)):
            return 0
    if not (left and after):
        return 1 if left else -1
    again = _code_step(coder, mixture, TURN, seen, runs, run, int((target > 0) == (turn >= 0)))
    return 1 if (again > 0) == (turn >= 0) else -1


@kernel
def code_chain(coder, mixture, below, right, row, column, directions, length):
    """Code the directions of a chain after the first one, and draw all; return its length."""
    last = np.int64(directions[0])
    if not _is_open(below, right, row, column, last):
        return -1
    history, run, run_before, same, turn = NUM_HISTORIES // 2, 0, 0, 0, 0
    count = 1
    while True:
        set_element(below, right, row, column, last, 1)
        row, column = next_vertex(row, column, last)
        straight = _is_open(below, right, row, column, last)
        left = _is_open(below, right, row, column, (last + 1) % 4)
        after = _is_open(below, right, row, column, (last + 3) % 4)
        if not (straight or left or after) or count >= len(directions):
            return count
        touched = _is_touched(below, right, row, column, last)
        seen = history if turn >= 0 else NUM_HISTORIES - 1 - history  # as if the last turn were to the left
        runs = (run * (MAX_RUN + 1) + run_before) * 3 + same + 1
        if _code_end(coder, mixture, touched, seen, run, int(count == length)):
            return count
        target = (np.int64(directions[count]) - last + 1) % 4 - 1 if count < length else 0
        step = _code_turn(coder, mixture, (straight, left, after), (seen, runs, run), turn, target)
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


@kernel
def code_regions(coder, counts, regions, first, inside):
    """Write or read which regions are inside, in turn; beside one outside they are, and nothing is coded."""
    width = regions.shape[1]
    for k in range(len(first)):
        row, column = first[k] // width, first[k] % width
        beside_outside = row > 0 and inside[regions[row - 1, column]] == 0
        beside_outside |= column > 0 and inside[regions[row, column - 1]] == 0
        if beside_outside:
            inside[k] = 1
        else:
            inside[k] = code_adaptive(coder, counts, min(k, 1), np.int64(inside[k]))


@kernel
def coefficient_cost(magnitude, model):
    """Return the cost of a coefficient, in steps and squared steps: its energy, or error and bits if less."""
    energy = magnitude * magnitude
    if magnitude < 0.5:
        return energy
    bits = model[SIGNIFICANCE] + model[OCTAVE] * np.log2(max(magnitude, 1.0))
    return min(energy, ROUNDED + model[MULTIPLIER] * bits)


@kernel
def transform_cost(plane, below, right, num_levels, wavelet, order, model):
    """Return the cost of the details of a plane in squared steps."""
    weights, gain, low_scale, high_scale = wavelet
    low, total = plane.copy(), 0.0
    for _ in range(num_levels):
        height, width = low.shape
        if height > 1:
            lift_columns(low, below, weights, gain, order, False)
        if width > 1:
            lift_columns(low.T, right.T, weights, gain, order, False)
        half = np.empty(((height + 1) // 2, (width + 1) // 2))
        for i in range(height):
            row_scale = 1.0 if height == 1 else (low_scale if i % 2 == 0 else high_scale)
            for t in range(width):
                scale = row_scale if width == 1 else row_scale * (low_scale if t % 2 == 0 else high_scale)
                if i % 2 == 0 and t % 2 == 0:
                    half[i // 2, t // 2] = low[i, t] * scale
                else:
                    total += coefficient_cost(abs(low[i, t]) * scale, model)
        below, right = coarser(below, right)
        low = half
    return total


@kernel
def _set_piece(below, right, elements, value):
    for k in range(len(elements)):
        set_element(below, right, elements[k, 0], elements[k, 1], elements[k, 2], value)


@kernel
def _window(elements, margin, alignment, height, width):
    """Return the part of a plane around a piece of a chain, aligned to the coarsest scale."""
    top, bottom = elements[:, 0].min() - margin, elements[:, 0].max() + margin
    left, right = elements[:, 1].min() - margin, elements[:, 1].max() + margin
    top, left = max(top // alignment * alignment, 0), max(left // alignment * alignment, 0)
    bottom = min((bottom + alignment - 1) // alignment * alignment, height)
    right = min((right + alignment - 1) // alignment * alignment, width)
    return top, bottom, left, right


@kernel
def _window_cost(surroundings, below, right, window):
    top, bottom, left, end = window
    part_below = below[top:bottom, left:end].copy()
    part_right = right[top:bottom, left:end].copy()
    part_below[bottom - top - 1], part_right[:, end - left - 1] = 0, 0
    plane, wavelet, order, model, num_levels, _ = surroundings
    return transform_cost(
        plane[top:bottom, left:end], part_below, part_right, num_levels, wavelet, order, model
    )


@kernel
def degrees(below, right, rows, columns):
    """Return how many edges meet at each of some vertices."""
    found = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        found[k] = degree(below, right, rows[k], columns[k])
    return found


@kernel
def _odd_ends(below, right, elements):
    """Return how many of the two ends of a piece are the ends of an odd number of edges."""
    last = elements[-1]
    row, column = next_vertex(last[0], last[1], last[2])
    first = elements[0]
    if row == first[0] and column == first[1]:
        return 0
    return degree(below, right, first[0], first[1]) % 2 + degree(below, right, row, column) % 2


@kernel
def weigh_pieces(surroundings, below, right, pieces):
    """Put in or take out each piece of chains where that costs less; return how many were changed."""
    elements, bounds, order_of_pieces, present = pieces
    model, alignment = surroundings.model, 1 << surroundings.num_levels
    height, width = below.shape
    changes = 0
    for k in order_of_pieces:
        piece = elements[bounds[k] : bounds[k + 1]]
        window = _window(piece, surroundings.margin, alignment, height, width)
        cost = _window_cost(surroundings, below, right, window)
        ends = _odd_ends(below, right, piece)
        sign = -1 if present[k] else 1
        _set_piece(below, right, piece, 1 - present[k])
        changed_cost = _window_cost(surroundings, below, right, window)
        changed_ends = _odd_ends(below, right, piece)
        bits = sign * model[ELEMENT] * len(piece) + 0.5 * model[CHAIN] * (changed_ends - ends)
        if changed_cost + model[MULTIPLIER] * bits < cost:
            present[k] = 1 - present[k]
            changes += 1
        else:
            _set_piece(below, right, piece, present[k])
    return changes
