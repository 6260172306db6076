"""The dual lattice: vertices between samples, and the edges that lead from one to the next, compiled.

Vertex (row, column) is the upper left corner of that sample, so there is one more of each. Directions are
0 right, 1 up, 2 left, 3 down. `below` and `right` are the maps of `EdgeMaps`.
"""

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

Flags = NDArray[np.uint8]

RIGHT, UP, LEFT, DOWN = range(4)


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
    """Return how many edges meet at a vertex."""
    number = 0
    for direction in range(4):
        if has_element(below, right, row, column, direction):
            number += 1
    return number
