"""Plain twins of Wyner-Ziv coding by definition: its transform, bit planes, noise model and priors."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.integrate import quad

from dvc.slepian_wolf import NeighbourCoupling

Array = NDArray[np.float64]
MAX_SPREAD = 2.0
CORE = np.array([[1, 1, 1, 1], [2, 1, -1, -2], [1, -1, -1, 1], [1, -2, 2, -1]])
BASIS = CORE / np.sqrt((CORE**2).sum(axis=1, keepdims=True))
"""Rows are the orthonormal basis vectors."""
ZIGZAG_RANK = np.array([[0, 1, 5, 6], [2, 4, 7, 12], [3, 8, 11, 13], [9, 10, 14, 15]])
"""Position of each coefficient in zigzag order, as H.264 draws it."""


def forward(luma: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the bands of a frame whose sides are multiples of 4, shape (16, rows, columns)."""
    rows, columns = luma.shape[0] // 4, luma.shape[1] // 4
    bands = np.empty((16, rows, columns))
    for i in range(rows):
        for j in range(columns):
            block = luma[4 * i : 4 * i + 4, 4 * j : 4 * j + 4].astype(np.float64)
            coefficients = BASIS @ block @ BASIS.T
            for y in range(4):
                for x in range(4):
                    bands[ZIGZAG_RANK[y, x], i, j] = coefficients[y, x]
    return bands


def inverse(bands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the frame of such bands."""
    rows, columns = bands.shape[1:]
    luma = np.empty((4 * rows, 4 * columns))
    for i in range(rows):
        for j in range(columns):
            coefficients = np.array([[bands[ZIGZAG_RANK[y, x], i, j] for x in range(4)] for y in range(4)])
            luma[4 * i : 4 * i + 4, 4 * j : 4 * j + 4] = BASIS.T @ coefficients @ BASIS
    return luma


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


def interval_probability(lower: float, upper: float, side_information: float, scale: float) -> float:
    """Return P(lower <= X < upper) of a Laplacian about the side information, without cancellation."""
    law = stats.laplace(side_information, scale)
    if lower > side_information:
        return float(law.sf(lower) - law.sf(upper))
    return float(law.cdf(upper) - law.cdf(lower))


def conditional_mean(lower: float, upper: float, side_information: float, scale: float) -> float:
    """Return E[X | lower <= X < upper] by quadrature; the density is scaled to 1 at its peak in the bin."""
    peak = min(max(side_information, lower), upper)

    def density(x: float) -> float:
        return math.exp((abs(peak - side_information) - abs(x - side_information)) / scale)

    low, high = max(lower, peak - 60 * scale), min(upper, peak + 60 * scale)
    if low == high:
        return low
    points = [peak] if low < peak < high else None
    mass, _ = quad(density, low, high, points=points, epsabs=0, epsrel=1e-10)
    offset, _ = quad(lambda x: (x - peak) * density(x), low, high, points=points, epsabs=1e-12 * scale * mass)
    return peak + offset / mass


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
