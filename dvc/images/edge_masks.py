"""Masks by edges: their border is one, and each region that edges separate is inside or outside.

Regions are numbered by their first samples, row by row. There are no edges between samples outside, so a
region that begins below or to the right of one outside is inside, and nothing is coded for it.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.entropy import RangeCoder, context_counts
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edges import _kernels as kernels

Mask = NDArray[np.bool_]

_INITIAL_PERCENT = 70, 30
"""Probability that a region is inside: of the first one, and of one that is only beside others inside."""


def border(mask: Mask) -> EdgeMaps:
    """Return the edges between samples inside and outside a mask."""
    edges = EdgeMaps.none((mask.shape[0], mask.shape[1]))
    edges.between_rows[:-1] = mask[:-1] != mask[1:]
    edges.between_columns[:, :-1] = mask[:, :-1] != mask[:, 1:]
    return edges


def edges_inside(edges: EdgeMaps, mask: Mask) -> EdgeMaps:
    """Return the border of a mask, and those of some edges that both samples beside them are inside of."""
    found = border(mask)
    found.between_rows[:-1] |= edges.between_rows[:-1] & mask[:-1] & mask[1:]
    found.between_columns[:, :-1] |= edges.between_columns[:, :-1] & mask[:, :-1] & mask[:, 1:]
    return found


def regions(edges: EdgeMaps) -> NDArray[np.int32]:
    """Return the regions that edges separate: which samples are connected without crossing one."""
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
    kernels.code_regions(coder.room_for(len(first)), counts, found, first, inside)
    coder.check()
    known: Mask = inside[found] != 0
    return known
