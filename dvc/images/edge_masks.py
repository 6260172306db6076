"""Masks by edges: their border is one, and each region that edges separate is inside or outside.

Regions are numbered by their first samples, row by row. Edges never separate samples outside, so a region
that begins below or to the right of one outside is inside, and nothing is coded for it.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.mixing import code_adaptive
from dvc.entropy.range_coder import CoderState
from dvc.images.edge_maps import EdgeMaps, Flags

Mask = NDArray[np.bool_]

_INITIAL_PERCENT = 70, 30
"""Probability that a region is inside: the first one, and one next to regions inside only."""


def border(mask: Mask) -> EdgeMaps:
    """Return the edges between samples inside and outside a mask."""
    edges = EdgeMaps.none((mask.shape[0], mask.shape[1]))
    edges.between_rows[:-1] = mask[:-1] != mask[1:]
    edges.between_columns[:, :-1] = mask[:, :-1] != mask[:, 1:]
    return edges


def edges_inside(edges: EdgeMaps, mask: Mask) -> EdgeMaps:
    """Return the border of a mask, and the edges between samples inside it."""
    found = border(mask)
    found.between_rows[:-1] |= edges.between_rows[:-1] & mask[:-1] & mask[1:]
    found.between_columns[:, :-1] |= edges.between_columns[:, :-1] & mask[:, :-1] & mask[:, 1:]
    return found


def regions(edges: EdgeMaps) -> NDArray[np.int32]:
    """Return the number of the region of each sample; edges separate regions."""
    height, width = edges.shape
    ways = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    ways[::2, ::2] = 1
    ways[1::2, ::2] = edges.between_rows[:-1] == 0
    ways[::2, 1::2] = edges.between_columns[:, :-1] == 0
    _, labels = cv2.connectedComponents(ways, connectivity=4, ltype=cv2.CV_32S)
    _, first, number = np.unique(labels[::2, ::2], return_index=True, return_inverse=True)
    ranks = np.empty(len(first), np.int32)
    ranks[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return ranks[number.reshape(height, width)]


def code_mask(coder: RangeCoder, edges: EdgeMaps, mask: Mask | None = None) -> Mask:
    """Write or read which regions are inside."""
    found = regions(edges)
    _, first = np.unique(found, return_index=True)
    inside = np.zeros(len(first), np.uint8) if mask is None else mask.ravel()[first].astype(np.uint8)
    counts = context_counts(np.array(_INITIAL_PERCENT))
    _code_regions(coder.room_for(len(first)), counts, found, first, inside)
    coder.check()
    known: Mask = inside[found] != 0
    return known


@kernel
def _code_regions(
    coder: CoderState,
    counts: NDArray[np.int64],
    regions: NDArray[np.int32],
    first: NDArray[np.int64],
    inside: Flags,
) -> None:
    """Write or read which regions are inside, in turn; next to one outside nothing is coded."""
    width = regions.shape[1]
    for k in range(len(first)):
        row, column = first[k] // width, first[k] % width
        beside_outside = row > 0 and inside[regions[row - 1, column]] == 0
        beside_outside |= column > 0 and inside[regions[row, column - 1]] == 0
        if beside_outside:
            inside[k] = 1
        else:
            is_inside: Any = np.int64(inside[k])
            inside[k] = code_adaptive(coder, counts, min(k, 1), is_inside)
