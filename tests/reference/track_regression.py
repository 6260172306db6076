"""Plain twins of kernels of track coding by regression, written from docs/tracks.md."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def regularised_least_squares(
    features: Floats, positions: Floats, prior: Floats, noise: float
) -> tuple[Floats, Floats]:
    """Return coefficients of least squares with a prior of mean 0, and their covariance, all at once."""
    information = features.T @ features / noise + np.diag(1.0 / prior)
    covariance: Floats = np.linalg.inv(information)
    coefficients: Floats = covariance @ features.T @ positions / noise
    return coefficients, covariance


def nearest_before(first: Floats, i: int, reach: float) -> list[tuple[int, float]]:
    """Return the at most eight tracks before one that begin nearest to it, with their weights."""
    squares = [float(((first[i] - first[j]) ** 2).sum()) for j in range(i)]
    order = sorted(range(i), key=lambda j: (squares[j], j))[:8]
    return [(j, (reach / (reach + squares[j])) ** 2) for j in order]
