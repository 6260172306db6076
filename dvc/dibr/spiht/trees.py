"""Zerotrees: coefficients of one or several pyramids as trees from coarse to fine, in one array of nodes.

A coefficient's children are those of the same orientation in the four places below it, in the next finer
scale. Where a scale has an odd number of rows or columns, the last ones belong to the last parent, so that
nothing is padded. Coefficients of the low band, and those above which there is none, are roots. Positions
that a mask leaves out are never coded, nor are sets of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.spiht import _kernels as kernels
from dvc.dibr.wavelets.lifting import Details, Pyramid, scale_shapes

Shape = tuple[int, int]
_MARGIN = 2
_NEVER = 40  # a bit plane above all


@dataclass(frozen=True)
class Band:
    """Where a band is.

    Attributes
    ----------
    component : int
        Plane that it belongs to.
    level : int
        How many times its plane was split; 1 is the finest scale.
    kind : int
        0: low; 1, 2, 3: horizontal, vertical, diagonal details.
    nodes : ndarray of shape (h, w), int32
        Its coefficients among all nodes.
    stride : int
        Nodes from a row to the next.
    """

    component: int
    level: int
    kind: int
    nodes: NDArray[np.int32]
    stride: int


@dataclass(frozen=True)
class Forest:
    """Trees of coefficients.

    Attributes
    ----------
    bands : tuple of Band
        From coarse to fine, plane by plane.
    nodes : ndarray of shape (S, 13), int32
        Nodes and margins between bands, as the kernels take them.
    roots : ndarray of shape (R,), int32
        Nodes without parents.
    num_levels : tuple of int
        Of each plane.
    """

    bands: tuple[Band, ...]
    nodes: NDArray[np.int32]
    roots: NDArray[np.int32]
    num_levels: tuple[int, ...]

    def gather(self, pyramids: Sequence[Pyramid]) -> NDArray[np.float64]:
        """Return the coefficients of pyramids by node; the inverse of `scatter`.

        Parameters
        ----------
        pyramids : sequence of Pyramid
            One per plane, of its size.

        Returns
        -------
        ndarray of shape (S,), float64
            Coefficients; zeros in margins and where a mask leaves them out.
        """
        coefficients = np.zeros(len(self.nodes))
        for band in self.bands:
            coefficients[band.nodes] = _band_of(pyramids[band.component], band)
        return coefficients * self.nodes[:, kernels.EXISTS]

    def scatter(self, coefficients: NDArray[np.float64]) -> list[Pyramid]:
        """Return pyramids of coefficients by node.

        Parameters
        ----------
        coefficients : ndarray of shape (S,), float64
            Coefficients.

        Returns
        -------
        list of Pyramid
            One per plane.
        """
        pyramids, bands = [], iter(self.bands)
        for num_levels in self.num_levels:
            low = coefficients[next(bands).nodes]
            details = [
                Details(*(coefficients[next(bands).nodes] for _ in range(3))) for _ in range(num_levels)
            ]
            pyramids.append(Pyramid(low, tuple(reversed(details))))
        return pyramids


def zerotrees(
    shapes: Sequence[Shape], num_levels: Sequence[int], masks: Sequence[Pyramid] | None = None
) -> Forest:
    """Arrange the coefficients of planes as trees.

    Parameters
    ----------
    shapes : sequence of tuple of int
        Rows and columns of each plane.
    num_levels : sequence of int
        How many times each is split.
    masks : sequence of Pyramid, optional
        Nonzero where a coefficient exists; all do by default.

    Returns
    -------
    Forest
        The trees.
    """
    bands: list[Band] = []
    position = 0
    for component, (shape, levels) in enumerate(zip(shapes, num_levels, strict=True)):
        for kind, level, rows, columns in _band_sizes(shape, levels):
            stride = columns + _MARGIN
            start = position + _MARGIN * stride + _MARGIN
            places = start + np.arange(rows)[:, np.newaxis] * stride + np.arange(columns)
            bands.append(Band(component, level, kind, places.astype(np.int32), stride))
            position += (rows + 2 * _MARGIN) * stride + _MARGIN
    nodes = np.zeros((position, kernels.NUM_COLUMNS), np.int32)
    nodes[:, kernels.LAST_PLANE] = _NEVER
    by_name = {(band.component, band.level, band.kind): band for band in bands}
    for number, band in enumerate(bands):
        nodes[band.nodes, kernels.BAND] = number
        nodes[band.nodes, kernels.EXISTS] = 1 if masks is None else _band_of(masks[band.component], band) != 0
        above = by_name.get((band.component, band.level + 1, band.kind)) if band.kind else None
        if above is not None and above.nodes.size and band.nodes.size:
            _connect(nodes, above.nodes, band.nodes)
    all_nodes = np.concatenate([band.nodes.ravel() for band in bands])
    roots = all_nodes[nodes[all_nodes, kernels.PARENT] == 0]
    kernels.gather_below(nodes, kernels.EXISTS, kernels.HAS_CHILDREN, kernels.HAS_GRANDCHILDREN)
    return Forest(tuple(bands), nodes, roots, tuple(num_levels))


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


def _connect(nodes: NDArray[np.int32], parents: NDArray[np.int32], children: NDArray[np.int32]) -> None:
    """Enter who is whose parent, in two bands of one orientation."""
    rows = np.minimum(np.arange(children.shape[0]) // 2, parents.shape[0] - 1)
    columns = np.minimum(np.arange(children.shape[1]) // 2, parents.shape[1] - 1)
    nodes[children, kernels.PARENT] = parents[np.ix_(rows, columns)]
    nodes[parents, kernels.CHILD] = children[: 2 * parents.shape[0] : 2, : 2 * parents.shape[1] : 2]
    nodes[parents, kernels.CHILD_ROWS] = np.bincount(rows)[:, np.newaxis]
    nodes[parents, kernels.CHILD_COLUMNS] = np.bincount(columns)
