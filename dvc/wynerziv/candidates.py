"""Among which numbers of a band those of its coefficients are likely to be, by the correlation noise."""

import math

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.ldpc.belief_propagation import NumberPriors
from dvc.wynerziv.noise import OUTLIER_PROBABILITY

Array = NDArray[np.float64]

_REACH = 11.5
"""Reach of the candidates about a prediction, in scales: beyond is 1e-5 of a Laplacian."""
_MAX_REACH = 31
"""The same in bins: what is farther away is an outlier."""
CREDIBLE = 0.9
"""Probability of an interval that serves where numbers are not known."""


def number_priors(
    edges: Array, planes: int, depth: int, side_information: Array, scale: Array
) -> NumberPriors:
    """Return where the numbers are likely to be that the first planes of a band spell."""
    from dvc.wynerziv import _kernels

    borders = np.ascontiguousarray(edges[:: 1 << (planes - depth)])
    width = float(borders[1] - borders[0])
    reach = int(min(math.ceil(_REACH * float(scale.max()) / width), _MAX_REACH))
    bins = np.empty((2, scale.size), np.int64)
    probabilities = np.zeros((scale.size, min(2 * reach + 1, 1 << depth)), np.float32)
    _kernels.candidates(
        borders,
        side_information,
        scale,
        _REACH,
        reach,
        1.0 - OUTLIER_PROBABILITY,
        bins,
        probabilities,
    )
    return NumberPriors(depth, bins[0], bins[1], probabilities, OUTLIER_PROBABILITY)


def credible_intervals(
    edges: Array, planes: int, priors: NumberPriors, believed: NDArray[np.float32]
) -> tuple[Array, Array]:
    """Return between which borders coefficients are likely to be, where no number is certain."""
    borders = edges[:: 1 << (planes - priors.depth)]
    sums = np.cumsum(believed, axis=1, dtype=np.float64)
    tail = 0.5 * (1.0 - CREDIBLE)
    first = (sums <= tail).sum(axis=1)
    last = (sums < 1.0 - tail).sum(axis=1)
    most = priors.counts - 1
    first, last = np.minimum(first, most), np.minimum(last, most)
    return borders[priors.lowest + first], borders[priors.lowest + last + 1]
