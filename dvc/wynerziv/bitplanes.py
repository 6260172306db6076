"""Bit planes of quantised bands, most significant first (offset binary: bins count from the lowest)."""

import numpy as np
from numpy.typing import NDArray


def to_planes(bins: NDArray[np.int64], planes: int) -> NDArray[np.uint8]:
    """Split bin numbers into bit planes; inverse of `from_planes`.

    Parameters
    ----------
    bins : ndarray of shape (N,), int64
        Bin numbers in [0, 2^planes).
    planes : int
        Number of planes.

    Returns
    -------
    ndarray of shape (planes, N), uint8
        Bits, most significant plane first.
    """
    shifts = np.arange(planes - 1, -1, -1)[:, None]
    return ((bins[None, :] >> shifts) & 1).astype(np.uint8)


def from_planes(planes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Join bit planes into bin numbers; inverse of `to_planes`.

    Parameters
    ----------
    planes : ndarray of shape (P, N), uint8
        The most significant planes of a band, most significant first.

    Returns
    -------
    ndarray of shape (N,), int64
        The number that the planes spell: the bin, or its prefix where planes are missing.
    """
    bins = np.zeros(planes.shape[1], dtype=np.int64)
    for plane in planes:
        bins = 2 * bins + plane
    return bins


def prefix_borders(
    prefix: NDArray[np.int64], missing_planes: int, edges: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the interval in which a coefficient lies, given the planes known so far.

    Parameters
    ----------
    prefix : ndarray of shape (N,), int64
        Number spelled by the known planes.
    missing_planes : int
        How many planes of the band are not known yet.
    edges : ndarray of shape (num_bins + 1,), float64
        Borders of the band's bins.

    Returns
    -------
    lower, upper : ndarray of shape (N,), float64
        Borders; equal where the planes spell a bin that does not exist.
    """
    last = edges.size - 1
    lower = np.minimum(prefix << missing_planes, last)
    upper = np.minimum((prefix + 1) << missing_planes, last)
    return edges[lower], edges[upper]
