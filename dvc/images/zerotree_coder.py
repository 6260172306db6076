"""Set partitioning in hierarchical trees, with contexts: coefficients as bytes that can be cut anywhere.

Magnitudes are whole numbers of steps, with a dead zone. Their bit planes are coded from the highest on; in
each, first the single coefficients, then the sets, then the next digits of coefficients that were
significant before. Unlike in the original algorithm, decisions have contexts (the neighbours, parent and
children, and the surroundings at that scale, mixed), decisions that follow from earlier ones are left out,
and a set is coded down to its leaves at once. A part of the bytes settles exactly some first decisions.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc.entropy import CoderState, RangeCoder
from dvc.entropy.mixing import new_mixture
from dvc.entropy.range_coder import POSITION
from dvc.errors import BitstreamError
from dvc.images import _kernels as kernels
from dvc.images.lifting import Details, Plane, Pyramid, scale_shapes

Shape = tuple[int, int]
Value = TypeVar("Value", bound=np.generic)
_MARGIN = 2
MAX_PLANES = 30
"""Most bit planes of magnitudes."""
_NEVER = 40  # a bit plane above all
_MAX_BYTES_PER_NODE = 8
_MORE_THAN_ALL_PER_NODE, _MORE_THAN_ALL = 16, 64  # bytes that no code reaches: for a node, and further ones
_FIRST_WEIGHT = 0.4


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
        return np.asarray(self.marks[:, kernels.FLAGS] & kernels.EXISTS != 0)

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
        sizes = scale_shapes(shape, levels)
        kinds = [(kernels.LOW_BAND, levels, *sizes[-1])]
        for level in range(levels, 0, -1):
            (low_rows, low_columns), (rows, columns) = sizes[level], sizes[level - 1]
            kinds.append((kernels.HORIZONTAL, level, low_rows, columns // 2))
            kinds.append((kernels.VERTICAL, level, rows // 2, low_columns))
            kinds.append((kernels.DIAGONAL, level, rows // 2, columns // 2))
        for kind, level, rows, columns in kinds:
            stride = columns + _MARGIN
            first = position + _MARGIN * stride + _MARGIN
            bands.append(Band(component, level, kind, (rows, columns), first, stride))
            position += (rows + 2 * _MARGIN) * stride + _MARGIN
    numbers = {
        (band.component, band.level, band.kind): k
        for k, band in enumerate(bands)
        if band.kind and 0 not in band.shape
    }
    rows_of_table = []
    for band in bands:
        around = [(band.component, level, band.kind) for level in (band.level + 1, band.level - 1)]
        above, below = (numbers.get(key, kernels.NONE) for key in around)
        own = band.first, band.stride, *band.shape, band.kind, band.level, band.component
        rows_of_table.append([*own, above, below])
    table = np.array(rows_of_table, np.int64)
    marks = np.zeros((position, 2), np.uint8)
    exists = np.zeros(position, np.uint8)
    for number, band in enumerate(bands):
        band.of(marks)[..., kernels.BAND] = number
        band.of(exists)[:] = 1 if masks is None else _band_of(masks[band.component], band) != 0
    children, deeper = np.zeros((2, position), np.uint8)
    kernels.gather_below(table, exists, children, deeper)
    flags = kernels.EXISTS, kernels.HAS_CHILDREN, kernels.HAS_GRANDCHILDREN
    for flag, found in zip(flags, (exists, children, deeper), strict=True):
        marks[:, kernels.FLAGS] |= np.multiply(found, flag, dtype=np.uint8)
    return Forest(tuple(bands), table, marks, tuple(num_levels))


def _band_of(pyramid: Pyramid, band: Band) -> NDArray[np.float64]:
    if band.kind == kernels.LOW_BAND:
        return pyramid.low
    return pyramid.details[band.level - 1][band.kind - 1]


@dataclass(frozen=True)
class EmbeddedCode:
    """Coefficients as bytes."""

    data: bytes  # any part from the beginning is the code of an approximation
    num_planes: int  # bit planes, which the reader needs
    bits: NDArray[np.float64]  # lengths, increasing
    squared_error: NDArray[np.float64]  # error of coefficients at these lengths, in squared steps


@dataclass(frozen=True)
class DecodedCoefficients:
    """Coefficients, as far as bytes determine them."""

    # lower bounds of magnitudes, in steps, with their signs; 0: not significant
    values: NDArray[np.int32]
    # lowest bit plane of each that is known: a magnitude is less than ``2^last_plane`` above its bound
    last_planes: NDArray[np.uint8]

    def part(self, band: Band) -> Self:
        """Return the coefficients of a band."""
        return type(self)(band.of(self.values), band.of(self.last_planes))

    def reconstruct(self, points: tuple[float, float]) -> NDArray[np.float64]:
        """Return coefficients, in steps."""
        magnitude, width, found = _intervals(self.values, self.last_planes)
        magnitude += np.where(found, points[0], points[1]) * width
        magnitude[self.values == 0] = 0.0
        return np.copysign(magnitude, self.values, out=magnitude)

    def fitted_points(self, exact: NDArray[np.float64]) -> tuple[float, float]:
        """Return the points of the least squared error."""
        chosen = np.flatnonzero(self.values)
        magnitude, width, found = _intervals(self.values[chosen], self.last_planes[chosen])
        excess = np.abs(exact[chosen]) - magnitude
        points = []
        for group in (found, ~found):
            energy = float(np.sum(width[group] ** 2))
            points.append(float(np.sum((excess * width)[group])) / energy if energy else 0.5)
        return points[0], points[1]


def _intervals(
    values: NDArray[np.int32], last_planes: NDArray[np.uint8]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    magnitude = np.abs(values.astype(np.float64))
    width = np.ldexp(np.float64(1.0), last_planes.astype(np.int32))
    return magnitude, width, magnitude == width


def encode(
    forest: Forest,
    coefficients: NDArray[np.float64],
    max_bytes: int | None = None,
    adaptive: bool = True,
    lowest_plane: int = 0,
) -> EmbeddedCode:
    """Code coefficients; the inverse of `decode`."""
    limit = 2.0**MAX_PLANES
    if not (-limit < np.min(coefficients) and np.max(coefficients) < limit):
        raise ValueError(f"`coefficients` must be finite and below 2^{MAX_PLANES} steps")
    most = _MAX_BYTES_PER_NODE * forest.num_nodes
    if max_bytes is not None:
        most = min(max_bytes, _MORE_THAN_ALL_PER_NODE * forest.num_nodes + _MORE_THAN_ALL)
    planes = np.maximum(np.frexp(coefficients)[1], 0).astype(np.uint8)  # those of whole magnitudes
    num_planes = int(planes.max())
    energy = float(np.sum(coefficients * coefficients))
    if not num_planes:
        return EmbeddedCode(b"", 0, np.zeros(1), np.array([energy]))
    marks = _new_marks(forest, kernels.NUM_WRITER_MARKS)
    below, deeper = np.zeros((2, forest.num_nodes), np.uint8)
    kernels.gather_below(forest.table, planes, below, deeper)
    marks[:, kernels.PLANES_BELOW], marks[:, kernels.PLANES_DEEPER] = below, deeper
    del planes, below, deeper
    coder = RangeCoder.writer()
    num_words = most // 4 + 4
    curve = np.zeros(num_words + 1)
    curve[-1] = energy
    run = _new_run(coder.room_for(num_words), forest, marks, coefficients, curve, most + 8, adaptive)
    kernels.code_planes(run, forest.roots, num_planes, lowest_plane)
    num_written = int(run.coder.fields[POSITION]) + 1
    curve[num_written - 1] = curve[-1]
    data = coder.to_bytes().ljust(4 * num_written + 4, b"\0")  # zeros follow for ever
    bits = np.append(np.arange(0.0, 32.0 * num_written, 32.0), 8.0 * len(data))
    errors = np.concatenate([[energy], curve[:num_written]])
    within = bits <= 8.0 * most
    return EmbeddedCode(data[:most], num_planes, bits[within], errors[within])


def decode(forest: Forest, data: bytes, num_planes: int, adaptive: bool = True) -> DecodedCoefficients:
    """Read coefficients from the beginning of their code."""
    if not 0 <= num_planes <= MAX_PLANES:
        raise BitstreamError(f"{num_planes} bit planes; there are at most {MAX_PLANES}")
    coder = RangeCoder.reader(data)
    marks = _new_marks(forest, kernels.NUM_READER_MARKS)
    nothing = np.zeros(0)
    run = _new_run(coder.room_for(0), forest, marks, nothing, np.zeros(1), len(data), adaptive)
    kernels.code_planes(run, forest.roots, num_planes, 0)
    coder.check()
    return DecodedCoefficients(run.values, marks[:, kernels.LAST_PLANE].copy())


def _new_marks(forest: Forest, num_columns: int) -> NDArray[np.uint8]:
    marks = np.zeros((forest.num_nodes, num_columns), np.uint8)
    marks[:, : forest.marks.shape[1]] = forest.marks
    marks[:, kernels.LAST_PLANE] = _NEVER
    return marks


def _new_run(
    coder: CoderState,
    forest: Forest,
    marks: NDArray[np.uint8],
    exact: NDArray[np.float64],
    curve: NDArray[np.float64],
    num_bytes: int,
    adaptive: bool,
) -> kernels.Run:
    num_parents = int(np.count_nonzero(forest.marks[:, kernels.FLAGS] & kernels.HAS_CHILDREN))
    fields, mixture = np.zeros(kernels.NUM_FIELDS, np.int64), (kernels.NUM_CONTEXTS, kernels.NUM_WEIGHTS)
    values, links = (np.zeros(forest.num_nodes, np.int32) for _ in range(2))
    sets = np.zeros(2 * num_parents, np.int32)
    opening = np.zeros(kernels.MOST_CHILDREN * (max(forest.num_levels) + 1), np.int32)
    state = coder, fields, values, marks, forest.table, links, sets, opening, exact, curve
    return kernels.Run(*state, new_mixture(*mixture, _FIRST_WEIGHT), num_bytes, adaptive)


def significance_maps(
    bands: Sequence[Band], decoded: DecodedCoefficients, shape: Shape, num_levels: int
) -> list[NDArray[np.bool_]]:
    """Return by scale where any orientation of any plane has a significant coefficient."""
    maps = [np.zeros(size, np.bool_) for size in scale_shapes(shape, num_levels)[1:]]
    for band in bands:
        if 0 < band.level <= num_levels and band.kind:
            rows, columns = band.shape
            maps[band.level - 1][:rows, :columns] |= band.of(decoded.values) != 0
    for coarser in maps[max(band.level for band in bands) :]:
        coarser[:] = True
    return maps
