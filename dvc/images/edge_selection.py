"""Automatic selection of the edges that are worth their bits, at any rate.

A contour is kept if it reduces the cost of coefficients, their squared error and their bits, by more than its
own bits are worth. Candidates are cut into short pieces at junctions, and each piece is removed or added
again by the change of cost in a transform of its surroundings, until nothing changes. The only parameter is
the step of the quantiser, which a search over rates provides; all else is in units of it.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.images.chain_code import Chains, trace
from dvc.images.edge_extraction import edges_of_jumps
from dvc.images.edge_maps import DOWN, RIGHT, EdgeMaps, Flags, Mask, coarser, degree, next_vertex, set_element
from dvc.images.lifting import FORWARD, WAVELETS, Plane, Wavelet, lift_columns

CANDIDATE_STEPS = 0.5
"""Least difference of neighbours with a candidate edge, in steps."""

MULTIPLIER = 0.2
"""Squared steps that a bit is worth."""

SIGNIFICANCE_BITS, BITS_PER_OCTAVE = 6.0, 1.5
"""Bits of a coefficient of one step, with position and sign; further bits for each octave above it."""

ELEMENT_BITS, CHAIN_BITS = 1.4, 11.0
"""Bits of an edge, and of the start and the end of a chain."""

PIECE_AREA, FEW_PIECES = 32, 2000
"""Pixels to a piece of candidates, beyond a few: more of them are noise, and take long."""

_PIECE_LENGTH = 32
_NUM_LEVELS, _MARGIN, _MAX_PASSES = 4, 16, 3
_LADDER_RATIO = 2.0**-0.5
_FINEST = 1 / 512
MOST_RUNGS = 19
"""Steps of a ladder from the finest to the extent of a map."""

ROUNDED = 1.0 / 12.0
"""Squared error of a significant coefficient, in squared steps."""

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
LiftingWeights = tuple[Floats, float, float, float]
"""Weights and gain of a wavelet, and the scales of the low and the high band."""


class Pieces(NamedTuple):
    """Pieces of chains."""

    elements: Integers  # vertex and direction of each edge of the pieces
    bounds: Integers  # index of the first edge of each piece, and the end
    order: Integers  # order of weighing
    present: Flags  # 1 if a piece is in


class Surroundings(NamedTuple):
    """Data for weighing pieces."""

    plane: Plane  # samples, in steps
    wavelet: LiftingWeights
    order: int  # order of the extrapolation
    num_levels: int  # number of scales
    margin: int  # samples around a piece


def select(
    depth: Plane, edges: EdgeMaps, step: float, order: int, wavelet: Wavelet = WAVELETS["9/7"]
) -> EdgeMaps:
    """Return the edges that are worth their bits."""
    chains = trace(edges)
    if not len(chains.starts):
        return edges
    elements, bounds = _pieces(chains, edges)
    below, right = edges.between_rows.copy(), edges.between_columns.copy()
    jumps = np.add.reduceat(_jumps(depth, elements), bounds[:-1]) / np.diff(bounds)
    present = np.ones(len(bounds) - 1, np.uint8)
    pieces = Pieces(elements, bounds, np.argsort(jumps, kind="stable"), present)
    weights = (np.array(wavelet.weights), wavelet.gain, *wavelet.scales)
    surroundings = Surroundings(depth / step, weights, order, _NUM_LEVELS, _MARGIN)
    for _ in range(_MAX_PASSES):
        if not weigh_pieces(surroundings, below, right, pieces):
            break
    return EdgeMaps(below, right)


def ladder(
    depth: Plane,
    max_bits: float,
    order: int,
    wavelet: Wavelet = WAVELETS["9/7"],
    mask: Mask | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> Iterator[tuple[float, EdgeMaps]]:
    """Yield selections for coarser and coarser steps, each a part of the one before, until it is empty."""
    largest = float(np.ptp(depth))
    step = largest * _FINEST
    edges = None
    most_pieces = max(depth.size / PIECE_AREA, FEW_PIECES)
    while step < largest:
        advance(1)
        if edges is None:
            found = edges_of_jumps(depth, CANDIDATE_STEPS * step)
            if mask is not None:
                found.between_rows[:-1] &= mask[:-1] & mask[1:]
                found.between_columns[:, :-1] &= mask[:, :-1] & mask[:, 1:]
            if found.count() * ELEMENT_BITS <= 2.0 * max_bits and _num_pieces(found) <= most_pieces:
                edges = found
        if edges is not None:
            edges = select(depth, edges, step, order, wavelet)
            if not edges.count():
                return
            yield step, edges
        step /= _LADDER_RATIO


def _num_pieces(edges: EdgeMaps) -> int:
    chains = trace(edges)
    return len(_pieces(chains, edges)[1]) - 1 if len(chains.starts) else 0


def _pieces(chains: Chains, edges: EdgeMaps) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the elements and bounds of chains cut at junctions, and into short pieces."""
    width = chains.shape[1] + 1
    begins = np.cumsum(chains.lengths) - chains.lengths
    rows = _from_starts(_ROW_STEPS[chains.directions], chains.starts // width, begins, chains.lengths)
    columns = _from_starts(_COLUMN_STEPS[chains.directions], chains.starts % width, begins, chains.lengths)
    cut = degrees(edges.between_rows, edges.between_columns, rows, columns) != 2
    cut[begins] = True
    first = np.flatnonzero(cut)
    lengths = np.diff(first, append=len(rows))
    numbers = -(-lengths // _PIECE_LENGTH)
    within = np.arange(1, numbers.sum() + 1) - np.repeat(np.cumsum(numbers) - numbers, numbers)
    ends = np.repeat(first, numbers) + np.repeat(lengths, numbers) * within // np.repeat(numbers, numbers)
    elements = np.stack([rows, columns, chains.directions], axis=1)
    return elements.astype(np.int64), np.concatenate([[0], ends])


_ROW_STEPS, _COLUMN_STEPS = np.array([0, -1, 0, 1]), np.array([1, 0, -1, 0])


def _from_starts(
    steps: NDArray[np.int64], starts: NDArray[np.int64], begins: NDArray[np.int64], lengths: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the row or column of the start of each element, chain by chain."""
    before = np.cumsum(steps) - steps
    found: NDArray[np.int64] = before + np.repeat(starts - before[begins], lengths)
    return found


def _jumps(depth: Plane, elements: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the difference across each edge."""
    rows, columns, directions = elements.T
    flat = directions % 2 == 0
    first_row = np.where(directions == DOWN, rows, rows - 1)
    first_column = np.where(directions == RIGHT, columns, columns - 1)
    second_row, second_column = first_row + flat, first_column + ~flat
    jumps: Plane = np.abs(depth[second_row, second_column] - depth[first_row, first_column])
    return jumps


@kernel
def coefficient_cost(magnitude: float) -> Any:
    """Return the cost of a coefficient, in steps and squared steps: its energy, or error and bits if less."""
    energy = magnitude * magnitude
    if magnitude < 0.5:
        return energy
    bits = SIGNIFICANCE_BITS + BITS_PER_OCTAVE * np.log2(max(magnitude, 1.0))
    return min(energy, ROUNDED + MULTIPLIER * bits)


@kernel
def transform_cost(
    plane: Plane,
    below: Flags,
    right: Flags,
    num_levels: int,
    wavelet: LiftingWeights,
    order: int,
) -> Any:
    """Return the cost of the details of a plane in squared steps."""
    weights, gain, low_scale, high_scale = wavelet
    low, total = plane.copy(), 0.0
    for _ in range(num_levels):
        height, width = low.shape
        if height > 1:
            lift_columns(low, below, weights, gain, order, FORWARD)
        across = np.ascontiguousarray(low.T)
        if width > 1:
            lift_columns(across, np.ascontiguousarray(right.T), weights, gain, order, FORWARD)
        half = np.empty(((height + 1) // 2, (width + 1) // 2))
        for i in range(height):
            row_scale = 1.0 if height == 1 else (low_scale if i % 2 == 0 else high_scale)
            for t in range(width):
                scale = row_scale if width == 1 else row_scale * (low_scale if t % 2 == 0 else high_scale)
                if i % 2 == 0 and t % 2 == 0:
                    half[i // 2, t // 2] = across[t, i] * scale
                else:
                    total += coefficient_cost(abs(across[t, i]) * scale)
        below, right = coarser(below, right)
        low = half
    return total


@kernel
def _set_piece(below: Flags, right: Flags, elements: Integers, value: Any) -> None:
    for k in range(len(elements)):
        set_element(below, right, elements[k, 0], elements[k, 1], elements[k, 2], value)


@kernel
def _window(elements: Integers, margin: int, alignment: int, height: int, width: int) -> Any:
    """Return the part of a plane around a piece of a chain, aligned to the coarsest scale."""
    top, bottom = elements[:, 0].min() - margin, elements[:, 0].max() + margin
    left, right = elements[:, 1].min() - margin, elements[:, 1].max() + margin
    top, left = max(top // alignment * alignment, 0), max(left // alignment * alignment, 0)
    bottom = min((bottom + alignment - 1) // alignment * alignment, height)
    right = min((right + alignment - 1) // alignment * alignment, width)
    return top, bottom, left, right


@kernel
def _window_cost(
    surroundings: Surroundings, below: Flags, right: Flags, window: tuple[int, int, int, int]
) -> Any:
    top, bottom, left, end = window
    part_below = below[top:bottom, left:end].copy()
    part_right = right[top:bottom, left:end].copy()
    part_below[bottom - top - 1], part_right[:, end - left - 1] = 0, 0
    plane, wavelet, order, num_levels, _ = surroundings
    return transform_cost(plane[top:bottom, left:end], part_below, part_right, num_levels, wavelet, order)


@kernel
def degrees(below: Flags, right: Flags, rows: Integers, columns: Integers) -> Any:
    """Return the number of edges that meet at each vertex."""
    found = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        found[k] = degree(below, right, rows[k], columns[k])
    return found


@kernel
def _odd_ends(below: Flags, right: Flags, elements: Integers) -> Any:
    """Return the number of ends of a piece at which an odd number of edges meets."""
    last = elements[-1]
    row, column = next_vertex(last[0], last[1], last[2])
    first = elements[0]
    if row == first[0] and column == first[1]:
        return 0
    return degree(below, right, first[0], first[1]) % 2 + degree(below, right, row, column) % 2


@kernel
def weigh_pieces(surroundings: Surroundings, below: Flags, right: Flags, pieces: Pieces) -> Any:
    """Add or remove each piece of chains if that costs less; return the number of changes."""
    elements, bounds, order_of_pieces, present = pieces
    alignment = 1 << surroundings.num_levels
    height, width = below.shape
    changes = 0
    for k in order_of_pieces:
        piece = elements[bounds[k] : bounds[k + 1]]
        window = _window(piece, surroundings.margin, alignment, height, width)
        cost = _window_cost(surroundings, below, right, window)
        ends = _odd_ends(below, right, piece)
        sign = -1 if present[k] else 1
        _set_piece(below, right, piece, np.uint8(1 - present[k]))
        changed_cost = _window_cost(surroundings, below, right, window)
        changed_ends = _odd_ends(below, right, piece)
        bits = sign * ELEMENT_BITS * len(piece) + 0.5 * CHAIN_BITS * (changed_ends - ends)
        if changed_cost + MULTIPLIER * bits < cost:
            present[k] = 1 - present[k]
            changes += 1
        else:
            _set_piece(below, right, piece, present[k])
    return changes
