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


def binary_digits(number: int, count: int) -> list[int]:
    """Return the binary digits of a number, most significant first."""
    digits = []
    for _ in range(count):
        number, digit = divmod(number, 2)
        digits.append(digit)
    return digits[::-1]
