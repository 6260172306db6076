"""Measures of quality, and of the distance between two rate-distortion curves."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dvc.errors import RdCurveError

PEAK = 255
SSIM_WINDOW_PX = 11
PSNR_CAP_DB = 100.0
"""Of planes that are equal, for means."""

Method = Literal["pchip", "cubic"]
MIN_POINTS: dict[str, int] = {"pchip": 2, "cubic": 4}


def psnr_db(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio of two planes, of peak 255.

    Parameters
    ----------
    a, b : ndarray of shape (H, W), uint8
        The planes, in any order.

    Returns
    -------
    float
        Decibels; ``inf`` if the planes are equal.

    Raises
    ------
    ValueError
        If types or shapes differ.

    Examples
    --------
    >>> flat = np.full((4, 4), 100, np.uint8)
    >>> round(psnr_db(flat, flat + 1), 2)
    48.13
    """
    _check_planes(a, b)
    difference = a.astype(np.int32) - b
    squared = int(np.sum(difference * difference, dtype=np.int64))
    return math.inf if squared == 0 else 10 * math.log10(PEAK**2 * a.size / squared)


def psnr_yuv_db(psnr_y_db: float, psnr_cb_db: float, psnr_cr_db: float) -> float:
    """Return the PSNR of a picture in colour: luma weighs six times as much as either plane of chroma.

    Parameters
    ----------
    psnr_y_db, psnr_cb_db, psnr_cr_db : float
        PSNRs of the planes, or their means over frames.

    Returns
    -------
    float
        Decibels: (6 Y + Cb + Cr) / 8.
    """
    return (6.0 * psnr_y_db + psnr_cb_db + psnr_cr_db) / 8.0


def mean_psnr_db(psnrs_db: Sequence[float]) -> float:
    """Return the PSNR of a sequence as the field states it: the mean of the PSNRs of its frames.

    Parameters
    ----------
    psnrs_db : sequence of float
        One PSNR per frame.

    Returns
    -------
    float
        Decibels; ``inf`` as soon as one frame is without error.

    Raises
    ------
    ValueError
        If the sequence is empty.
    """
    if not len(psnrs_db):
        raise ValueError("`psnrs_db` must not be empty")
    return float(np.mean(psnrs_db))


def psnr_of_mean_error_db(psnrs_db: Sequence[float]) -> float:
    """Return the PSNR of the mean squared error of several frames, which bad frames weigh on.

    Parameters
    ----------
    psnrs_db : sequence of float
        PSNR of each frame in dB.

    Returns
    -------
    float
        In dB; at most their mean.
    """
    return -10.0 * math.log10(fmean(10.0 ** (-psnr / 10.0) for psnr in psnrs_db))


