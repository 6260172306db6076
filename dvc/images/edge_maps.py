"""Edges on the lattice dual to that of samples: which neighbours a transform treats as independent."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

Flags = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class EdgeMaps:
    """Edges of a plane, as two maps."""

    between_rows: Flags  # 1 where a sample is cut off from that below it: e^(h) of (4.5), at (s + 1/2, t)
    between_columns: Flags  # 1 where a sample is cut off from that to its right: e^(v), at (s, t + 1/2)

    def __post_init__(self) -> None:
        if self.between_rows.shape != self.between_columns.shape or self.between_rows.ndim != 2:
            raise ValueError("both maps must have the shape of the plane")
        if self.between_rows[-1:].any() or self.between_columns[:, -1:].any():
            raise ValueError("there is nothing beyond the last row and column to be cut off from")

    @classmethod
    def none(cls, shape: tuple[int, int]) -> Self:
        """Return maps without edges."""
        return cls(np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the plane."""
        return self.between_rows.shape[0], self.between_rows.shape[1]

    def count(self) -> int:
        """Return how many edge elements there are."""
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
