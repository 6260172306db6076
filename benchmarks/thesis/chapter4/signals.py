"""Figure 4.3: a signal of constant, linear and cubic pieces, and its high bands by both transforms."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.images.wavelets.edge_maps import EdgeMaps
from dvc.images.wavelets.lifting import Transform

Samples = NDArray[np.float64]

NUM_SAMPLES = 320
NUM_LEVELS = 5
ORDER = 3
EDGES = 79, 160, 241
"""Last sample before each edge, odd and even ones."""


class SignalBands(NamedTuple):
    """A signal and its coefficients."""

    signal: Samples  # samples
    # high bands, the finest first, by the 9/7 with symmetric extension, and with cubic extension at edges
    standard: list[Samples]
    shape_adaptive: list[Samples]


def piecewise_signal() -> Samples:
    """Return a signal of constant, linear, cubic and again constant pieces."""
    t = np.linspace(0.0, 1.0, NUM_SAMPLES)
    pieces = (
        np.full_like(t, 0.25),
        0.9 - 1.4 * (t - 0.25),
        0.45 + 60.0 * (t - 0.53) * (t - 0.63) * (t - 0.73) * 4.0,
        np.full_like(t, 0.75),
    )
    return np.asarray(np.select([np.arange(NUM_SAMPLES) <= edge for edge in EDGES], pieces[:-1], pieces[-1]))


def signal_bands() -> SignalBands:
    """Transform the signal by both."""
    column = piecewise_signal()[:, np.newaxis]
    below = np.zeros(column.shape, np.uint8)
    below[list(EDGES)] = 1
    edges = EdgeMaps(below, np.zeros_like(below))
    found = [
        [details.vertical[:, 0] for details in pyramid.details]
        for pyramid in (
            Transform(NUM_LEVELS).analyse(column),
            Transform(NUM_LEVELS, edges=edges, order=ORDER).analyse(column),
        )
    ]
    return SignalBands(column[:, 0], *found)


def largest_high(bands: list[Samples]) -> list[float]:
    """Return the largest coefficient of each band."""
    return [float(np.abs(band).max()) for band in bands]
