"""How two curves differ: BD-rate, BD-PSNR, and the rates at which one is better."""

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from dvc.errors import RdCurveError
from dvc.rd.curves import Curve
from dvc.rd.tables import NOTHING

if TYPE_CHECKING:
    from dvc.metrics import BdResult

Measure = Literal["luma", "colour"]
"""Which PSNR is compared at: that of luma, or (6 Y + Cb + Cr) / 8."""
NO_CHROMA = "no PSNR of chroma"
MEASURES: tuple[Measure, ...] = ("luma", "colour")
NUM_SAMPLES = 2001
EQUAL_DB = 1e-6


def compare_curves(
    reference: Curve,
    other: Curve,
    of: Literal["rate", "psnr"] = "rate",
    measure: Measure = "luma",
) -> "BdResult | str":
    """Return the mean difference of a curve to another, or why there is none."""
    from dvc.metrics import bd_psnr, bd_rate

    difference = bd_rate if of == "rate" else bd_psnr
    psnrs_db = [curve.psnrs_y_db if measure == "luma" else curve.psnrs_yuv_db for curve in (reference, other)]
    if not all(psnrs_db):
        return NO_CHROMA
    try:
        return difference(reference.rates_kbps, psnrs_db[0], other.rates_kbps, psnrs_db[1])
    except RdCurveError as err:
        return str(err)


def told_measures(in_colour: bool) -> tuple[Measure, ...]:
    """Return the measures that a table has columns for."""
    return MEASURES if in_colour else MEASURES[:1]


def bd_text(difference: "BdResult | str") -> str:
    """Write a difference in rate with its overlap."""
    if difference == NO_CHROMA:
        return NOTHING
    if isinstance(difference, str):
        return f"not comparable: {difference}"
    low, high = difference.overlap
    reference, other = difference.num_points
    return f"{difference.value:+.1f} % ({low:.1f} to {high:.1f} dB, {other} and {reference} points)"


def crossings_kbps(reference: Curve, other: Curve) -> list[tuple[float, bool]]:
    """Find the rates from which one curve is better or worse than another."""
    return _pieces(*_gains(reference, other))


def crossing_text(reference: Curve, other: Curve) -> str:
    """Write where one curve is better than another."""
    samples, gains_db = _gains(reference, other)
    if not samples.size:
        single = min(len(reference.points), len(other.points)) < 2
        return "a curve of one point" if single else "no rates in common"
    if (np.abs(gains_db) <= EQUAL_DB).all():
        return "equal at all common rates"
    pieces = _pieces(samples, gains_db)
    if len(pieces) == 1:
        return f"{'better' if pieces[0][1] else 'worse'} at all common rates"
    spans = []
    for number, (rate, better) in enumerate(pieces):
        if better:
            start = f"from {rate:.0f} " if number else ""
            end = f"up to {pieces[number + 1][0]:.0f} " if number + 1 < len(pieces) else ""
            spans.append(start + end)
    return f"better {'and '.join(spans)}kbit/s"


def _pieces(samples: NDArray[np.float64], gains_db: NDArray[np.float64]) -> list[tuple[float, bool]]:
    if not samples.size:
        return []
    better = gains_db > EQUAL_DB
    starts = [0, *(np.flatnonzero(better[1:] != better[:-1]) + 1)]
    return [(float(math.exp(samples[i])), bool(better[i])) for i in starts]


def _gains(reference: Curve, other: Curve) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return logarithms of rates that both curves reach, and how much higher the PSNR of `other` is there."""
    (rates_a, psnrs_a), (rates_b, psnrs_b) = _front(reference), _front(other)
    low, high = max(rates_a[0], rates_b[0]), min(rates_a[-1], rates_b[-1])
    if min(rates_a.size, rates_b.size) < 2 or low >= high:
        return np.empty(0), np.empty(0)
    from scipy.interpolate import PchipInterpolator

    samples = np.linspace(low, high, NUM_SAMPLES)
    psnrs_db = [PchipInterpolator(*front)(samples) for front in ((rates_a, psnrs_a), (rates_b, psnrs_b))]
    return samples, psnrs_db[1] - psnrs_db[0]


def _front(curve: Curve) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return logarithms of rates, and PSNRs, of the points that no other point beats."""
    points: list[tuple[float, float]] = []
    logarithms = map(math.log, curve.rates_kbps)  # which may be equal where rates are not
    for rate, psnr in sorted(zip(logarithms, curve.psnrs_y_db, strict=True), key=lambda p: (p[0], -p[1])):
        if not points or psnr > points[-1][1]:
            points.append((rate, psnr))
    both = np.array(points, dtype=np.float64)
    return both[:, 0], both[:, 1]
