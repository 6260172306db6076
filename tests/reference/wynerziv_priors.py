"""Learned priors of bit planes, the plain way: neighbours by loops, logistic regression by matrices."""

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import NeighbourCoupling

Array = NDArray[np.float64]
MAX_SPREAD = 2.0


def coupled_llr(coupling: NeighbourCoupling, probability: Array, causal: bool) -> Array:
    """Return LLRs on the lattice with what is believed of neighbours, or of those to the left and above."""
    base = coupling.base
    expected = 1.0 / (1.0 + np.exp(base))
    has_bit = np.isin(np.arange(base.size), coupling.places).reshape(base.shape)
    deviation = np.where(has_bit, probability - expected, 0.0)
    llr = base.copy()
    steps = [((0, -1), 0), ((-1, 0), 1), ((0, 1), 0), ((1, 0), 1)]
    for place in np.ndindex(base.shape):
        moved = spread = 0.0
        for (down, right), weight in steps[: 2 if causal else 4]:
            other = place[0] + down, place[1] + right
            if 0 <= other[0] < base.shape[0] and 0 <= other[1] < base.shape[1]:
                moved += coupling.weights[place[0], weight] * coupling.shift[other] * deviation[other]
                spread += coupling.energy[other] * (1 - 2 * expected[other]) * deviation[other]
        llr[place] += coupling.slope[place] * moved
        spread = float(np.clip(spread, -MAX_SPREAD, MAX_SPREAD))
        llr[place] += coupling.widening[place] * coupling.weights[place[0], 2] * spread
    return llr


def newton(
    inputs: Array, offset: Array, is_zero: Array, weights: Array, precision: Array, steps: int
) -> tuple[Array, Array]:
    """Return weights after Newton steps from a Gaussian prior, and their precision."""
    found, hessian = weights, precision
    for _ in range(steps):
        probability = 1.0 / (1.0 + np.exp(-(offset + found @ inputs)))
        hessian = precision + (inputs * probability * (1.0 - probability)) @ inputs.T
        gradient = inputs @ (probability - is_zero) + precision @ (found - weights)
        found = found - np.linalg.solve(hessian, gradient)
    return found, hessian
