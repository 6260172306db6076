"""Edges of depth maps: by Canny's detector, of a file, or selected as those that are worth their bits.

A contour is selected if it reduces the cost of coefficients, their squared error and their bits, by more than
its own bits are worth. Candidates are cut into short pieces at junctions, and each piece is removed or added
again by the change of cost in a transform of its surroundings, until nothing changes.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from dvc._jit import kernel
from dvc.arrays import Integers
from dvc.errors import DvcError
from dvc.images.chain_code import Chains, draw, trace
from dvc.images.edge_maps import DOWN, RIGHT, EdgeMaps, Mask, coarser, degree, next_vertex, set_element
from dvc.images.lifting import FORWARD, WAVELETS, Plane, Wavelet, lift_columns
from dvc.picture_files import read_levels, write_png

CANNY_THRESHOLDS = 40.0, 100.0
"""Weaker and stronger threshold of the detector, for maps stretched to levels from 0 to 255."""
SHORTEST_CHAIN = 8
"""Edge elements of the shortest chain that Canny's detector keeps."""
_JUMP = 0.02
RIGHT_LEVEL, BELOW_LEVEL = 85, 170
"""Levels of a sample that is cut off from that to its right, and from that below it; both: their sum."""
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
_STEPS = np.array([[0, 1], [-1, 0], [0, -1], [1, 0]])  # rows and columns, by direction
_NUM_LEVELS, _MARGIN, _MAX_PASSES = 4, 16, 3
_LADDER_RATIO = 2.0**-0.5
_FINEST = 1 / 512
MOST_RUNGS = 19
"""Steps of a ladder from the finest to the extent of a map."""
ROUNDED = 1.0 / 12.0
"""Squared error of a significant coefficient, in squared steps."""


def edges_of_jumps(depth: Plane, least: float) -> EdgeMaps:
    """Return the edges between neighbours that differ."""
    edges = EdgeMaps.none((depth.shape[0], depth.shape[1]))
    edges.between_rows[:-1] = np.abs(np.diff(depth, axis=0)) > least
    edges.between_columns[:, :-1] = np.abs(np.diff(depth, axis=1)) > least
    return edges


def canny_edges(depth: Plane) -> EdgeMaps:
    """Return the edges at pixels that Canny's detector marks, without short chains."""
    extent = float(np.ptp(depth))
    if not extent:
        return EdgeMaps.none((depth.shape[0], depth.shape[1]))
    levels = np.round((depth - depth.min()) * (255.0 / extent)).astype(np.uint8)
    marked = cv2.Canny(levels, *CANNY_THRESHOLDS, L2gradient=True) > 0
    edges = edges_of_jumps(depth, _JUMP * extent)
    edges.between_rows[:-1] &= marked[:-1] | marked[1:]
    edges.between_columns[:, :-1] &= marked[:, :-1] | marked[:, 1:]
    chains = trace(edges)
    return draw(chains.take(np.flatnonzero(chains.lengths >= SHORTEST_CHAIN)))


def write_edges(path: Path, edges: EdgeMaps) -> None:
    """Write edges; the inverse of `read_edges`."""
    write_png(path, RIGHT_LEVEL * edges.between_columns + BELOW_LEVEL * edges.between_rows)


def read_edges(path: str | Path, shape: tuple[int, int]) -> EdgeMaps:
    """Read edges; those beyond the last row and column have no meaning."""
    levels = read_levels(path, "a picture of edges, as decode writes it")
    if levels.shape != shape:
        sizes = [f"{size[1]}x{size[0]}" for size in (levels.shape, shape)]
        raise DvcError(f"{path}: edges of {sizes[0]}, but the depth map is {sizes[1]}")
    known = (0, RIGHT_LEVEL, BELOW_LEVEL, RIGHT_LEVEL + BELOW_LEVEL)
    if not np.isin(levels, known).all():
        raise DvcError(f"{path}: edges have the levels {', '.join(map(str, known))}")
    right = np.isin(levels, (RIGHT_LEVEL, RIGHT_LEVEL + BELOW_LEVEL)).astype(np.uint8)
    below = (levels >= BELOW_LEVEL).astype(np.uint8)
    below[-1], right[:, -1] = 0, 0
    return EdgeMaps(below, right)


def select(
    depth: Plane, edges: EdgeMaps, step: float, order: int, wavelet: Wavelet = WAVELETS["9/7"]
) -> EdgeMaps:
    """Return the edges that are worth their bits."""
    elements, bounds = _pieces(trace(edges), edges)
    if not len(elements):
        return edges
    below, right = edges.between_rows.copy(), edges.between_columns.copy()
    rows, columns, directions = elements.T
    first_row, first_column = rows - (directions != DOWN), columns - (directions != RIGHT)
    flat = directions % 2 == 0
    jumps = np.abs(depth[first_row + flat, first_column + ~flat] - depth[first_row, first_column])
    mean_jumps = np.add.reduceat(jumps, bounds[:-1]) / np.diff(bounds)
    sequence, present = np.argsort(mean_jumps, kind="stable"), np.ones(len(bounds) - 1, np.uint8)
    plane, weights = depth / step, (np.array(wavelet.weights), wavelet.gain, *wavelet.scales)
    for _ in range(_MAX_PASSES):
        if not weigh_pieces(plane, weights, order, below, right, elements, bounds, sequence, present):
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
            is_cheap = found.count() * ELEMENT_BITS <= 2.0 * max_bits
            if is_cheap and len(_pieces(trace(found), found)[1]) <= most_pieces + 1:
                edges = found
        if edges is not None:
            edges = select(depth, edges, step, order, wavelet)
            if not edges.count():
                return
            yield step, edges
        step /= _LADDER_RATIO


