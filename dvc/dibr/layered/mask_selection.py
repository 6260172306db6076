"""Masks by rate and distortion: the set of pixels of least cost, by a minimum cut.

A pixel that is inside saves errors and costs bits; so does each edge between one inside and one outside. The
least sum over all sets is the minimum cut of a graph [Greig1989].

References
----------
[Greig1989] D. M. Greig, B. T. Porteous, A. H. Seheult, "Exact maximum a posteriori estimation for binary
images", J. R. Statist. Soc. B 51(2), 1989.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from dvc.images.edge_masks import border

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_UNIT = 64.0
"""Capacities are whole; so many to the cost of an edge."""
_MOST = 1 << 20


def best_mask(profit: Floats, edge_cost: float, region_cost: float) -> Mask:
    """Return the mask of the largest profit."""
    chosen = _minimum_cut(profit / edge_cost)
    number, labels = cv2.connectedComponents(chosen.astype(np.uint8), connectivity=4)
    edges = border(chosen)
    beside = np.zeros(chosen.shape)
    for axis, between in ((0, edges.between_rows), (1, edges.between_columns)):
        beside += between
        beside += np.roll(between, 1, axis)
    total = np.bincount(labels[chosen], (profit - edge_cost * beside)[chosen], minlength=number)
    worth = total > region_cost
    worth[0] = False
    return np.asarray(worth[labels])


def _minimum_cut(profit: Floats) -> Mask:
    """The set of the largest sum of profits, less the edges around it."""
    if not (profit > 0.0).any():
        return np.zeros(profit.shape, np.bool_)
    capacity = np.rint(_UNIT * np.clip(profit, -_MOST, _MOST)).astype(np.int32).ravel()
    numbers = np.arange(profit.size, dtype=np.int32).reshape(profit.shape)
    first = np.concatenate([numbers[:, :-1].ravel(), numbers[:-1].ravel()])
    second = np.concatenate([numbers[:, 1:].ravel(), numbers[1:].ravel()])
    gains, losses = np.flatnonzero(capacity > 0), np.flatnonzero(capacity < 0)
    source, sink = profit.size, profit.size + 1
    rows = np.concatenate([first, second, np.full(len(gains), source), losses]).astype(np.int32)
    columns = np.concatenate([second, first, gains, np.full(len(losses), sink)]).astype(np.int32)
    values = np.concatenate([np.full(2 * len(first), int(_UNIT)), capacity[gains], -capacity[losses]])
    graph = csr_array((values.astype(np.int32), (rows, columns)), shape=(sink + 1, sink + 1))
    left = graph - maximum_flow(graph, source, sink).flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    inside = np.zeros(sink + 1, np.bool_)
    inside[breadth_first_order(left, source, return_predecessors=False)] = True
    return inside[: profit.size].reshape(profit.shape)