def ssim(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Return the mean structural similarity of two planes, with the Gaussian window of its authors.

    Parameters
    ----------
    a, b : ndarray of shape (H, W), uint8
        The planes, both sides at least 11 pixels.

    Returns
    -------
    float
        1 for equal planes, less otherwise.

    Raises
    ------
    ValueError
        If types or shapes differ, or a side is smaller than the window.

    References
    ----------
    [SSIM] Wang, Bovik, Sheikh, Simoncelli, IEEE Trans. Image Processing 13 (2004), Eq. (13).
    """
    from skimage import metrics

    _check_planes(a, b)
    if min(a.shape) < SSIM_WINDOW_PX:
        raise ValueError(f"`a` must have sides of at least {SSIM_WINDOW_PX} pixels, got {a.shape}")
    similarity: Callable[..., float] = metrics.structural_similarity
    authors_choice = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    return float(similarity(a, b, data_range=PEAK, **authors_choice))


def _check_planes(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> None:
    """Refuse what is not two planes of one size."""
    if a.dtype != np.uint8 or b.dtype != np.uint8:
        raise ValueError(f"`a` and `b` must be uint8, got {a.dtype} and {b.dtype}")
    if a.shape != b.shape or a.ndim != 2 or a.size == 0:
        raise ValueError(f"`a` and `b` must be planes of one size, got {a.shape} and {b.shape}")


@dataclass(frozen=True)
class BdResult:
    """A Bjontegaard difference of curve B against curve A, and what it rests on.

    Attributes
    ----------
    value : float
        Per cent of rate for `bd_rate` (negative: B needs less), decibels for `bd_psnr` (positive: B is
        better).
    method : {"pchip", "cubic"}
        Interpolation between the points.
    overlap : tuple of float
        Ends of the interval that both curves cover: decibels for `bd_rate`, rate for `bd_psnr`.
    overlap_share : float
        Length of that interval over the length that either curve covers, 0 to 1 (rates on a log scale).
    num_points : tuple of int
        Points used of A and of B.
    num_dropped : tuple of int
        Points left out of A and of B because another costs no more rate and has no less quality.
    """

    value: float
    method: Method
    overlap: tuple[float, float]
    overlap_share: float
    num_points: tuple[int, int]
    num_dropped: tuple[int, int]


def bd_rate(
    rate_a: Sequence[float],
    psnr_a_db: Sequence[float],
    rate_b: Sequence[float],
    psnr_b_db: Sequence[float],
    *,
    method: Method = "pchip",
) -> BdResult:
    """Return the mean difference in rate between two curves at equal quality.

    The logarithm of the rate is interpolated over the PSNR, and the difference is averaged over the PSNRs
    that both curves reach. Points may come in any order; those that another point of the same curve dominates
    (no more rate and no less PSNR) are left out and counted, so that both curves rise.

    Parameters
    ----------
    rate_a, rate_b : sequence of float
        Rates in any one unit, positive.
    psnr_a_db, psnr_b_db : sequence of float
        Qualities in decibels.
    method : {"pchip", "cubic"}, optional
        Piecewise cubic Hermite interpolation, as in the field's current tools, or one third-order polynomial
        per curve, the original proposal.

    Returns
    -------
    BdResult
        Per cent: +10 if B needs a tenth more rate everywhere.

    Raises
    ------
    RdCurveError
        If the curves have no PSNR in common, or too few points (2 for "pchip", 4 for "cubic"), or a value is
        not finite or a rate not positive.

    References
    ----------
    [BD] Bjontegaard, VCEG-M33 (2001); [BD-PCHIP] JCTVC-L1100 and ITU-T HSTP-VID-WPOM (2020).
    """
    curve_a, curve_b = _curve(rate_a, psnr_a_db, "A", method), _curve(rate_b, psnr_b_db, "B", method)
    logarithmic = _mean_difference(curve_a.swapped(), curve_b.swapped(), method, "PSNR")
    return replace(logarithmic, value=(10**logarithmic.value - 1) * 100)


def bd_psnr(
    rate_a: Sequence[float],
    psnr_a_db: Sequence[float],
    rate_b: Sequence[float],
    psnr_b_db: Sequence[float],
    *,
    method: Method = "pchip",
) -> BdResult:
    """Return the mean difference in quality between two curves at equal rate.

    The PSNR is interpolated over the logarithm of the rate; everything else is as in `bd_rate`.

    Parameters
    ----------
    rate_a, rate_b : sequence of float
        Rates in any one unit, positive.
    psnr_a_db, psnr_b_db : sequence of float
        Qualities in decibels.
    method : {"pchip", "cubic"}, optional
        As for `bd_rate`.

    Returns
    -------
    BdResult
        Decibels: positive if B is better.

    Raises
    ------
    RdCurveError
        As for `bd_rate`, with no rate in common.
    """
    curve_a, curve_b = _curve(rate_a, psnr_a_db, "A", method), _curve(rate_b, psnr_b_db, "B", method)
    logarithmic = _mean_difference(curve_a, curve_b, method, "rate")
    return replace(logarithmic, overlap=(10 ** logarithmic.overlap[0], 10 ** logarithmic.overlap[1]))


@dataclass(frozen=True)
class _Curve:
    """A rising curve: one ordinate is the base-10 logarithm of the rate, the other the PSNR in decibels."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    num_dropped: int

    def swapped(self) -> "_Curve":
        """Return the inverse function."""
        return _Curve(self.y, self.x, self.num_dropped)

    def integral(self, low: float, high: float, method: Method) -> float:
        """Integrate the interpolated curve."""
        if method == "cubic":
            antiderivative = np.polynomial.Polynomial.fit(self.x, self.y, 3).integ()
            return float(antiderivative(high) - antiderivative(low))
        from scipy.interpolate import PchipInterpolator

        return float(PchipInterpolator(self.x, self.y).integrate(low, high))


def _curve(rate: Sequence[float], psnr: Sequence[float], name: str, method: Method) -> _Curve:
    """Check the points of a curve, sort them, and leave out those that others dominate."""
    if method not in MIN_POINTS:
        raise ValueError(f"`method` must be one of {sorted(MIN_POINTS)}, got {method!r}")
    rates, psnrs = np.asarray(rate, np.float64), np.asarray(psnr, np.float64)
    if rates.shape != psnrs.shape or rates.ndim != 1:
        raise RdCurveError(f"curve {name}: {rates.size} rates for {psnrs.size} PSNRs")
    if not (np.all(np.isfinite(rates)) and np.all(np.isfinite(psnrs)) and np.all(rates > 0)):
        raise RdCurveError(f"curve {name}: rates must be positive, and all values finite")
    logarithms = np.log10(rates)  # which may be equal where rates are not
    order = np.lexsort((-psnrs, logarithms))
    logarithms, psnrs = logarithms[order], psnrs[order]
    best_before = np.maximum.accumulate(np.concatenate([[-np.inf], psnrs[:-1]]))
    kept = psnrs > best_before
    num_kept = int(np.count_nonzero(kept))
    if num_kept < MIN_POINTS[method]:
        raise RdCurveError(
            f"curve {name}: {num_kept} useful points of {rates.size}, "
            f"the method {method!r} needs {MIN_POINTS[method]}"
        )
    return _Curve(logarithms[kept], psnrs[kept], rates.size - num_kept)


def _mean_difference(a: _Curve, b: _Curve, method: Method, axis: str) -> BdResult:
    """Average curve B minus curve A over the abscissae that both have."""
    low, high = float(max(a.x[0], b.x[0])), float(min(a.x[-1], b.x[-1]))
    if not low < high:
        raise RdCurveError(f"the curves have no {axis} in common")
    difference = b.integral(low, high, method) - a.integral(low, high, method)
    return BdResult(
        value=difference / (high - low),
        method=method,
        overlap=(low, high),
        overlap_share=(high - low) / float(max(a.x[-1], b.x[-1]) - min(a.x[0], b.x[0])),
        num_points=(a.x.size, b.x.size),
        num_dropped=(a.num_dropped, b.num_dropped),
    )
