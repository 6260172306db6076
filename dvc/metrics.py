"""Measures of picture quality, and of the distance between two rate-distortion curves."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from dvc.errors import RdCurveError

PEAK = 255
SSIM_WINDOW_PX = 11
PSNR_CAP_DB = 100.0
"""PSNR of equal planes in means."""
MIN_CURVE_POINTS = 2


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
    """Return the PSNR of the mean squared error of several frames, which emphasises bad frames.

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
    if a.dtype != np.uint8 or b.dtype != np.uint8:
        raise ValueError(f"`a` and `b` must be uint8, got {a.dtype} and {b.dtype}")
    if a.shape != b.shape or a.ndim != 2 or a.size == 0:
        raise ValueError(f"`a` and `b` must be planes of one size, got {a.shape} and {b.shape}")


@dataclass(frozen=True)
class BdResult:
    """A Bjontegaard difference of curve B against curve A.

    Attributes
    ----------
    value : float
        Per cent of rate for `bd_rate` (negative: B needs less), decibels for `bd_psnr` (positive: B is
        better).
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
    overlap: tuple[float, float]
    overlap_share: float
    num_points: tuple[int, int]
    num_dropped: tuple[int, int]


def bd_rate(
    rate_a: Sequence[float], psnr_a_db: Sequence[float], rate_b: Sequence[float], psnr_b_db: Sequence[float]
) -> BdResult:
    """Return the mean difference in rate between two curves at equal quality.

    The logarithm of the rate is interpolated over the PSNR (PCHIP), and the difference is averaged over the
    PSNRs that both curves reach. Points may come in any order; those that another point of the same curve
    dominates (no more rate and no less PSNR) are left out and counted, so that both curves rise.

    Parameters
    ----------
    rate_a, rate_b : sequence of float
        Rates in any one unit, positive.
    psnr_a_db, psnr_b_db : sequence of float
        Qualities in decibels.

    Returns
    -------
    BdResult
        Per cent: +10 if B needs a tenth more rate everywhere.

    Raises
    ------
    RdCurveError
        If the curves have no PSNR in common, or fewer than two points, or a value is not finite or a rate
        not positive.

    References
    ----------
    [BD] Bjontegaard, VCEG-M33 (2001); [BD-PCHIP] JCTVC-L1100 and ITU-T HSTP-VID-WPOM (2020).
    """
    rates_a, psnrs_a = rising_curve(rate_a, psnr_a_db, "A")
    rates_b, psnrs_b = rising_curve(rate_b, psnr_b_db, "B")
    logarithmic = _mean_difference((psnrs_a, rates_a), (psnrs_b, rates_b), "PSNR")
    num_dropped = len(rate_a) - rates_a.size, len(rate_b) - rates_b.size
    return replace(logarithmic, value=(10**logarithmic.value - 1) * 100, num_dropped=num_dropped)


def bd_psnr(
    rate_a: Sequence[float], psnr_a_db: Sequence[float], rate_b: Sequence[float], psnr_b_db: Sequence[float]
) -> BdResult:
    """Return the mean difference in quality between two curves at equal rate.

    The PSNR is interpolated over the logarithm of the rate; everything else is as in `bd_rate`.

    Parameters
    ----------
    rate_a, rate_b : sequence of float
        Rates in any one unit, positive.
    psnr_a_db, psnr_b_db : sequence of float
        Qualities in decibels.

    Returns
    -------
    BdResult
        Decibels: positive if B is better.

    Raises
    ------
    RdCurveError
        As for `bd_rate`, with no rate in common.
    """
    curve_a, curve_b = rising_curve(rate_a, psnr_a_db, "A"), rising_curve(rate_b, psnr_b_db, "B")
    logarithmic = _mean_difference(curve_a, curve_b, "rate")
    num_dropped = len(rate_a) - curve_a[0].size, len(rate_b) - curve_b[0].size
    overlap = 10 ** logarithmic.overlap[0], 10 ** logarithmic.overlap[1]
    return replace(logarithmic, overlap=overlap, num_dropped=num_dropped)


RisingCurve = tuple[NDArray[np.float64], NDArray[np.float64]]


def rising_curve(rate: Sequence[float], psnr_db: Sequence[float], name: str) -> RisingCurve:
    """Return base-10 logarithms of rates, and PSNRs, of the points that no other point dominates, sorted."""
    rates, psnrs = np.asarray(rate, np.float64), np.asarray(psnr_db, np.float64)
    if rates.shape != psnrs.shape or rates.ndim != 1:
        raise RdCurveError(f"curve {name}: {rates.size} rates for {psnrs.size} PSNRs")
    if not (np.all(np.isfinite(rates)) and np.all(np.isfinite(psnrs)) and np.all(rates > 0)):
        raise RdCurveError(f"curve {name}: rates must be positive, and all values finite")
    logarithms = np.log10(rates)  # may be equal although the rates are not
    order = np.lexsort((-psnrs, logarithms))
    logarithms, psnrs = logarithms[order], psnrs[order]
    best_before = np.maximum.accumulate(np.concatenate([[-np.inf], psnrs[:-1]]))
    rising = psnrs > best_before
    num_useful = int(np.count_nonzero(rising))
    if num_useful < MIN_CURVE_POINTS:
        raise RdCurveError(
            f"curve {name}: {num_useful} useful points of {rates.size}, expected at least {MIN_CURVE_POINTS}"
        )
    return logarithms[rising], psnrs[rising]


def _mean_difference(a: RisingCurve, b: RisingCurve, axis: str) -> BdResult:
    """Average the ordinates of curve B minus curve A over the abscissae that both have."""
    from scipy.interpolate import PchipInterpolator

    low, high = float(max(a[0][0], b[0][0])), float(min(a[0][-1], b[0][-1]))
    if not low < high:
        raise RdCurveError(f"the curves have no {axis} in common")
    integrals = [float(PchipInterpolator(*curve).integrate(low, high)) for curve in (a, b)]
    return BdResult(
        value=(integrals[1] - integrals[0]) / (high - low),
        overlap=(low, high),
        overlap_share=(high - low) / float(max(a[0][-1], b[0][-1]) - min(a[0][0], b[0][0])),
        num_points=(a[0].size, b[0].size),
        num_dropped=(0, 0),
    )
