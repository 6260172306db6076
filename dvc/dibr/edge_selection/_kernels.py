"""Compiled loops that weigh edges: what coefficients cost around them, with them and without."""

import numpy as np

from dvc._jit import kernel
from dvc.dibr.edges.lattice import degree, next_vertex, set_element
from dvc.dibr.wavelets.column_lifting import lift_columns

ROUNDED = 1.0 / 12.0
"""Squared error of a significant coefficient, in squared steps."""


@kernel
def coefficient_cost(magnitude, multiplier, significance_bits, bits_per_octave):
    """Return the cost of a coefficient, in steps and squared steps: its energy, or error and bits if less."""
    energy = magnitude * magnitude
    if magnitude < 0.5:
        return energy
    bits = significance_bits + bits_per_octave * np.log2(max(magnitude, 1.0))
    return min(energy, ROUNDED + multiplier * bits)


@kernel
def transform_cost(plane, below, right, num_levels, wavelet, order, model):
    """Return the cost of the details of a plane in squared steps.

    Parameters
    ----------
    plane : ndarray of shape (H, W), float64
        Samples, in steps.
    below, right : ndarray of shape (H, W), uint8
        Edges.
    num_levels : int
        How many times the low band is split.
    wavelet : tuple of (ndarray of shape (K,), float64), float, float, float
        Weights, gain, and the scales of the low and the high band.
    order : int
        Of the extrapolation.
    model : ndarray of shape (3,), float64
        Multiplier of bits, bits of a significant coefficient, bits per octave above one step.

    Returns
    -------
    float
        Cost.
    """
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
                    total += coefficient_cost(abs(low[i, t]) * scale, model[0], model[1], model[2])
        below, right = coarser(below, right)
        low = half
    return total


@kernel
def coarser(below, right):
    """Return the edges of the low band (4.5)."""
    height, width = (below.shape[0] + 1) // 2, (below.shape[1] + 1) // 2
    less_below, less_right = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)
    for i in range(height):
        for t in range(width):
            if i < height - 1:
                less_below[i, t] = below[2 * i, 2 * t] | below[2 * i + 1, 2 * t]
            if t < width - 1:
                less_right[i, t] = right[2 * i, 2 * t] | right[2 * i, 2 * t + 1]
    return less_below, less_right


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
def _window_cost(plane, below, right, window, num_levels, wavelet, order, model):
    top, bottom, left, end = window
    part_below = below[top:bottom, left:end].copy()
    part_right = right[top:bottom, left:end].copy()
    part_below[-1], part_right[:, -1] = 0, 0
    return transform_cost(
        plane[top:bottom, left:end], part_below, part_right, num_levels, wavelet, order, model
    )


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
def weigh_pieces(
    plane,
    below,
    right,
    elements,
    bounds,
    order_of_pieces,
    present,
    num_levels,
    margin,
    wavelet,
    order,
    model,
    element_bits,
    chain_bits,
):
    """Put in or take out each piece of chains where that costs less; return how many were changed.

    Parameters
    ----------
    plane : ndarray of shape (H, W), float64
        Samples, in steps.
    below, right : ndarray of shape (H, W), uint8
        Edges: changed.
    elements : ndarray of shape (E, 3), int64
        Vertex and direction of each edge of the pieces.
    bounds : ndarray of shape (N + 1,), int64
        Where each piece begins and ends.
    order_of_pieces : ndarray of shape (N,), int64
        In which order they are weighed.
    present : ndarray of shape (N,), uint8
        1 if a piece is in: changed.
    num_levels, margin : int
        How many scales are looked at, and how far around a piece.
    wavelet, order, model
        As `transform_cost` takes them.
    element_bits, chain_bits : float
        Of an edge, and of a chain.

    Returns
    -------
    int
        Number of changes.
    """
    changes = 0
    for k in order_of_pieces:
        piece = elements[bounds[k] : bounds[k + 1]]
        window = _window(piece, margin, 1 << num_levels, plane.shape[0], plane.shape[1])
        cost = _window_cost(plane, below, right, window, num_levels, wavelet, order, model)
        ends = _odd_ends(below, right, piece)
        sign = -1 if present[k] else 1
        _set_piece(below, right, piece, 1 - present[k])
        changed_cost = _window_cost(plane, below, right, window, num_levels, wavelet, order, model)
        changed_ends = _odd_ends(below, right, piece)
        bits = sign * element_bits * len(piece) + 0.5 * chain_bits * (changed_ends - ends)
        if changed_cost + model[0] * bits < cost:
            present[k] = 1 - present[k]
            changes += 1
        else:
            _set_piece(below, right, piece, present[k])
    return changes
