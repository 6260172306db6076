"""Robust weak calibration: the fundamental matrix of two frames, and which correspondences obey it."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sfm.estimation.epipolar import sampson_distances, unit_norm
from sfm.estimation.fundamental import FundamentalEstimator, Loss, SharedScale, minimize_sampson, robust_scale
from sfm.estimation.robust import RobustOptions, optimize_locally, sample_consensus
from sfm.model import Correspondences

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class WeakCalibrationOptions:
    """Parameters of the robust weak calibration.

    Attributes
    ----------
    search : RobustOptions
        Threshold on the Sampson distance and length of the random search.
    min_num_inliers : int
        Fewer than this do not confirm a matrix that seven points determine.
    min_threshold_px : float
        The final threshold follows the noise, but is not below this.
    threshold_in_sigmas : float
        The final threshold, in standard deviations of the noise.
    """

    search: RobustOptions = field(default_factory=RobustOptions)
    min_num_inliers: int = 14
    min_threshold_px: float = 0.35
    threshold_in_sigmas: float = 3.5

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.min_num_inliers < 8:
            raise ValueError(f"`min_num_inliers` must be at least 8, got {self.min_num_inliers}")


@dataclass(frozen=True, eq=False)
class WeakCalibration:
    """What came of an attempt to weakly calibrate two frames.

    Attributes
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0`` in pixels, unit norm; zeros where there is none.
    inliers : ndarray of shape (N,), bool
        Correspondences that obey it.
    residuals_px : ndarray of shape (N,), float64
        Sampson distances, not negative; inf where there is no matrix, or the point is not finite.
    noise_px : float
        Standard deviation of the Sampson distances of the inliers.
    num_trials : int
        Samples that were drawn.
    reason : str
        Why there is no matrix, or it cannot be trusted; empty if it can.
    """

    fundamental: Floats
    inliers: Mask
    residuals_px: Floats
    noise_px: float
    num_trials: int
    reason: str

    @property
    def success(self) -> bool:
        """Whether the matrix can be trusted."""
        return not self.reason


def weak_calibration(
    correspondences: Correspondences,
    rng: np.random.Generator,
    options: WeakCalibrationOptions | None = None,
) -> WeakCalibration:
    """Estimate the fundamental matrix of two frames in spite of wrong correspondences.

    MAPSAC, then LO-RANSAC from its result, then the least Sampson distance over the final inliers.

    Parameters
    ----------
    correspondences : Correspondences
        Points in pixels; those that are not finite are outliers.
    rng : Generator
        Source of randomness.
    options : WeakCalibrationOptions, optional
        Parameters; the defaults if None.

    Returns
    -------
    WeakCalibration
        The matrix, or the reason why there is none.

    References
    ----------
    [Maitre2008] Sec. 5.2.3.
    """
    options = options or WeakCalibrationOptions()
    finite = np.isfinite(correspondences.first).all(axis=1) & np.isfinite(correspondences.second).all(axis=1)
    usable = np.flatnonzero(finite)
    if len(usable) < options.min_num_inliers:
        reason = f"{len(usable)} correspondences, {options.min_num_inliers} are needed"
        return _failure(len(correspondences), 0, reason)
    first, second = correspondences.first[usable], correspondences.second[usable]
    estimator = FundamentalEstimator(first, second)
    found = sample_consensus(estimator, options.search, rng)
    found = optimize_locally(estimator, found, options.search, rng)
    if found.model is None or np.count_nonzero(found.inliers) < options.min_num_inliers:
        agreeing = np.count_nonzero(found.inliers)
        reason = f"{agreeing} of {len(usable)} correspondences agree on the epipolar geometry"
        return _failure(len(correspondences), found.num_trials, reason)
    model, inliers, noise_px = _settle(estimator, found.model, found.inliers, options)
    residuals = np.full(len(correspondences), np.inf)
    residuals[usable] = estimator.residuals(model[None])[0]
    mask = np.zeros(len(correspondences), dtype=bool)
    mask[usable] = inliers
    count = int(np.count_nonzero(mask))
    reason = "" if count >= options.min_num_inliers else f"{count} correspondences remain within the noise"
    fundamental = estimator.scale.to_pixels(model)
    return WeakCalibration(fundamental, mask, residuals, noise_px, found.num_trials, reason)


def _settle(
    estimator: FundamentalEstimator, model: Floats, inliers: Mask, options: WeakCalibrationOptions
) -> tuple[Floats, Mask, float]:
    """Refine matrix and inliers in turn, the threshold following the noise, until the inliers stay."""
    noise_px = 0.0
    for _ in range(5):
        model = estimator.refine(model, inliers)
        residuals = estimator.residuals(model[None])[0]
        noise_px = _noise(residuals[inliers])
        limit = max(options.min_threshold_px, options.threshold_in_sigmas * noise_px)
        chosen = residuals < min(limit, options.search.threshold_px)
        if np.count_nonzero(chosen) < options.min_num_inliers or (chosen == inliers).all():
            break
        inliers = chosen
    return model, inliers, noise_px


def _noise(residuals: Floats) -> float:
    free = max(1, len(residuals) - 7)
    return math.sqrt(float((residuals * residuals).sum()) / free)


def _failure(num_data: int, num_trials: int, reason: str) -> WeakCalibration:
    nothing = np.zeros(num_data, dtype=bool)
    return WeakCalibration(np.zeros((3, 3)), nothing, np.full(num_data, np.inf), 0.0, num_trials, reason)


def refine_fundamental(
    fundamental: Floats,
    correspondences: Correspondences,
    weights: Floats | None = None,
    loss: Loss = "cauchy",
    min_noise_px: float = 0.02,
) -> Floats:
    """Refine a fundamental matrix over many correspondences, a few of which may be wrong.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        A good estimate, in pixels.
    correspondences : Correspondences
        Points in pixels; those that are not finite are left out. With fewer than eight the estimate stays.
    weights : ndarray of shape (N,), float64, optional
        Weights of the squared Sampson distances; equal if None.
    loss : {"cauchy", "squared"}
        Whether large distances are given less influence; the noise is estimated.
    min_noise_px : float
        Lower bound on the noise that the robust loss assumes.

    Returns
    -------
    ndarray of shape (3, 3), float64
        F in pixels, of rank 2 and unit norm.

    Raises
    ------
    ValueError
        If `weights` has another shape.
    """
    if weights is not None and weights.shape != (len(correspondences),):
        raise ValueError(f"`weights` must have shape ({len(correspondences)},), got {weights.shape}")
    first, second = correspondences.first, correspondences.second
    finite = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    if np.count_nonzero(finite) < 8:
        return unit_norm(fundamental)
    first, second = first[finite], second[finite]
    chosen = None if weights is None else weights[finite]
    scale = SharedScale.of(first, second)
    model = scale.from_pixels(fundamental)
    a, b = (first - scale.first_px) / scale.scale_px, (second - scale.second_px) / scale.scale_px
    if loss == "squared":
        return scale.to_pixels(minimize_sampson(model, a, b, chosen))
    for _ in range(2):  # the noise of a rough estimate is too large: fit, and measure it again
        noise = robust_scale(model, a, b, min_noise_px / scale.scale_px)
        model = minimize_sampson(model, a, b, chosen, loss, noise)
    return scale.to_pixels(model)


def residual_rms_px(fundamental: Floats, correspondences: Correspondences) -> float:
    """Return the root mean square of the Sampson distances.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F in pixels.
    correspondences : Correspondences
        Points in pixels.

    Returns
    -------
    float
        In pixels; 0 if there are no points.
    """
    if not len(correspondences):
        return 0.0
    distances = sampson_distances(fundamental, correspondences.first, correspondences.second)
    return math.sqrt(float((distances * distances).mean()))
