"""Scalar quantisers of the bands: uniform for DC, uniform with a doubled zero bin for AC.

A band with ``levels`` = 2^m levels makes m bit planes. DC has ``levels`` bins on [0, 1024). AC has
``levels - 1`` bins, symmetric about zero: the zero bin is (-step, step), the others are one step wide and the
outermost ends at ``levels / 2`` steps. The step follows from the band's largest magnitude in the frame and is
sent as an index on a logarithmic scale.
"""

import math

import numpy as np
from numpy.typing import NDArray

DC_RANGE = 1024.0
STEP_INDEX_BITS = 6
_STEPS_PER_OCTAVE = 6
_MAX_STEP_INDEX = (1 << STEP_INDEX_BITS) - 1


def step_from_index(index: int) -> float:
    """Return the AC step that an index stands for; inverse of `step_index`.

    Parameters
    ----------
    index : int
        What the stream carries, in [0, 63].

    Returns
    -------
    float
        Step in coefficient units, 1 to 1448.
    """
    return float(2.0 ** (index / _STEPS_PER_OCTAVE))


def step_index(coefficients: NDArray[np.float64], levels: int) -> int:
    """Return the index of the step of an AC band: 2 |x|max / (levels - 1), as in DISCOVER, rounded up.

    Parameters
    ----------
    coefficients : ndarray, float64
        The band.
    levels : int
        Levels of its quantiser, at least 2.

    Returns
    -------
    int
        Index for `step_from_index`.
    """
    max_magnitude = float(np.abs(coefficients).max(initial=0.0))
    needed = max(2.0 * max_magnitude / (levels - 1), 1.0)
    index = math.ceil(_STEPS_PER_OCTAVE * math.log2(needed) - 1e-9)
    return min(index, _MAX_STEP_INDEX)


def bin_edges(levels: int, step: float | None) -> NDArray[np.float64]:
    """Return the borders of the bins, in increasing order.

    Parameters
    ----------
    levels : int
        A power of two, at least 2.
    step : float or None
        Step of an AC band; None for DC.

    Returns
    -------
    ndarray of shape (num_bins + 1,), float64
        ``num_bins`` is ``levels`` for DC, ``levels - 1`` for AC.
    """
    if step is None:
        return np.arange(levels + 1, dtype=np.float64) * (DC_RANGE / levels)
    positive = np.arange(1, levels // 2 + 1) * step
    edges: NDArray[np.float64] = np.concatenate([-positive[::-1], positive])
    return edges
