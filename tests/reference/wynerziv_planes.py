"""Plain twins of quantisation into bit planes: bins found by comparison, bits by division."""

from collections.abc import Sequence

import numpy as np


def find_bin(coefficient: float, edges: Sequence[float]) -> int:
    """Return the bin whose half-open interval holds a coefficient; beyond the ends, the first or the last."""
    for number in range(len(edges) - 2):
        if coefficient < edges[number + 1]:
            return number
    return len(edges) - 2


def quantize(coefficients: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the bin of every coefficient, as `find_bin` does."""
    return np.searchsorted(edges[1:-1], coefficients, side="right")


def embedded_planes(band: int, least: float, greatest: float, step: float) -> int:
    """Return with how many of 12 planes embedded bins hold all from the least to the greatest coefficient."""
    for planes in range(12):
        origin = 0.0 if band == 0 else 4 ** ((planes + 1) // 2) / 3
        if -origin <= least / step and greatest / step < 2**planes - origin:
            return planes
    return 12


def embedded_bin(band: int, coefficient: float, step: float, planes: int) -> int:
    """Return the nested bin of a coefficient, by the formula that encoders follow to the last digit."""
    origin = 0.0 if band == 0 else 4 ** ((planes + 1) // 2) / 3
    return min(max(int(coefficient * (1.0 / step) + origin), 0), 2**planes - 1)


def binary_digits(number: int, count: int) -> list[int]:
    """Return the binary digits of a number, most significant first."""
    digits = []
    for _ in range(count):
        number, digit = divmod(number, 2)
        digits.append(digit)
    return digits[::-1]


def to_planes(bins: np.ndarray, count: int) -> np.ndarray:
    """Return the binary digits of bins, one row a plane; inverse of `from_planes`."""
    return np.array([binary_digits(number, count) for number in bins.tolist()], np.uint8).reshape(-1, count).T


def from_planes(planes: np.ndarray) -> np.ndarray:
    """Return the bins that planes spell; inverse of `to_planes`."""
    bins = np.zeros(planes.shape[1], np.int64)
    for plane in planes:
        bins = 2 * bins + plane
    return bins
