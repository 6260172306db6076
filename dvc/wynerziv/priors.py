"""Priors of bit planes that learn from decoded planes: corrected LLRs, and the influence of neighbours.

The correlation noise is neither exactly Laplacian nor independent from block to block. The LLR of a bit is
corrected by a few weighted terms: the LLR of the Laplacian, the same with saturation, the errors of blocks
around, and the effect of wider noise if errors, predictions and scales are larger than usual. While a plane
is decoded, errors of the neighbours in the same plane add information; their weights are learned as well,
from complete planes. Both are logistic regressions. Their weights start from those of usual frames, found by
`benchmarks.searches.priors`, and follow the decoded bits.
"""
# mypy: allow-untyped-defs, no-check-untyped-defs

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from dvc._jit import kernel
from dvc.config import ZIGZAG
from dvc.slepian_wolf import NeighbourCoupling
from dvc.wynerziv import noise
from dvc.wynerziv._kernels import exponential

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]

MAX_INPUT = 12.0
"""Bound on the magnitude of all terms of an LLR."""
MAX_SPREAD = 2.0
"""Bound on the excess energies of the neighbours together."""
SHIFT = 0.5
"""Shift of the prediction in both directions, in scales, for the slope of an LLR."""
WIDENING = 1.3
"""Factor on the scale in both directions, for the derivative with respect to the scale."""
WIDE = 7
"""Side of the square of blocks with errors that predict that of the middle one."""
MAX_SHIFT = 3.0
"""Bound on the mean error of these, in scales."""
LEAST_ERROR, LEAST_MAGNITUDE = 0.1, 2.0
"""Added to errors, in scales, and to magnitudes of predictions, before they are compared with their means."""
STEPS = 2
"""Newton steps for every plane."""
MEMORY = 0.95
"""Share of the precision of weights that is kept from plane to plane."""
PRECISION = 3000.0
"""Precision of each weight before anything is decoded."""


@dataclass
class _Weights:
    """Weights of terms of a logistic regression, and how well they are known."""

    values: Array
    least: Array
    most: Array
    precision: Array

    @classmethod
    def of(cls, values: tuple[float, ...], least: tuple[float, ...], most: tuple[float, ...]) -> "_Weights":
        return cls(np.array(values), np.array(least), np.array(most), PRECISION * np.eye(len(values)))

    @classmethod
    def mean(cls, several: Sequence["_Weights"]) -> "_Weights":
        values, precision = several[0].values.copy(), several[0].precision.copy()
        for other in several[1:]:
            values += other.values
            precision += other.precision
        return cls(values / len(several), several[0].least, several[0].most, precision / len(several))

    def learn(self, inputs: Array, offset: Array, bits: Bits) -> None:
        self.precision *= MEMORY
        bounds = self.least, self.most
        _fit_logistic(inputs, offset, 1.0 - bits, *bounds, STEPS, self.values, self.precision)


WEIGHTS = (
    (0.8, 0.58, -0.11, 0.0, -0.02, 0.24, 0.98, 0.03, -0.22, 0.55),
    (0.77, 0.08, 0.35, 0.0, 0.3, -0.28, 0.61, 0.06, -0.5, -0.63),
    (1.07, 0.2, -0.13, 0.13, 0.18, 0.54, 0.25, -0.02, -0.07, -0.3),
    (1.1, -0.17, -0.12, -0.01, -0.27, 0.23, 0.33, 0.11, -0.14, -0.38),
    (1.07, 0.37, -0.16, 0.08, -0.17, 0.3, -0.05, 0.46, -0.2, -0.35),
)
"""Weights of the terms of an LLR in usual frames, by class of planes."""
LEAST_WEIGHTS = 0.3, -4.0, -2.0, -1.0, -2.0, *5 * (-3.0,)
MOST_WEIGHTS = 2.5, 2.5, 3.0, 1.5, 2.0, *5 * (3.0,)
COUPLINGS = (0.33, 0.0, 0.05), (0.33, 0.0, 0.05), (0.25, 0.0, 0.02), (0.22, 0.03, 0.03), (0.25, 0.05, 0.04)
"""Weights of neighbours along and across the edges of a band's pattern, and of their excess energy."""
LEAST_COUPLING, MOST_COUPLING = (-0.2, -0.5, -0.1), (0.8, 0.8, 0.3)


