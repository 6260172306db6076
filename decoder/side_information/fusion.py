"""Fusion of several predictions of one frame, block by block, by their errors in the bands decoded so far.

The errors of predictions from the same references resemble each other, so the weights of the best linear
mean follow from the whole matrix of their second moments, not from each error alone.

References
----------
[BatesGranger1969] J. M. Bates, C. W. J. Granger, "The combination of forecasts", Operational Research
Quarterly 20(4), 1969.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from decoder.side_information import _kernels

Array = NDArray[np.float64]

NEIGHBOURHOOD = 5
"""Side of the square of blocks whose errors are taken together."""
RIDGE = 0.3
"""Part of the mean squared error that is added to that of each hypothesis, as if it were independent."""
LEAST_MOMENT = 0.02
"""Added to every squared error, relative to that of the best hypothesis over the frame."""
ROUNDING = 1.0
"""Squared error of a coefficient that rounding alone makes."""


def fuse(hypotheses: Array, decoded: Mapping[int, Array]) -> tuple[Array, Array]:
    """Fuse predictions of a frame.

    Parameters
    ----------
    hypotheses : ndarray of shape (N, bands, rows, columns), float64
        Transforms of the predictions.
    decoded : mapping of int to ndarray of shape (rows, columns), float64
        Coefficients of the bands decoded so far, at least one.

    Returns
    -------
    fused : ndarray of shape (bands, rows, columns), float64
        Transform of the fused prediction.
    spread : ndarray of shape (bands, rows, columns), float64
        Weighted standard deviation of the hypotheses around it.
    """
    count, _, rows, columns = hypotheses.shape
    moments = np.zeros((count, count, rows, columns))
    for band, coefficients in decoded.items():
        errors = hypotheses[:, band] - coefficients
        usual = float(np.mean(np.abs(errors).min(axis=0))) ** 2 + ROUNDING
        moments += errors[:, None] * errors[None] / usual
    side = NEIGHBOURHOOD
    local = uniform_filter(moments / len(decoded), (1, 1, side, side), mode="nearest")
    weights = np.empty((count, rows, columns))
    _kernels.fusion_weights(local, RIDGE, LEAST_MOMENT, weights)
    fused = np.zeros(hypotheses.shape[1:])
    for hypothesis, weight in zip(hypotheses, weights, strict=True):
        fused += weight * hypothesis
    variance = np.zeros_like(fused)
    for hypothesis, weight in zip(hypotheses, weights, strict=True):
        variance += weight * (hypothesis - fused) ** 2
    return fused, np.sqrt(variance)
