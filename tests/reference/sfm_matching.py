"""Plain twins of the loops of features and matching: every pair in full."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Samples = NDArray[np.uint8]


def suppression_radii(points: Indices, strength: Floats, robustness: float) -> list[int]:
    """Return the squared distance of each maximum to the nearest clearly stronger one."""
    radii = []
    for point, own in zip(points, strength, strict=True):
        stronger = points[robustness * strength > own]
        radii.append(int(((stronger - point) ** 2).sum(axis=1).min()) if len(stronger) else 1 << 40)
    return radii


def parzen_histogram(values: Floats, bin_width: float, num_bins: int) -> Floats:
    """Return sums of triangular windows, one bin wide to each side, at the bin centres."""
    centres = bin_width * (np.arange(num_bins) - 0.5 * (num_bins - 1))
    inside = np.clip(values, centres[0], centres[-1])
    return np.maximum(1.0 - np.abs(inside[:, None] - centres) / bin_width, 0.0).sum(axis=0)


def chi_square(a: Floats, b: Floats) -> float:
    """Return half the sum of (a - b)^2 / (a + b) over the bins that are not empty."""
    used = a + b > 0
    return 0.5 * float(((a - b)[used] ** 2 / (a + b)[used]).sum())


def best_candidates(
    corners_a: Floats,
    corners_b: Floats,
    max_motion_px: float,
    patches: tuple[Samples, Samples],
    means: tuple[Floats, Floats],
    histograms: tuple[Floats, Floats],
    max_brightness_change: float,
    max_chi_square: float,
    limits: Floats,
    count: int,
) -> tuple[list[list[int]], list[list[float]]]:
    """Return the corners of b that pass all tests, most similar first, and their squared differences."""
    chosen, errors = [], []
    deviations = [samples - mean[:, None] for samples, mean in zip(patches, means, strict=True)]
    for i, corner in enumerate(corners_a):
        near = np.sqrt(((corners_b - corner) ** 2).sum(axis=1)) <= max_motion_px
        bright = np.abs(means[1] - means[0][i]) <= max_brightness_change
        alike = np.array([chi_square(histograms[0][i], h) <= max_chi_square for h in histograms[1]])
        error = ((deviations[1] - deviations[0][i]) ** 2).sum(axis=1)
        passed = np.flatnonzero(near & bright & alike & (error <= limits[i]))
        best = passed[np.argsort(error[passed], kind="stable")][:count]
        chosen.append(best.tolist())
        errors.append(error[best].tolist())
    return chosen, errors


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the least value that, with those below it, has half the weight."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, 0.5 * summed[-1] * (1 - 1e-9))])
