"""Plain twins of kernels of track coding by regression, written from docs/spec/tracks.md."""

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


def spread_order(count: int) -> list[int]:
    """Return numbers by their binary digits in reverse."""
    digits = max((count - 1).bit_length(), 1)
    return sorted(range(count), key=lambda k: int(f"{k:0{digits}b}"[::-1], 2))


def unguarded_cells(
    shape: tuple[int, int], taken: NDArray[np.int64], guard: int, cell: int
) -> NDArray[np.bool_]:
    """Return which cells, of a size in units, are no nearer than `guard` units to any of some positions."""
    corners = cell * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    squares = ((corners[:, :, None] - taken) ** 2).sum(axis=-1)
    free: NDArray[np.bool_] = (squares >= guard**2).all(axis=-1)
    return free


def num_within(points: list[tuple[int, int]], cell: tuple[int, int], reach: int) -> int:
    """Return how many points are no farther from a cell."""
    return sum((x - cell[0]) ** 2 + (y - cell[1]) ** 2 <= reach**2 for x, y in points)
