"""Laplacians in bins: squared error of the means of the bins, by how wide these are."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PER_OCTAVE = 8
"""Places for each octave of the variance."""
PER_PLANE = 2 * PER_OCTAVE
"""How many places a bit plane is, which halves the bins."""
FIRST_OCTAVE = -14
"""Of the variance over the squared width of the bins; less counts as this."""
NUM_PLACES = PER_OCTAVE * 34
_NUM_OFFSETS = 4  # of the bins against the middle of the Laplacian
_REACH = 14.0  # in scales
_FINE = 8.0  # scales over width from which on formulas for fine bins are exact enough


def _moments(edge: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the integrals, up to an edge, of density, value and square of a Laplacian of scale 1."""
    tail = 0.5 * np.exp(-np.abs(edge))
    low = edge < 0
    return (
        np.where(low, tail, 1.0 - tail),
        np.where(low, tail * (edge - 1.0), -tail * (edge + 1.0)),
        np.where(low, tail * (edge**2 - 2.0 * edge + 2.0), 2.0 - tail * (edge**2 + 2.0 * edge + 2.0)),
    )


def _in_bins(width: float) -> float:
    """Return the squared error over the variance, for bins of a width in scales."""
    if width < 1.0 / _FINE:
        return width * width / 24.0
    offsets = (np.arange(_NUM_OFFSETS) + 0.5) / _NUM_OFFSETS
    edges = np.full((_NUM_OFFSETS, 2 * math.ceil(_REACH / width) + 3), 1e3)
    edges[:, 0] = -1e3
    edges[:, 1:-1] = (np.arange(edges.shape[1] - 2) - edges.shape[1] // 2 + 1 + offsets[:, None]) * width
    error = 0.0
    for moments in zip(*map(np.diff, _moments(edges)), strict=True):
        mass, first, second = (moment[moments[0] > 0] for moment in moments)
        error += float((second - first * first / mass).sum()) / _NUM_OFFSETS
    return error / 2.0


@lru_cache(maxsize=1)
def laplacian_tables() -> Floats:
    """Tabulate Laplacians in bins, on the mean over all offsets of the bins."""
    octave, eighth = np.divmod(np.arange(NUM_PLACES), PER_OCTAVE)
    variances = 2.0 ** (octave + FIRST_OCTAVE) * (1.0 + (eighth + 0.5) / PER_OCTAVE)
    return np.stack([variances, [_in_bins(float(width)) for width in np.sqrt(2.0 / variances)]])
