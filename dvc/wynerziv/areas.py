"""Areas of a frame, squares of 4x4 blocks, and the coded choice of areas with requested bits."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dvc.entropy import RangeCoder, context_counts
from dvc.wynerziv import _kernels

SIDE = 4
"""Blocks along each side of an area, which has as many pixels as a macroblock: the smaller areas are, the
more a decoder has to say about them. `benchmarks.searches.settings dvc.wynerziv.areas.SIDE=2` compares."""
Chosen = NDArray[np.bool_]


@dataclass(frozen=True)
class Areas:
    """Areas of frames of one size."""

    band_shape: tuple[int, int]  # rows and columns of blocks

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of areas."""
        rows, columns = self.band_shape
        return -(-rows // SIDE), -(-columns // SIDE)

    @property
    def count(self) -> int:
        """Number of areas."""
        return self.shape[0] * self.shape[1]

    @cached_property
    def of_blocks(self) -> NDArray[np.int64]:
        """Index of the area of each block, in raster order."""
        rows, columns = (np.arange(size) // SIDE for size in self.band_shape)
        return np.add.outer(rows * self.shape[1], columns).ravel()

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Number of blocks in each area."""
        found: NDArray[np.int64] = np.bincount(self.of_blocks, minlength=self.count)
        return found

    def sums(self, blocks: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add up values of some blocks by area."""
        return np.bincount(self.of_blocks[blocks], values, self.count).astype(np.float64)

    def coded(self, chosen: Chosen) -> bytes:
        """Code a choice of areas; no bytes choose all."""
        if chosen.all():
            return b""
        coder, flags = RangeCoder.writer(), chosen.reshape(self.shape).astype(np.uint8)
        _kernels.code_areas(coder.room_for(chosen.size), _new_counts(), flags)
        return coder.to_bytes(shortest=True)

    def decoded(self, data: bytes) -> Chosen:
        """Decode a choice of areas; inverse of `coded`."""
        flags = np.ones(self.shape, np.uint8)
        if data:
            coder = RangeCoder.reader(data)
            _kernels.code_areas(coder.room_for(flags.size), _new_counts(), flags)
            coder.check_end(data)
        return flags.ravel().astype(np.bool_)


def _new_counts() -> NDArray[np.int64]:
    return context_counts(np.full(_kernels.AREA_CONTEXTS, 50))
