"""Edges on the lattice dual to that of samples: neighbours that a transform treats as independent; masks.

Vertex (row, column) of the dual lattice is the upper left corner of that sample. In kernels, `below` and
`right` are the maps of `EdgeMaps`. The border of a mask is among the edges, and each region that edges
separate is inside or outside. Edges never separate samples outside, so a region that begins below or to the
right of one outside is inside, and nothing is coded for it.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.mixing import code_adaptive

Flags = NDArray[np.uint8]
Mask = NDArray[np.bool_]

RIGHT, UP, LEFT, DOWN = range(4)
_INITIAL_PERCENT = 70, 30
"""Probability that a region is inside: the first one, and one next to regions inside only."""


@dataclass(frozen=True, eq=False)
class EdgeMaps:
    """Edges of a plane, as two maps."""

    between_rows: Flags  # 1: a sample is cut off from that below it; e^(h) of (4.5), at (s + 1/2, t)
    between_columns: Flags  # 1: a sample is cut off from that to its right; e^(v), at (s, t + 1/2)

    def __post_init__(self) -> None:
        if self.between_rows.shape != self.between_columns.shape or self.between_rows.ndim != 2:
            raise ValueError("both maps must have the shape of the plane")
        if self.between_rows[-1:].any() or self.between_columns[:, -1:].any():
            raise ValueError("the last row and column have no neighbours to be cut off from")

    @classmethod
    def none(cls, shape: tuple[int, int]) -> Self:
        """Return maps without edges."""
        return cls(np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the plane."""
        return self.between_rows.shape[0], self.between_rows.shape[1]

    def count(self) -> int:
        """Return the number of edge elements."""
        return int(np.count_nonzero(self.between_rows)) + int(np.count_nonzero(self.between_columns))

    def pyramid(self, num_levels: int) -> Iterator[Self]:
        """Yield the edges of all scales that are split."""
        maps = self
        for level in range(num_levels):
            if level:
                maps = type(self)(*coarser(maps.between_rows, maps.between_columns))
            yield maps


@kernel
def coarser(below: Flags, right: Flags) -> tuple[Flags, Flags]:
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
def is_inside(below: Flags, row: int, column: int, direction: int) -> bool:
    """Return whether an edge can lead from a vertex in a direction, between two samples."""
    height, width = below.shape
    if direction % 2 == 0:
        first = int(direction == LEFT)
        return bool(0 < row < height and first <= column < width + first)
    first = int(direction == UP)
    return bool(0 < column < width and first <= row < height + first)


@kernel
def has_element(below: Flags, right: Flags, row: int, column: int, direction: int) -> bool:
    """Return whether an edge leads from a vertex in a direction."""
    if not is_inside(below, row, column, direction):
        return False
    maps = below if direction % 2 == 0 else right
    return bool(maps[row - int(direction != DOWN), column - int(direction != RIGHT)] != 0)


@kernel
def set_element(below: Flags, right: Flags, row: int, column: int, direction: int, value: int) -> None:
    """Set the edge from a vertex in a direction."""
    maps = below if direction % 2 == 0 else right
    maps[row - int(direction != DOWN), column - int(direction != RIGHT)] = value


@kernel
def next_vertex(row: int, column: int, direction: int) -> tuple[int, int]:
    """Return the vertex that an edge leads to."""
    row += int(direction == DOWN) - int(direction == UP)
    return row, column + int(direction == RIGHT) - int(direction == LEFT)


@kernel
def degree(below: Flags, right: Flags, row: int, column: int) -> int:
    """Return the number of edges that meet at a vertex."""
    number = 0
    for direction in range(4):
        number += int(has_element(below, right, row, column, direction))
    return number


def border(mask: Mask) -> EdgeMaps:
    """Return the edges between samples inside and outside a mask."""
    return edges_inside(EdgeMaps.none((mask.shape[0], mask.shape[1])), mask)


def edges_inside(edges: EdgeMaps, mask: Mask) -> EdgeMaps:
    """Return the border of a mask, and the edges between samples inside it."""
    found = EdgeMaps.none(edges.shape)
    for target, source, before, after in (
        (found.between_rows[:-1], edges.between_rows[:-1], mask[:-1], mask[1:]),
        (found.between_columns[:, :-1], edges.between_columns[:, :-1], mask[:, :-1], mask[:, 1:]),
    ):
        target[:] = (before != after) | (source & before & after)
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
    return np.asarray(inside[found] != 0)


@kernel
def _code_regions(coder, counts, regions, first, inside):
    """Write or read which regions are inside, in turn; next to one outside nothing is coded."""
    width = regions.shape[1]
    for k in range(len(first)):
        row, column = first[k] // width, first[k] % width
        beside_outside = row > 0 and inside[regions[row - 1, column]] == 0
        beside_outside |= column > 0 and inside[regions[row, column - 1]] == 0
        if beside_outside:
            inside[k] = 1
        else:
            is_inside = np.int64(inside[k])
            inside[k] = code_adaptive(coder, counts, min(k, 1), is_inside)
