"""Correlation noise between a Wyner-Ziv frame and its side information: a Laplacian per coefficient.

The scale ``b`` of a Laplacian with density exp(-|x - y| / b) / (2 b) is the mean absolute error. It is
estimated at the decoder alone: first from the difference of the two motion-compensated references (the
published *online* models at frame, band and coefficient level, or the local model that is the default here),
then from the bands and bit planes decoded so far, whose true interval is known.

References
----------
[Brites2008] C. Brites, F. Pereira, "Correlation noise modeling for efficient pixel and transform domain
Wyner-Ziv video coding", IEEE Trans. Circuits Syst. Video Technol. 18(9), 2008, Eqs. (9)-(16).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

Array = NDArray[np.float64]

MIN_SCALE = 0.3
"""Smallest scale: rounding of the samples alone makes about this error."""
OUTLIER_PROBABILITY = 2e-4
"""Share of a uniform distribution mixed into the Laplacian: side information has outliers."""
GAINS = 2.0 ** (np.arange(-6, 16) / 3.0)
"""Factors tried when a scale is fitted to what has been decoded."""


def frame_scale(residual: Array) -> Array:
    """Frame level: one scale for all coefficients of all bands.

    Parameters
    ----------
    residual : ndarray of shape (bands, rows, columns), float64
        Transform of half the difference of the compensated references.

    Returns
    -------
    ndarray of the same shape, float64
        Scale of each coefficient.

    References
    ----------
    [Brites2008] Eq. (9), with the variance over all bands.
    """
    return np.full(residual.shape, max(float(np.sqrt(np.mean(residual**2) / 2.0)), MIN_SCALE))


def band_scale(residual: Array) -> Array:
    """Band level: one scale per band.

    Parameters
    ----------
    residual : ndarray of shape (bands, rows, columns), float64
        Transform of half the difference of the compensated references.

    Returns
    -------
    ndarray of the same shape, float64
        Scale of each coefficient.

    References
    ----------
    [Brites2008] Eqs. (11), (12).
    """
    scale = np.sqrt(np.mean(residual**2, axis=(1, 2), keepdims=True) / 2.0)
    return np.broadcast_to(np.maximum(scale, MIN_SCALE), residual.shape).copy()


def coefficient_scale(residual: Array) -> Array:
    """Coefficient level: a block with an unusual residual gets its own scale, all others the band's.

    Parameters
    ----------
    residual : ndarray of shape (bands, rows, columns), float64
        Transform of half the difference of the compensated references.

    Returns
    -------
    ndarray of the same shape, float64
        Scale of each coefficient.

    References
    ----------
    [Brites2008] Eqs. (13)-(16).
    """
    magnitude = np.abs(residual)
    variance = np.mean(residual**2, axis=(1, 2), keepdims=True)
    distance = (magnitude - magnitude.mean(axis=(1, 2), keepdims=True)) ** 2
    scale = np.sqrt(np.maximum(distance, variance) / 2.0)
    bounded: Array = np.maximum(scale, MIN_SCALE)
    return bounded


def local_scale(residual: Array) -> Array:
    """Local level: a mixture of the band's, the neighbourhood's and the coefficient's own residual.

    Parameters
    ----------
    residual : ndarray of shape (bands, rows, columns), float64
        Transform of half the difference of the compensated references.

    Returns
    -------
    ndarray of the same shape, float64
        Scale of each coefficient.
    """
    magnitude: Array = np.abs(residual)
    neighbourhood: Array = uniform_filter(magnitude, size=(1, 3, 3), mode="nearest")
    band: Array = magnitude.mean(axis=(1, 2), keepdims=True)
    return MIN_SCALE + 0.3 * band + 0.5 * neighbourhood + 0.3 * magnitude


MODELS = {
    "frame": frame_scale,
    "band": band_scale,
    "coefficient": coefficient_scale,
    "local": local_scale,
}
"""Residual to scale, by the name that the configuration uses."""


def cumulative(distance: Array, scale: Array) -> Array:
    """Return the distribution function of a Laplacian.

    Parameters
    ----------
    distance : ndarray, float64
        x - y.
    scale : ndarray, float64
        Mean absolute error, positive; broadcast against `distance`.

    Returns
    -------
    ndarray, float64
        P(X <= x).
    """
    tail = 0.5 * np.exp(-np.abs(distance) / scale)
    return np.where(distance < 0.0, tail, 1.0 - tail)


def interval_probability(lower: Array, upper: Array, side_information: Array, scale: Array) -> Array:
    """Return the probability that a coefficient lies in an interval, exact also far out in the tails.

    Parameters
    ----------
    lower, upper : ndarray, float64
        Borders of the interval.
    side_information : ndarray, float64
        Predicted coefficient.
    scale : ndarray, float64
        Scale of the Laplacian, positive.

    Returns
    -------
    ndarray, float64
        Probability, without the outlier share.
    """
    below, above = lower - side_information, upper - side_information
    mirrored = below > 0.0
    start = np.where(mirrored, -above, below)
    stop = np.where(mirrored, -below, above)
    return np.maximum(cumulative(stop, scale) - cumulative(start, scale), 0.0)


def bit_llr(lower: Array, middle: Array, upper: Array, side_information: Array, scale: Array) -> Array:
    """Return log P(0) / P(1) of the next bit, which tells whether x lies below or above `middle`.

    Parameters
    ----------
    lower, middle, upper : ndarray, float64
        Borders of the interval known so far and where the bit splits it.
    side_information : ndarray, float64
        Predicted coefficient.
    scale : ndarray, float64
        Scale of the Laplacian, positive.

    Returns
    -------
    ndarray, float64
        Log-likelihood ratio; positive means bit 0.
    """
    zero = interval_probability(lower, middle, side_information, scale)
    one = interval_probability(middle, upper, side_information, scale)
    width = np.maximum(upper - lower, 1e-9)
    share = OUTLIER_PROBABILITY * (zero + one) + 1e-12
    return np.log(
        (zero + share * (middle - lower) / width + 1e-15) / (one + share * (upper - middle) / width + 1e-15)
    )


def fit_gain(
    lower: Array, upper: Array, side_information: Array, scale: Array, expected: float, strength: float = 40.0
) -> float:
    """Fit one factor on the scales to the intervals decoded so far, by maximum a-posteriori likelihood.

    Parameters
    ----------
    lower, upper : ndarray, float64
        Intervals that are known to hold the coefficients.
    side_information : ndarray, float64
        Predicted coefficients.
    scale : ndarray, float64
        Scales before the factor.
    expected : float
        Factor expected before looking, such as that of the band before.
    strength : float, optional
        Weight of the expectation, in nats per squared factor of e.

    Returns
    -------
    float
        One of `GAINS`, relative to nothing: multiply `scale` by it.
    """
    scores = []
    for gain in GAINS:
        probability = interval_probability(lower, upper, side_information, scale * gain)
        likelihood = float(np.log(probability * (1.0 - OUTLIER_PROBABILITY) + OUTLIER_PROBABILITY).sum())
        scores.append(likelihood - strength * float(np.log(gain / expected)) ** 2)
    return float(GAINS[int(np.argmax(scores))])