def _pieces(chains: Chains, edges: EdgeMaps) -> tuple[Integers, Integers]:
    """Return vertex and direction of all edges, and the bounds of pieces: short, and cut at junctions."""
    begins = np.cumsum(chains.lengths) - chains.lengths
    steps = _STEPS[chains.directions]
    before = np.cumsum(steps, axis=0) - steps
    starts = np.stack(np.divmod(chains.starts, chains.shape[1] + 1), axis=1)
    vertices = before + np.repeat(starts - before[begins], chains.lengths, axis=0)
    cut = degrees(edges.between_rows, edges.between_columns, vertices) != 2
    cut[begins] = True
    first = np.flatnonzero(cut)
    lengths = np.diff(first, append=len(vertices))
    numbers = -(-lengths // _PIECE_LENGTH)
    within = np.arange(1, numbers.sum() + 1) - np.repeat(np.cumsum(numbers) - numbers, numbers)
    ends = np.repeat(first, numbers) + np.repeat(lengths, numbers) * within // np.repeat(numbers, numbers)
    elements = np.column_stack([vertices, chains.directions])
    return elements.astype(np.int64), np.concatenate([[0], ends])


@kernel
def coefficient_cost(magnitude):
    """Return the cost of a coefficient, in steps and squared steps: its energy, or error and bits if less."""
    energy = magnitude * magnitude
    if magnitude < 0.5:
        return energy
    bits = SIGNIFICANCE_BITS + BITS_PER_OCTAVE * np.log2(max(magnitude, 1.0))
    return min(energy, ROUNDED + MULTIPLIER * bits)


@kernel
def transform_cost(plane, below, right, num_levels, wavelet, order):
    """Return the cost of the details of a plane in squared steps, from weights, gain and scales."""
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
def _set_piece(below, right, elements, value):
    for k in range(len(elements)):
        set_element(below, right, elements[k, 0], elements[k, 1], elements[k, 2], value)


@kernel
def _window_cost(plane, wavelet, order, below, right, elements):
    """Return the cost of the part of a plane around a piece of a chain, aligned to the coarsest scale."""
    alignment = 1 << _NUM_LEVELS
    height, width = below.shape
    top, bottom = elements[:, 0].min() - _MARGIN, elements[:, 0].max() + _MARGIN
    left, end = elements[:, 1].min() - _MARGIN, elements[:, 1].max() + _MARGIN
    top, left = max(top // alignment * alignment, 0), max(left // alignment * alignment, 0)
    bottom = min((bottom + alignment - 1) // alignment * alignment, height)
    end = min((end + alignment - 1) // alignment * alignment, width)
    part_below = below[top:bottom, left:end].copy()
    part_right = right[top:bottom, left:end].copy()
    part_below[bottom - top - 1], part_right[:, end - left - 1] = 0, 0
    return transform_cost(plane[top:bottom, left:end], part_below, part_right, _NUM_LEVELS, wavelet, order)


@kernel
def degrees(below, right, vertices):
    """Return the number of edges that meet at each vertex."""
    found = np.empty(len(vertices), np.int64)
    for k in range(len(vertices)):
        found[k] = degree(below, right, vertices[k, 0], vertices[k, 1])
    return found


@kernel
def _odd_ends(below, right, elements):
    """Return the number of ends of a piece at which an odd number of edges meets."""
    first, last = elements[0], elements[-1]
    row, column = next_vertex(last[0], last[1], last[2])
    if row == first[0] and column == first[1]:
        return 0
    return degree(below, right, first[0], first[1]) % 2 + degree(below, right, row, column) % 2


@kernel
def weigh_pieces(plane, wavelet, order, below, right, elements, bounds, sequence, present):
    """Add or remove each piece of chains if that costs less; return the number of changes."""
    changes = 0
    for k in sequence:
        piece = elements[bounds[k] : bounds[k + 1]]
        cost = _window_cost(plane, wavelet, order, below, right, piece)
        ends = _odd_ends(below, right, piece)
        sign = -1 if present[k] else 1
        _set_piece(below, right, piece, np.uint8(1 - present[k]))
        changed_cost = _window_cost(plane, wavelet, order, below, right, piece)
        changed_ends = _odd_ends(below, right, piece)
        bits = sign * ELEMENT_BITS * len(piece) + 0.5 * CHAIN_BITS * (changed_ends - ends)
        if changed_cost + MULTIPLIER * bits < cost:
            present[k] = 1 - present[k]
            changes += 1
        else:
            _set_piece(below, right, piece, present[k])
    return changes
