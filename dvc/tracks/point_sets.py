"""Coding of the points of one frame: column by column, as differences of columns and as rows.

Columns are coded as the steps from each point to the next (differential pulse code modulation), one
decision a step, whose probability follows from how many points and columns are left. A row is a number of
fixed length among the rows that are free: points keep their distance, which is sent once.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.errors import BitstreamError
from dvc.tracks import _kernels
from dvc.tracks.range_coding import RangeReader, RangeWriter

Integers = NDArray[np.int64]

_GRID_EXPONENTS = 8
_DISTANCES = 256


@dataclass(frozen=True)
class Lattice:
    """What the points of a frame, or of several, have in common."""

    num_columns: int  # places for a point, of which the frame has so many in each direction
    num_rows: int
    grid_exponent: int  # coordinates are multiples of two to this power
    min_distance: int  # no two points of a frame are nearer, in units of the grid

    @classmethod
    def of(cls, sets: list[Integers], num_columns: int, num_rows: int) -> Self:
        """Find what point sets have in common.

        Parameters
        ----------
        sets : list of ndarray of shape (N, 2), int64
            Points of each frame, inside the frame.
        num_columns, num_rows : int
            Size of the frame, in the unit of the points.

        Returns
        -------
        Lattice
            The coarsest grid and the largest distance.
        """
        every = np.concatenate([np.zeros((0, 2), np.int64), *sets])
        joined = int(np.bitwise_or.reduce(every, axis=None)) | 1 << (_GRID_EXPONENTS - 1)
        exponent = (joined & -joined).bit_length() - 1
        distances = [int(_kernels.min_distance(points >> exponent, _DISTANCES - 1)) for points in sets]
        return cls(num_columns, num_rows, exponent, min(distances, default=_DISTANCES - 1))

    def write(self, writer: RangeWriter) -> None:
        """Write the grid and the distance; inverse of `read`.

        Parameters
        ----------
        writer : RangeWriter
            Where to write.
        """
        values = np.array([self.grid_exponent, self.min_distance], np.int32)
        writer.write_uniform(values, np.array([_GRID_EXPONENTS, _DISTANCES], np.int32))

    @classmethod
    def read(cls, reader: RangeReader, num_columns: int, num_rows: int) -> Self:
        """Read the grid and the distance; inverse of `write`.

        Parameters
        ----------
        reader : RangeReader
            Where to read.
        num_columns, num_rows : int
            Size of the frame, in the unit of the points.

        Returns
        -------
        Lattice
            As it was written.
        """
        grid_exponent = reader.read_uniform(_GRID_EXPONENTS)
        return cls(num_columns, num_rows, grid_exponent, reader.read_uniform(_DISTANCES))

    @property
    def grid_columns(self) -> int:
        """Columns of the grid."""
        return (self.num_columns - 1 >> self.grid_exponent) + 1

    @property
    def grid_rows(self) -> int:
        """Rows of the grid."""
        return (self.num_rows - 1 >> self.grid_exponent) + 1


def column_scan(points: NDArray[np.float64] | Integers) -> NDArray[np.intp]:
    """Return the order of points column by column, from the top in each.

    Parameters
    ----------
    points : ndarray of shape (N, 2)
        Points (x, y).

    Returns
    -------
    ndarray of shape (N,), intp
        Indices.
    """
    return np.lexsort((points[:, 1], points[:, 0]))


def write_points(writer: RangeWriter, points: Integers, lattice: Lattice) -> None:
    """Write the points of a frame, whose number is known; inverse of `read_points`.

    Parameters
    ----------
    writer : RangeWriter
        Where to write.
    points : ndarray of shape (N, 2), int64
        Points (x, y) in column scan.
    lattice : Lattice
        What is known of them.
    """
    on_grid = points >> lattice.grid_exponent
    writer.write_decisions(*_kernels.column_decisions(on_grid[:, 0], lattice.grid_columns))
    writer.write_uniform(*_kernels.row_ranks(on_grid, lattice.min_distance, lattice.grid_rows))


def read_points(reader: RangeReader, count: int, lattice: Lattice) -> Integers:
    """Read the points of a frame; inverse of `write_points`.

    Parameters
    ----------
    reader : RangeReader
        Where to read.
    count : int
        Number of points.
    lattice : Lattice
        What is known of them.

    Returns
    -------
    ndarray of shape (count, 2), int64
        Points (x, y) in column scan.

    Raises
    ------
    BitstreamError
        If there is no room for them.
    """
    points = np.zeros((count, 2), np.int64)
    points[:, 0] = _read_columns(reader, count, lattice.grid_columns)
    free = np.empty(lattice.grid_rows, np.bool_)
    for k in range(count):
        bound = int(_kernels.free_rows(points, k, lattice.min_distance, free))
        if bound == 0:
            raise BitstreamError("a frame has no room for its points")
        points[k, 1] = np.flatnonzero(free)[reader.read_uniform(bound)]
    return points << lattice.grid_exponent


def _read_columns(reader: RangeReader, count: int, num_columns: int) -> Integers:
    columns = np.zeros(count, np.int64)
    column, steps_left = 0, num_columns - 1
    for k in range(count):
        while steps_left and reader.read_decision(steps_left / (steps_left + count - k)):
            column += 1
            steps_left -= 1
        columns[k] = column
    return columns
