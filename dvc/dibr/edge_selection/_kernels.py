"""Compiled loops that weigh edges: what coefficients cost around them, with them and without."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.dibr.edges.lattice import degree, next_vertex, set_element
from dvc.dibr.wavelets.column_lifting import lift_columns
from dvc.dibr.wavelets.edge_maps import coarser

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
