"""Automatic selection of edges: those that are worth their bits, at any rate.

A contour is kept if what it takes off the cost of coefficients, their squared error and their bits, is more
than its own bits are worth. Candidates are cut into short pieces where several meet, and each piece is taken
out or put in again by what it changes in a transform of its surroundings, until nothing changes. The only
parameter is the step of the quantiser, which a search over rates provides; all else is in units of it.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from dvc.images.edge_chains import Chains, trace
from dvc.images.edge_extraction import edges_of_jumps
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_masks import Mask
from dvc.images.edges import _kernels as kernels
from dvc.images.edges.lattice import DOWN, RIGHT
from dvc.images.lifting import WAVELETS, Plane, Wavelet

CANDIDATE_STEPS = 0.5
"""Least difference of neighbours between which there may be an edge, in steps."""

MULTIPLIER = 0.2
"""Squared steps that a bit is worth."""

SIGNIFICANCE_BITS, BITS_PER_OCTAVE = 6.0, 1.5
"""Of a coefficient of one step, with place and sign, and more for each octave above it."""

ELEMENT_BITS, CHAIN_BITS = 1.4, 11.0
"""Of an edge, and of the start and the end of a chain."""

PIECE_AREA, FEW_PIECES = 32, 2000
"""Pixels to a piece of candidates, beyond a few: more of them are noise, and take long."""

_PIECE_LENGTH = 32
_NUM_LEVELS, _MARGIN, _MAX_PASSES = 4, 16, 3
_LADDER_RATIO = 2.0**-0.5
_FINEST = 1 / 512
MOST_RUNGS = 19
"""Steps of a ladder from the finest to the extent of a map."""


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
    pieces = kernels.Pieces(elements, bounds, np.argsort(jumps, kind="stable"), present)
    weights = (np.array(wavelet.weights), wavelet.gain, *wavelet.scales)
    model = np.array([MULTIPLIER, SIGNIFICANCE_BITS, BITS_PER_OCTAVE, ELEMENT_BITS, CHAIN_BITS])
    surroundings = kernels.Surroundings(depth / step, weights, order, model, _NUM_LEVELS, _MARGIN)
    for _ in range(_MAX_PASSES):
        if not kernels.weigh_pieces(surroundings, below, right, pieces):
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
    """Yield selections for coarser and coarser steps, each out of the one before, until none is left."""
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
    """Cut chains where several meet, and into short pieces: elements and bounds, as the kernel takes them."""
    width = chains.shape[1] + 1
    begins = np.cumsum(chains.lengths) - chains.lengths
    rows = _from_starts(_ROW_STEPS[chains.directions], chains.starts // width, begins, chains.lengths)
    columns = _from_starts(_COLUMN_STEPS[chains.directions], chains.starts % width, begins, chains.lengths)
    cut = kernels.degrees(edges.between_rows, edges.between_columns, rows, columns) != 2
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
    """Row or column where each element begins, chain by chain."""
    before = np.cumsum(steps) - steps
    found: NDArray[np.int64] = before + np.repeat(starts - before[begins], lengths)
    return found


def _jumps(depth: Plane, elements: NDArray[np.int64]) -> NDArray[np.float64]:
    """Difference across each edge."""
    rows, columns, directions = elements.T
    flat = directions % 2 == 0
    first_row = np.where(directions == DOWN, rows, rows - 1)
    first_column = np.where(directions == RIGHT, columns, columns - 1)
    second_row, second_column = first_row + flat, first_column + ~flat
    jumps: Plane = np.abs(depth[second_row, second_column] - depth[first_row, first_column])
    return jumps
