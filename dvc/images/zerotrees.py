"""Zerotrees: coefficients of one or several pyramids as trees from coarse to fine, in one array of nodes.

A coefficient's children are those of the same orientation in the four positions below it, in the next finer
scale. If a scale has an odd number of rows or columns, the last ones belong to the last parent, so that
nothing is padded. Coefficients of the low band, and those without a parent, are roots. Positions outside a
mask are never coded, nor are sets of them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc.images import _kernels as kernels
from dvc.images.lifting import Details, Plane, Pyramid, scale_shapes

Shape = tuple[int, int]
Value = TypeVar("Value", bound=np.generic)
_MARGIN = 2


@dataclass(frozen=True)
class Band:
    """A band of coefficients."""

    component: int  # plane that it belongs to
    level: int  # number of splits of its plane; 1 is the finest scale
    kind: int  # 0: low; 1, 2, 3: horizontal, vertical, diagonal details
    shape: Shape  # rows and columns
    first: int  # node of its first coefficient
    stride: int  # nodes from a row to the next

    def of(self, values: NDArray[Value]) -> NDArray[Value]:
        """Return the part of an array by node that belongs to the band."""
        rows, columns = self.shape
        block = values[self.first : self.first + rows * self.stride]
        return block.reshape(rows, self.stride, *values.shape[1:])[:, :columns]


@dataclass(frozen=True, eq=False)
class Forest:
    """Trees of coefficients."""

    bands: tuple[Band, ...]  # from coarse to fine, plane by plane
    table: NDArray[np.int64]  # bands as kernels take them
    marks: NDArray[np.uint8]  # band and flags of nodes, and of margins between bands
    num_levels: tuple[int, ...]  # splits of each plane

    @property
    def num_nodes(self) -> int:
        """Number of nodes, margins included."""
        return len(self.marks)

    @property
    def exists(self) -> NDArray[np.bool_]:
        """Mask of nodes that are coefficients."""
        return self.flag(kernels.EXISTS)

    def flag(self, flag: int) -> NDArray[np.bool_]:
        """Return which nodes have a flag."""
        return np.asarray(self.marks[:, kernels.FLAGS] & flag != 0)

    @property
    def roots(self) -> NDArray[np.int32]:
        """Nodes without parents, of shape (R,)."""
        found = [
            band.first + np.add.outer(np.arange(band.shape[0]) * band.stride, np.arange(band.shape[1]))
            for band, row in zip(self.bands, self.table, strict=True)
            if row[kernels.ABOVE] == kernels.NONE
        ]
        return np.concatenate([nodes.ravel() for nodes in found]).astype(np.int32)

    def gather(self, pyramids: Sequence[Pyramid]) -> NDArray[np.float64]:
        """Return the coefficients of pyramids by node; the inverse of `scatter`."""
        coefficients = np.zeros(self.num_nodes)
        for band in self.bands:
            exists = band.of(self.marks)[..., kernels.FLAGS] & kernels.EXISTS
            np.multiply(_band_of(pyramids[band.component], band), exists, out=band.of(coefficients))
        return coefficients


def scatter(bands: Sequence[Band], read: Callable[[Band], Plane]) -> Iterator[Pyramid]:
    """Yield pyramids of coefficients by band."""
    for _, plane in groupby(bands, key=lambda band: band.component):
        low, *finer = map(read, plane)
        details = [Details(*finer[k : k + 3]) for k in range(0, len(finer), 3)]
        yield Pyramid(low, tuple(reversed(details)))


def zerotrees(
    shapes: Sequence[Shape], num_levels: Sequence[int], masks: Sequence[Pyramid] | None = None
) -> Forest:
    """Arrange the coefficients of planes as trees."""
    bands: list[Band] = []
    position = 0
    for component, (shape, levels) in enumerate(zip(shapes, num_levels, strict=True)):
        for kind, level, rows, columns in _band_sizes(shape, levels):
            stride = columns + _MARGIN
            first = position + _MARGIN * stride + _MARGIN
            bands.append(Band(component, level, kind, (rows, columns), first, stride))
            position += (rows + 2 * _MARGIN) * stride + _MARGIN
    table = _table(bands)
    marks = np.zeros((position, 2), np.uint8)
    exists = np.zeros(position, np.uint8)
    for number, band in enumerate(bands):
        band.of(marks)[..., kernels.BAND] = number
        band.of(exists)[:] = 1 if masks is None else _band_of(masks[band.component], band) != 0
    below, deeper = np.zeros((2, position), np.uint8)
    kernels.gather_below(table, exists, below, deeper)
    for flag, found in (
        (kernels.EXISTS, exists),
        (kernels.HAS_CHILDREN, below),
        (kernels.HAS_GRANDCHILDREN, deeper),
    ):
        marks[:, kernels.FLAGS] |= np.multiply(found, flag, dtype=np.uint8)
    return Forest(tuple(bands), table, marks, tuple(num_levels))


def _table(bands: Sequence[Band]) -> NDArray[np.int64]:
    """Return bands as kernels take them; empty bands have no children."""
    numbers = {
        (band.component, band.level, band.kind): k for k, band in enumerate(bands) if 0 not in band.shape
    }
    table = []
    for band in bands:
        around = [
            numbers.get((band.component, band.level + step, band.kind), kernels.NONE)
            if band.kind
            else kernels.NONE
            for step in (1, -1)
        ]
        table.append([band.first, band.stride, *band.shape, band.kind, band.level, band.component, *around])
    return np.array(table, np.int64)


def _band_sizes(shape: Shape, num_levels: int) -> list[tuple[int, int, int, int]]:
    shapes = scale_shapes(shape, num_levels)
    sizes = [(kernels.LOW_BAND, num_levels, *shapes[-1])]
    for level in range(num_levels, 0, -1):
        (low_rows, low_columns), (rows, columns) = shapes[level], shapes[level - 1]
        sizes.append((kernels.HORIZONTAL, level, low_rows, columns // 2))
        sizes.append((kernels.VERTICAL, level, rows // 2, low_columns))
        sizes.append((kernels.DIAGONAL, level, rows // 2, columns // 2))
    return sizes


def _band_of(pyramid: Pyramid, band: Band) -> NDArray[np.float64]:
    if band.kind == kernels.LOW_BAND:
        return pyramid.low
    return pyramid.details[band.level - 1].bands[band.kind - 1]
