"""Correlation noise between a Wyner-Ziv frame and its side information: a Laplacian per coefficient.

The scale ``b`` of a Laplacian with density exp(-|x - y| / b) / (2 b) is the mean absolute error. Decoders
estimate it: first from the difference of the two motion-compensated references (the *online* models of
[Brites2008] at frame, band and coefficient level, or the local model that is the default here), then from the
true intervals of the bands and bit planes decoded so far. Means are those of [Kubasov2007], Eq. (6).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from dvc.wynerziv import _kernels
from dvc.wynerziv.quantizer import power_of_two

Array = NDArray[np.float64]

MIN_SCALE = 0.3
"""Smallest scale: the rounding of samples has about this error."""
FLAT = 4.0
"""Magnitude of the detail that counts as none."""
OUTLIER_PROBABILITY = 2e-4
"""Share of a uniform distribution mixed into the Laplacian: side information has outliers."""
GAINS_PER_OCTAVE = 3
GAINS = np.array([power_of_two(6 * third // GAINS_PER_OCTAVE) for third in range(-6, 16)])
"""Factors tried when a scale is fitted to decoded intervals."""


def _frame_scale(residual: Array) -> Array:
    """One scale for all coefficients of all bands: [Brites2008] Eq. (9), with the variance over all bands."""
    return np.full(residual.shape, max(float(np.sqrt(np.mean(residual**2) / 2.0)), MIN_SCALE))


def _band_scale(residual: Array) -> Array:
    """One scale per band: [Brites2008] Eqs. (11), (12)."""
    scale = np.sqrt(np.mean(residual**2, axis=(1, 2), keepdims=True) / 2.0)
    return np.broadcast_to(np.maximum(scale, MIN_SCALE), residual.shape).copy()


def _coefficient_scale(residual: Array) -> Array:
    """A block with an unusual residual gets its own scale, the rest that of the band: Eqs. (13)-(16)."""
    magnitude = np.abs(residual)
    variance = np.mean(residual**2, axis=(1, 2), keepdims=True)
    distance = (magnitude - magnitude.mean(axis=(1, 2), keepdims=True)) ** 2
    scale = np.sqrt(np.maximum(distance, variance) / 2.0)
    bounded: Array = np.maximum(scale, MIN_SCALE)
    return bounded


def _local_scale(residual: Array) -> Array:
    """Mix the band's, the neighbourhood's and the coefficient's own residual."""
    magnitude: Array = np.abs(residual)
    neighbourhood: Array = uniform_filter(magnitude, size=(1, 3, 3), mode="nearest")
    band: Array = magnitude.mean(axis=(1, 2), keepdims=True)
    return MIN_SCALE + 0.3 * band + 0.5 * neighbourhood + 0.3 * magnitude


MODELS: dict[str, Callable[[Array], Array]] = {
    "frame": _frame_scale,
    "band": _band_scale,
    "coefficient": _coefficient_scale,
    "local": _local_scale,
}
"""Models by their names in the configuration. Each maps the residual (bands, rows, columns), the transform of
half the difference of the compensated references, to the scale of each coefficient."""


def texture(bands: Array, band: int) -> Array:
    """Measure the detail of the prediction: errors are larger if it has more."""
    detail: Array = FLAT + np.abs(bands[1:]).sum(axis=0) / (len(bands) - 1)
    return detail if band == 0 else detail + np.abs(bands[band])


def shaped(scale: Array, texture: Array, expected_error: Array | None) -> Array:
    """Distribute the scales of a band by further evidence of errors; their mean stays."""
    # Roots of roots: powers of libraries differ between processors.
    shape = scale * np.sqrt(np.sqrt(texture / np.sqrt(scale)))
    if expected_error is not None:
        shape = shape * np.sqrt(expected_error / np.sqrt(scale))
    bounded: Array = np.maximum(shape * (scale.mean() / shape.mean()), MIN_SCALE)
    return bounded


def bit_llr(lower: Array, middle: Array, upper: Array, side_information: Array, scale: Array) -> Array:
    """Return log P(0) / P(1) of the next bit, which is 1 if x lies above `middle`."""
    llr = np.empty_like(lower)
    _kernels.bit_llr(lower, middle, upper, side_information, scale, OUTLIER_PROBABILITY, llr)
    return llr


def fit_gain(
    lower: Array, upper: Array, side_information: Array, scale: Array, expected: float, strength: float = 40.0
) -> float:
    """Fit one factor on the scales to the intervals decoded so far, by maximum a-posteriori likelihood."""
    scores = np.empty(GAINS.size)
    _kernels.log_likelihoods(
        lower, upper, side_information, scale, GAINS, GAINS_PER_OCTAVE, OUTLIER_PROBABILITY, scores
    )
    for number, gain in enumerate(GAINS):
        scores[number] -= strength * _kernels.logarithm(gain / expected) ** 2
    return float(GAINS[int(np.argmax(scores))])


def conditional_mean(lower: Array, upper: Array, side_information: Array, scale: Array) -> Array:
    """Return E[x | lower <= x < upper, y] under a Laplacian about y."""
    mean = np.empty_like(lower)
    flat = (array.reshape(-1) for array in (lower, upper, side_information, scale, mean))
    _kernels.conditional_mean(*flat)
    return mean


REFINEMENT_OUTLIER_PROBABILITY = 5e-6
"""Share of a uniform distribution mixed into the Laplacian to forecast gains; the 2e-4 of priors
takes 1.4 % more rate at equal PSNR, and 1e-6 .1 % (box, desk, river, stone, street, tree; QP 28, 36)."""


class Refinement(NamedTuple):
    """Expected cost and worth of the next planes: of one plane, of two planes, and so on."""

    bits: Array  # ideal code length; shape (depth, N)
    saved: Array  # squared error that the conditional mean loses by them; shape (depth, N)


def expected_refinement(
    prefix: NDArray[np.int64],
    missing_planes: int,
    edges: Array,
    side_information: Array,
    scale: Array,
    depth: int,
) -> Refinement:
    """Return the expected cost and savings of the next planes of coefficients of a band."""
    found = Refinement(np.zeros((depth, prefix.size)), np.zeros((depth, prefix.size)))
    _kernels.refinement(
        prefix, missing_planes, edges, side_information, scale, REFINEMENT_OUTLIER_PROBABILITY, *found
    )
    return found
