"""Bit planes of quantised bands, most significant first (offset binary: bins count from the lowest)."""

import numpy as np
from numpy.typing import NDArray


def to_planes(bins: NDArray[np.int64], planes: int) -> NDArray[np.uint8]:
    """Split bin numbers into bit planes; inverse of `from_planes`."""
    shifts = np.arange(planes - 1, -1, -1)[:, None]
    return ((bins[None, :] >> shifts) & 1).astype(np.uint8)


def from_planes(planes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Join bit planes into bin numbers; inverse of `to_planes`."""
    bins = np.zeros(planes.shape[1], dtype=np.int64)
    for plane in planes:
        bins = 2 * bins + plane
    return bins


def prefix_borders(
    prefix: NDArray[np.int64], missing_planes: int, edges: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the interval in which a coefficient lies, given the planes known so far."""
    last = edges.size - 1
    lower = np.minimum(prefix << missing_planes, last)
    upper = np.minimum((prefix + 1) << missing_planes, last)
    return edges[lower], edges[upper]