@dataclass(frozen=True)
class PlanePrior:
    """Prior of the bits of a plane."""

    llr: Array  # LLR log p(0) / p(1) of each bit; shape (N,)
    coupling: NeighbourCoupling  # how bits depend on their neighbours
    position: tuple[int, int]  # the band, and which of its planes
    inputs: Array  # terms of the LLR; shape (terms, N)


class LearnedPriors:
    """Priors of the planes of a group of pictures, one after the other as they are decoded."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._alone = [_Weights.of(values, LEAST_WEIGHTS, MOST_WEIGHTS) for values in WEIGHTS]
        self._coupled = [_Weights.of(values, LEAST_COUPLING, MOST_COUPLING) for values in COUPLINGS]

    @classmethod
    def mean(cls, several: Sequence["LearnedPriors"]) -> "LearnedPriors":
        """Return the mean of priors that were learned in parallel."""
        together = cls(several[0]._shape)
        together._alone = list(map(_Weights.mean, zip(*(p._alone for p in several), strict=True)))
        together._coupled = list(map(_Weights.mean, zip(*(p._coupled for p in several), strict=True)))
        return together

    def plane(
        self,
        position: tuple[int, int],
        borders: tuple[Array, Array, Array],
        side_information: Array,
        scale: Array,
        dc_error: Array | None,
        blocks: NDArray[np.int64],
    ) -> PlanePrior:
        """Return the prior of the next plane of a band in some blocks."""
        band, number = position[0], _class_of(*position)
        lower, middle, upper = borders
        shape = self._shape

        def llr_by(predicted: Array, scale: Array) -> Array:
            return _bounded(noise.bit_llr(*borders, predicted, scale))

        # LLRs by the noise model only, their slope by predictions, and their change if scales grow.
        llr, shift = llr_by(side_information, scale), SHIFT * scale
        slope = (llr_by(side_information + shift, scale) - llr_by(side_information - shift, scale)) / (
            2.0 * shift
        )
        widening = llr_by(side_information, scale * WIDENING) - llr_by(side_information, scale / WIDENING)
        # The expected errors of predictions, by the planes before, and of those around them.
        error = noise.conditional_mean(lower, upper, side_information, scale) - side_information
        error, scales = error.reshape(shape), scale.reshape(shape)
        wide = uniform_filter(np.stack([error, np.abs(error)]), (1, WIDE, WIDE), mode="nearest")
        shift, spread = wide.reshape(2, -1)
        around = uniform_filter(scales, 3, mode="nearest").ravel()
        neighbours = (9.0 * uniform_filter(error, 3, mode="nearest") - error) / 8.0  # mean of all eight
        ramp = np.zeros(shape) if dc_error is None else _ramp(dc_error, band)
        terms = (
            llr,
            llr / (1.0 + np.abs(llr)),
            slope * neighbours.ravel(),
            slope * ramp.ravel(),
            slope * np.clip(shift, -MAX_SHIFT * scale, MAX_SHIFT * scale),
            widening,
            widening * _excess(spread / scale + LEAST_ERROR),
            widening * _excess(np.abs(side_information) + LEAST_MAGNITUDE),
            widening * _excess(scale),
            widening * (2.0 * (around - scale) / (around + scale)),
        )
        inputs = _bounded(np.stack(terms))
        corrected = np.zeros_like(llr)
        for weight, term in zip(self._alone[number].values, inputs, strict=True):
            corrected += weight * term
        jump = noise.conditional_mean(middle, upper, side_information, scale)
        jump -= noise.conditional_mean(lower, middle, side_information, scale)
        along, across, spread = self._coupled[number].values
        vertical, horizontal = _orientation(band)
        corrected = _bounded(corrected)
        coupling = NeighbourCoupling(
            corrected.reshape(shape),
            jump.reshape(shape),
            slope.reshape(shape),
            ((jump / scale) ** 2).reshape(shape),
            widening.reshape(shape),
            np.tile([along if horizontal else across, along if vertical else across, spread], (shape[0], 1)),
            blocks,
        )
        return PlanePrior(corrected[blocks], coupling, position, inputs.take(blocks, 1))

    def learn(self, prior: PlanePrior, bits: Bits) -> None:
        """Learn from bits that are decoded."""
        number = _class_of(*prior.position)
        self._alone[number].learn(prior.inputs, np.zeros_like(prior.llr), bits)
        self._coupled[number].learn(_coupled_inputs(prior, bits), prior.llr, bits)


def _class_of(band: int, plane: int) -> int:
    """Return which weights a plane has; before the first one of DC the scale is a guess."""
    if band == 0:
        return min(plane, 1)
    return 2 if band < 3 else 3 if band < 6 else 4


def _bounded(term: Array) -> Array:
    clipped: Array = np.clip(term, -MAX_INPUT, MAX_INPUT)
    return clipped


def _excess(values: Array) -> Array:
    """Compare with the mean: about the logarithm of the ratio, and at most 2."""
    mean = float(values.mean())
    ratio: Array = 2.0 * (values - mean) / (values + mean)
    return ratio


def _orientation(band: int) -> tuple[bool, bool]:
    """Return whether neighbours above and below, and at the sides, lie along the edges of a band."""
    vertical, horizontal = divmod(ZIGZAG[band], 4)
    return horizontal >= vertical, vertical >= horizontal


def _ramp(dc_error: Array, band: int) -> Array:
    """Return the decrease of DC errors across a block, for bands with patterns of rows or columns only."""
    vertical, horizontal = divmod(ZIGZAG[band], 4)
    padded = np.pad(dc_error, 1, mode="edge")
    if vertical == 0 and horizontal > 0:
        return padded[1:-1, :-2] - padded[1:-1, 2:]
    if horizontal == 0 and vertical > 0:
        return padded[:-2, 1:-1] - padded[2:, 1:-1]
    return np.zeros_like(dc_error)


def _coupled_inputs(prior: PlanePrior, bits: Bits) -> Array:
    """Return the influence of neighbours along and across, and of their excess energy, for known bits."""
    coupling = prior.coupling
    deviation = coupling.deviation(bits)
    shift = np.pad(coupling.shift * deviation, 1)
    sides, ends = shift[1:-1, :-2] + shift[1:-1, 2:], shift[:-2, 1:-1] + shift[2:, 1:-1]
    excess = np.pad(coupling.excess_energy * deviation, 1)
    spread = excess[1:-1, :-2] + excess[1:-1, 2:] + excess[:-2, 1:-1] + excess[2:, 1:-1]
    vertical, horizontal = _orientation(prior.position[0])
    along = sides * horizontal + ends * vertical
    across = sides * (not horizontal) + ends * (not vertical)
    terms = (
        coupling.slope * along,
        coupling.slope * across,
        coupling.widening * np.clip(spread, -MAX_SPREAD, MAX_SPREAD),
    )
    return _bounded(np.stack(terms).reshape(3, -1).take(coupling.places, 1))


@kernel
def _solve_positive(matrix, vector):
    """Solve for the vector in place, by elimination; a positive definite matrix, lost."""
    size = vector.size
    for k in range(size):
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for m in range(k, size):
                matrix[i, m] -= factor * matrix[k, m]
            vector[i] -= factor * vector[k]
    for k in range(size - 1, -1, -1):
        for m in range(k + 1, size):
            vector[k] -= matrix[k, m] * vector[m]
        vector[k] /= matrix[k, k]


@kernel
def _fit_logistic(inputs, offset, is_zero, least, most, steps, weights, precision):
    """Update weights (K,) and their precision (K, K) by bits with LLRs ``offset + weights @ inputs``."""
    before, count = weights.copy(), weights.size
    known = precision.copy()
    for _ in range(steps):
        gradient, curvature = np.zeros(count), np.zeros((count, count))
        for n in range(offset.size):
            llr = offset[n]
            for k in range(count):
                llr += weights[k] * inputs[k, n]
            power, q = exponential(-abs(llr))
            odds = power + power * q
            unlikely = odds / (1.0 + odds)
            error = (unlikely if llr < 0.0 else 1.0 - unlikely) - is_zero[n]
            spread = unlikely * (1.0 - unlikely)
            for k in range(count):
                gradient[k] += error * inputs[k, n]
                for m in range(k + 1):
                    curvature[k, m] += spread * inputs[k, n] * inputs[m, n]
        for k in range(count):
            for m in range(count):
                precision[k, m] = known[k, m] + curvature[max(k, m), min(k, m)]
                gradient[k] += known[k, m] * (weights[m] - before[m])
        _solve_positive(precision.copy(), gradient)
        for k in range(count):
            weights[k] = min(max(weights[k] - gradient[k], least[k]), most[k])
