"""Edges on the lattice dual to that of samples: neighbours that a transform treats as independent.

Vertex (row, column) of the dual lattice is the upper left corner of that sample, so it has one more of each.
Directions are 0 right, 1 up, 2 left, 3 down. In kernels, `below` and `right` are the maps of `EdgeMaps`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

Flags = NDArray[np.uint8]

RIGHT, UP, LEFT, DOWN = range(4)


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

    def coarser(self) -> Self:
        """Return the edges of the low band (4.5)."""
        return type(self)(*coarser(self.between_rows, self.between_columns))

    def pyramid(self, num_levels: int) -> Iterator[Self]:
        """Yield the edges of all scales that are split."""
        maps = self
        for level in range(num_levels):
            if level:
                maps = maps.coarser()
            yield maps


@kernel
def coarser(below: Flags, right: Flags) -> tuple[Flags, Flags]:
    """Return the edges of the low band (4.5), compiled."""
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
def has_element(below: Flags, right: Flags, row: int, column: int, direction: int) -> bool:
    """Return whether an edge leads from a vertex in a direction."""
    if not is_inside(below, row, column, direction):
        return False
    if direction == RIGHT:
        return bool(below[row - 1, column] != 0)
    if direction == LEFT:
        return bool(below[row - 1, column - 1] != 0)
    if direction == DOWN:
        return bool(right[row, column - 1] != 0)
    return bool(right[row - 1, column - 1] != 0)


@kernel
def is_inside(below: Flags, row: int, column: int, direction: int) -> bool:
    """Return whether an edge can lead from a vertex in a direction, between two samples."""
    height, width = below.shape
    if direction in (RIGHT, LEFT):
        return bool(0 < row < height and (0 <= column < width if direction == RIGHT else 0 < column <= width))
    return bool(0 < column < width and (0 <= row < height if direction == DOWN else 0 < row <= height))


@kernel
def next_vertex(row: int, column: int, direction: int) -> tuple[int, int]:
    """Return the vertex that an edge leads to."""
    if direction == RIGHT:
        return row, column + 1
    if direction == LEFT:
        return row, column - 1
    if direction == DOWN:
        return row + 1, column
    return row - 1, column


@kernel
def set_element(below: Flags, right: Flags, row: int, column: int, direction: int, value: int) -> None:
    """Set the edge from a vertex in a direction."""
    if direction == RIGHT:
        below[row - 1, column] = value
    elif direction == LEFT:
        below[row - 1, column - 1] = value
    elif direction == DOWN:
        right[row, column - 1] = value
    else:
        right[row - 1, column - 1] = value


@kernel
def degree(below: Flags, right: Flags, row: int, column: int) -> int:
    """Return the number of edges that meet at a vertex."""
    number = 0
    for direction in range(4):
        if has_element(below, right, row, column, direction):
            number += 1
    return number
