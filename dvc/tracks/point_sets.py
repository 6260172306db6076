"""Coding of the points of one frame: column by column, as differences of columns and as rows.

Columns are coded as the steps from each point to the next (differential pulse code modulation), one decision
per step; its probability follows from the remaining points and columns. A row is a number of fixed length
among the free rows: points keep a distance, which is sent once.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.entropy import RangeCoder
from dvc.errors import BitstreamError
from dvc.tracks import _kernels

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class SamplingGrid:
    """Common properties of the points of one or several frames."""

    num_columns: int  # columns of positions of the frame
    num_rows: int
    grid_exponent: int  # coordinates are multiples of two to this power
    min_distance: int  # no two points of a frame are nearer, in units of the grid

    @classmethod
    def of(cls, sets: list[Integers], num_columns: int, num_rows: int) -> Self:
        """Find what point sets have in common."""
        exponents = [int(_kernels.grid_exponent(points)) for points in sets]
        exponent = min(exponents, default=_kernels.GRID_EXPONENTS - 1)
        most = _kernels.DISTANCES - 1
        distances = [int(_kernels.min_distance(points >> exponent, most)) for points in sets]
        return cls(num_columns, num_rows, exponent, min(distances, default=most))

    def code(self, coder: RangeCoder) -> Self:
        """Code the grid and the distance."""
        exponent, distance = _kernels.code_grid(coder.room_for(2), self.grid_exponent, self.min_distance)
        coder.check()
        return replace(self, grid_exponent=int(exponent), min_distance=int(distance))

    @property
    def grid_columns(self) -> int:
        """Columns of the grid."""
        return (self.num_columns - 1 >> self.grid_exponent) + 1

    @property
    def grid_rows(self) -> int:
        """Rows of the grid."""
        return (self.num_rows - 1 >> self.grid_exponent) + 1


def num_positions(config: CodecConfig) -> tuple[int, int]:
    """Return how many positions a point has in x and y."""
    bits = config.tracks.subpixel_bits
    return (config.video.width - 1 << bits) + 1, (config.video.height - 1 << bits) + 1


def column_scan(points: NDArray[np.float64] | Integers) -> NDArray[np.intp]:
    """Return the order of points column by column, from the top in each."""
    return np.lexsort((points[:, 1], points[:, 0]))


def code_points(coder: RangeCoder, points: Integers, grid: SamplingGrid) -> Integers:
    """Code the points of a frame; their number is known."""
    points = points >> grid.grid_exponent
    state = coder.room_for(grid.grid_columns + 2 * len(points))
    if not _kernels.code_points(state, points, grid.grid_columns, grid.grid_rows, grid.min_distance):
        raise BitstreamError("a frame has no room for its points")
    coder.check()
    return points << grid.grid_exponent
