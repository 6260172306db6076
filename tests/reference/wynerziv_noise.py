"""Plain twins of the correlation noise model and of reconstruction: SciPy's distribution and quadrature."""

import math

from scipy import stats
from scipy.integrate import quad


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
