"""Laplacians in bins: squared error of the means of the bins, by how wide these are."""

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
_FAR = 1e3
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


def _in_bins(widths: Floats) -> Floats:
    """Return the squared error over the variance, for bins of widths in scales."""
    offsets = (np.arange(_NUM_OFFSETS) + 0.5) / _NUM_OFFSETS
    reach = np.ceil(_REACH / widths)[:, None, None]
    number = np.arange(-reach.max(), reach.max() + 1.0)
    edges = (number + offsets[:, None]) * widths[:, None, None]
    edges = np.where(np.abs(number) <= reach, edges, np.copysign(_FAR, number))
    outside = np.full((*edges.shape[:2], 1), _FAR)
    edges = np.concatenate([-outside, edges, outside], axis=2)
    mass, first, second = (np.diff(moment) for moment in _moments(edges))
    error: Floats = (second - first * first / np.where(mass > 0, mass, 1.0)).sum(axis=2).mean(axis=1)
    return error / 2.0


@lru_cache(maxsize=1)
def laplacian_tables() -> Floats:
    """Tabulate Laplacians in bins, on the mean over all offsets of the bins."""
    octave, eighth = np.divmod(np.arange(NUM_PLACES), PER_OCTAVE)
    variances = 2.0 ** (octave + FIRST_OCTAVE) * (1.0 + (eighth + 0.5) / PER_OCTAVE)
    widths = np.sqrt(2.0 / variances)
    errors = widths * widths / 24.0  # where bins are fine
    for k in range(0, NUM_PLACES, PER_OCTAVE):  # whose numbers of bins are alike
        if widths[k] >= 1.0 / _FINE:
            errors[k : k + PER_OCTAVE] = _in_bins(widths[k : k + PER_OCTAVE])
    return np.stack([variances, errors])
