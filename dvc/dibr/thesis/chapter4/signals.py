"""Figure 4.3: a signal of constant, linear and cubic pieces, and its high bands by both transforms."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.wavelets import lifting, shape_adaptive
from dvc.dibr.wavelets.edge_maps import EdgeMaps

Samples = NDArray[np.float64]

NUM_SAMPLES = 320
NUM_LEVELS = 5
ORDER = 3
EDGES = 79, 160, 241
"""Last sample before each edge, odd and even ones."""


class SignalBands(NamedTuple):
    """A signal and its coefficients.

    Attributes
    ----------
    signal : ndarray of shape (n,), float64
        Samples.
    standard, shape_adaptive : list of ndarray of shape (n / 2^j,), float64
        High bands, the finest first, by the 9/7 with symmetric extension, and with cubic extension at edges.
    """

    signal: Samples
    standard: list[Samples]
    shape_adaptive: list[Samples]


def piecewise_signal() -> Samples:
    """Return a signal of constant, linear, cubic and again constant pieces.

    Returns
    -------
    ndarray of shape (320,), float64
        From 0 to 1.
    """
    t = np.linspace(0.0, 1.0, NUM_SAMPLES)
    pieces = (
        np.full_like(t, 0.25),
        0.9 - 1.4 * (t - 0.25),
        0.45 + 60.0 * (t - 0.53) * (t - 0.63) * (t - 0.73) * 4.0,
        np.full_like(t, 0.75),
    )
    return np.asarray(np.select([np.arange(NUM_SAMPLES) <= edge for edge in EDGES], pieces[:-1], pieces[-1]))


def signal_bands() -> SignalBands:
    """Transform the signal by both.

    Returns
    -------
    SignalBands
        High bands.
    """
    column = piecewise_signal()[:, np.newaxis]
    below = np.zeros(column.shape, np.uint8)
    below[list(EDGES)] = 1
    edges = EdgeMaps(below, np.zeros_like(below))
    found = [
        [details.vertical[:, 0] for details in pyramid.details]
        for pyramid in (
            lifting.analyse(column, NUM_LEVELS),
            shape_adaptive.analyse(column, edges, NUM_LEVELS, ORDER),
        )
    ]
    return SignalBands(column[:, 0], *found)


def largest_high(bands: list[Samples]) -> list[float]:
    """Return the largest coefficient of each band.

    Parameters
    ----------
    bands : list of ndarray
        High bands.

    Returns
    -------
    list of float
        Absolute values.
    """
    return [float(np.abs(band).max()) for band in bands]
