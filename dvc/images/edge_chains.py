"""Chains: edges as ways from vertex to vertex of the dual lattice, and differential directions along them.

Vertex (row, column) is the upper left corner of that sample, so there is one more of each. Directions are
0 right, 1 up, 2 left, 3 down.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.images.edge_maps import EdgeMaps
from dvc.images.edges import _kernels as kernels


@dataclass(frozen=True, eq=False)
class Chains:
    """Edges as chains."""

    shape: tuple[int, int]  # rows and columns of the plane
    starts: NDArray[np.int64]  # vertices at which chains begin, row by row, not decreasing
    lengths: NDArray[np.int64]  # edge elements of each, at least 1
    directions: NDArray[np.int8]  # of all elements, chain by chain

    def parts(self) -> list[NDArray[np.int8]]:
        """Return the directions of each chain."""
        return np.split(self.directions, np.cumsum(self.lengths)[:-1]) if len(self.lengths) else []


def trace(edges: EdgeMaps) -> Chains:
    """Return edges as few chains; the inverse of `draw`."""
    number = edges.count()
    starts, lengths = np.zeros(number, np.int64), np.zeros(number, np.int64)
    directions = np.zeros(number, np.int8)
    below, right = edges.between_rows.copy(), edges.between_columns.copy()
    found = kernels.trace(below, right, starts, lengths, directions)
    order = np.argsort(starts[:found], kind="stable")
    parts = np.split(directions, np.cumsum(lengths[:found])[:-1]) if found else []
    sorted_parts = [parts[k] for k in order]
    joined = np.concatenate(sorted_parts) if found else directions
    return Chains(edges.shape, starts[:found][order], lengths[:found][order], joined)


def draw(chains: Chains) -> EdgeMaps:
    """Return the edges of chains; the inverse of `trace`."""
    edges = EdgeMaps.none(chains.shape)
    columns = chains.shape[1] + 1
    for start, directions in zip(chains.starts, chains.parts(), strict=True):
        row, column = divmod(int(start), columns)
        if not kernels.draw(edges.between_rows, edges.between_columns, row, column, directions):
            raise ValueError("a chain leaves the plane")
    return edges
