"""What more bit planes of a band are worth, before they are asked for, as the correlation noise has it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.wynerziv.noise import OUTLIER_PROBABILITY

Array = NDArray[np.float64]

NUM_SAMPLES = 1500
"""Coefficients of a band that are looked at, at least, where it has more: every so many, an odd number."""
PARTS = 2**20
"""Entropies and errors are rounded, coefficient by coefficient, to this part of a bit and a squared unit."""


class Refinement(NamedTuple):
    """Expected cost and worth of the next planes of a band: one plane, two planes, and so on."""

    bits: Array  # ideal code length; shape (depth,)
    saved: Array  # squared error that the conditional mean loses by them; shape (depth,)


def expected_refinement(
    prefix: NDArray[np.int64],
    missing_planes: int,
    edges: Array,
    side_information: Array,
    scale: Array,
    depth: int,
) -> Refinement:
    """Return what the next planes of a band are expected to cost and to save."""
    from dvc.wynerziv import _kernels

    # Odd, and so, most often, without a divisor in common with the columns of a frame.
    step = (prefix.size // NUM_SAMPLES - 1) | 1 if prefix.size > NUM_SAMPLES else 1
    sample, predicted, spread = (
        np.ascontiguousarray(values[::step]) for values in (prefix, side_information, scale)
    )
    sums = np.zeros((2, depth), np.int64)
    _kernels.refinement(
        sample, missing_planes, edges, predicted, spread, OUTLIER_PROBABILITY, float(PARTS), sums
    )
    return Refinement(*sums * (prefix.size / sample.size / PARTS))
