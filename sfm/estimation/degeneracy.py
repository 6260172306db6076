"""Degenerate motion: when two frames tell nothing, or too little, about depth."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import homogeneous
from sfm.estimation.fundamental import SharedScale
from sfm.estimation.robust import (
    Indices,
    Mask,
    RobustOptions,
    noise_scale,
    optimize_locally,
    sample_consensus,
)
from sfm.estimation.weak_calibration import WeakCalibration
from sfm.model import Correspondences

Floats = NDArray[np.float64]
MotionKind = Literal["general", "rotation", "none", "unknown"]


@dataclass(frozen=True)
class DegeneracyOptions:
    """What counts as motion, and as parallax.

    Attributes
    ----------
    min_motion_px : float
        If nine tenths of the points move less than this, the camera stood still.
    min_parallax_px : float
        Parallax below this gives no usable depth, however small the noise.
    min_noise_px : float
        Lower bound on the noise: the matches of real frames are never better.
    min_num_points : int
        Fewer correspondences leave the motion unknown.
    min_spread_px : float
        Points within this of a straight line leave the motion unknown.
    min_parallax_share : float
        Share of the correspondences that must be off the homography for the scene to be general.
    sure_parallax_share : float
        Share above which it is, even if the criterion prefers the homography: that caps what it charges for
        points that disagree, and so overlooks a second plane.
    search : RobustOptions
        The random search for the homography.
    """

    min_motion_px: float = 0.5
    min_parallax_px: float = 0.5
    min_noise_px: float = 0.15
    min_num_points: int = 14
    min_spread_px: float = 3.0
    min_parallax_share: float = 0.1
    sure_parallax_share: float = 0.2
    search: RobustOptions = field(
        default_factory=lambda: RobustOptions(threshold_px=1.0, min_num_trials=100, max_num_trials=1000)
    )


@dataclass(frozen=True, eq=False)
class MotionClass:
    """What the camera did between two frames, as far as the points tell.

    Attributes
    ----------
    kind : {"general", "rotation", "none", "unknown"}
        ``general``: depth can be had; ``rotation``: or a distant or planar scene, a homography explains
        all; ``none``: no motion; ``unknown``: too little to go by.
    reason : str
        One line that says why.
    homography : ndarray of shape (3, 3), float64
        The second image from the first, as well as one homography can; the identity where there is none.
    noise_px : float
        Standard deviation of a point along one axis that was assumed.
    parallax_px : float
        Ninth decile of the motion that the homography leaves.
    gric_advantage : float
        Criterion of the homography less that of the fundamental matrix, per point; negative favours the
        homography.
    """

    kind: MotionKind
    reason: str
    homography: Floats
    noise_px: float = 0.0
    parallax_px: float = 0.0
    gric_advantage: float = 0.0


class HomographyEstimator:
    """Homographies of sets of correspondences, as an `sfm.estimation.robust.Estimator`.

    Models are in the coordinates of `scale`; residuals are Sampson distances in pixels.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Finite points in pixels.
    """

    min_num_samples = 4

    def __init__(self, first: Floats, second: Floats) -> None:
        self.num_data = len(first)
        self.scale = SharedScale.of(first, second)
        self._first = (first - self.scale.first_px) / self.scale.scale_px
        self._second = (second - self.scale.second_px) / self.scale.scale_px
        self._rows = _homography_rows(self._first, self._second)

    def estimate(self, samples: Indices) -> Floats:
        """Solve samples of four points or more, all at once.

        Parameters
        ----------
        samples : ndarray of shape (S, m), int64
            Correspondences of each sample, m >= 4.

        Returns
        -------
        ndarray of shape (S, 3, 3), float64
            Homographies of unit norm.
        """
        if len(samples) == 0:
            return np.empty((0, 3, 3))
        rows = self._rows[samples].reshape(len(samples), -1, 9)
        solution: Floats = np.linalg.svd(rows, full_matrices=True)[2][:, 8].reshape(-1, 3, 3)
        return solution

    def residuals(self, models: Floats) -> Floats:
        """Measure all correspondences under all models.

        Parameters
        ----------
        models : ndarray of shape (K, 3, 3), float64
            Homographies.

        Returns
        -------
        ndarray of shape (K, N), float64
            Sampson distances in pixels, not negative.
        """
        x, y = self._first[:, 0], self._first[:, 1]
        h = models.reshape(-1, 9, 1)
        a, b, c = (h[:, k] * x + h[:, k + 1] * y + h[:, k + 2] for k in (0, 3, 6))
        depth = np.where(np.abs(c) > 1e-9, c, 1e-9)
        u, v = a / depth, b / depth
        # J is the derivative of (u, v) by (x, y); the offset d has the covariance I + J J'.
        jux, juy = (h[:, 0] - u * h[:, 6]) / depth, (h[:, 1] - u * h[:, 7]) / depth
        jvx, jvy = (h[:, 3] - v * h[:, 6]) / depth, (h[:, 4] - v * h[:, 7]) / depth
        uu, vv, uv = 1 + jux * jux + juy * juy, 1 + jvx * jvx + jvy * jvy, jux * jvx + juy * jvy
        du, dv = self._second[:, 0] - u, self._second[:, 1] - v
        squared = (vv * du * du - 2 * uv * du * dv + uu * dv * dv) / np.maximum(uu * vv - uv * uv, 1.0)
        distances: Floats = np.sqrt(np.maximum(squared, 0.0)) * self.scale.scale_px
        return distances

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Fit the inliers by linear least squares, reweighted so that the distance in the image counts.

        Parameters
        ----------
        model : ndarray of shape (3, 3), float64
            Where to start.
        inliers : ndarray of shape (N,), bool
            Which correspondences count, four at least.

        Returns
        -------
        ndarray of shape (3, 3), float64
            The refined homography, unit norm.
        """
        points = homogeneous(self._first[inliers])
        for _ in range(3):
            depth = points @ model[2]
            weight = 1.0 / np.maximum(np.abs(depth), 1e-6)
            rows = self._rows[inliers] * weight[:, None, None]
            normal = np.einsum("nki,nkj->ij", rows, rows)
            model = np.linalg.eigh(normal)[1][:, 0].reshape(3, 3)
        return model

    def to_pixels(self, model: Floats) -> Floats:
        """Convert a homography to pixels.

        Parameters
        ----------
        model : ndarray of shape (3, 3), float64
            In the coordinates of `scale`.

        Returns
        -------
        ndarray of shape (3, 3), float64
            In pixels, third diagonal entry 1 where it is not 0.
        """
        a, b = self.scale.matrices()
        pixels: Floats = np.linalg.inv(b) @ model @ a
        return pixels / pixels[2, 2] if abs(pixels[2, 2]) > 1e-12 else pixels


def _homography_rows(first: Floats, second: Floats) -> Floats:
    """Return two equations (N, 2, 9) per correspondence in the entries of H, row by row."""
    a, zero = homogeneous(first), np.zeros((len(first), 3))
    horizontal = np.hstack([a, zero, -second[:, :1] * a])
    vertical = np.hstack([zero, a, -second[:, 1:] * a])
    return np.stack([horizontal, vertical], axis=1)


def gric(squared_px2: Floats, sigma_px: float, dimension: int, num_parameters: int) -> float:
    """Compute the geometric robust information criterion of a model of two views.

    Parameters
    ----------
    squared_px2 : ndarray of shape (N,), float64
        Squared Sampson distances of the correspondences.
    sigma_px : float
        Standard deviation of a coordinate of a point.
    dimension : int
        Dimension of the manifold of correspondences: 3 for a fundamental matrix, 2 for a homography.
    num_parameters : int
        Degrees of freedom: 7, or 8.

    Returns
    -------
    float
        The criterion; the lower, the better the model.

    References
    ----------
    P. Torr, "Geometric motion segmentation and model selection", 1998.
    """
    num = len(squared_px2)
    limit = 2.0 * (4 - dimension)
    error = float(np.minimum(squared_px2 / (sigma_px * sigma_px), limit).sum())
    return error + math.log(4.0) * dimension * num + math.log(4.0 * max(num, 1)) * num_parameters


def classify_motion(
    correspondences: Correspondences,
    calibration: WeakCalibration,
    rng: np.random.Generator,
    options: DegeneracyOptions | None = None,
) -> MotionClass:
    """Tell what the camera did, and with it whether depth can be had from two frames.

    Parameters
    ----------
    correspondences : Correspondences
        Points in pixels.
    calibration : WeakCalibration
        What `sfm.estimation.weak_calibration.weak_calibration` made of them.
    rng : Generator
        Source of randomness.
    options : DegeneracyOptions, optional
        Thresholds; the defaults if None.

    Returns
    -------
    MotionClass
        Kind of motion, and why.
    """
    options = options or DegeneracyOptions()
    finite = np.isfinite(correspondences.motion).all(axis=1)
    num = int(np.count_nonzero(finite))
    if num < options.min_num_points:
        return MotionClass(
            "unknown", f"{num} correspondences, {options.min_num_points} are needed", np.eye(3)
        )
    motion = np.hypot(*correspondences.motion[finite].T)
    if np.quantile(motion, 0.9) < options.min_motion_px:
        reason = f"nine tenths of the points move less than {options.min_motion_px:g} px"
        return MotionClass("none", reason, np.eye(3))
    if not calibration.success:
        return MotionClass("unknown", calibration.reason, np.eye(3))
    agreeing = correspondences[calibration.inliers]
    if _spread(agreeing.first) < options.min_spread_px:
        return MotionClass("unknown", "all points lie near a straight line", np.eye(3))
    return _compare(agreeing, calibration, rng, options)


def _spread(points: Floats) -> float:
    """Return the standard deviation of points (N, 2) across the direction in which they spread most."""
    offset = points - points.mean(axis=0)
    covariance = np.einsum("ni,nj->ij", offset, offset) / len(points)
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance)[0])))


def _compare(
    agreeing: Correspondences,
    calibration: WeakCalibration,
    rng: np.random.Generator,
    options: DegeneracyOptions,
) -> MotionClass:
    """Weigh the best homography against the fundamental matrix, over the inliers of the latter."""
    estimator = HomographyEstimator(agreeing.first, agreeing.second)
    found = optimize_locally(estimator, sample_consensus(estimator, options.search, rng), options.search, rng)
    if found.model is None:
        return MotionClass("unknown", "no homography could be fitted for comparison", np.eye(3))
    to_lines = calibration.residuals_px[calibration.inliers]
    noise_px = max(options.min_noise_px, noise_scale(to_lines, 7))
    difference = gric(found.residuals_px**2, noise_px, 2, 8) - gric(to_lines**2, noise_px, 3, 7)
    # Noise of both points adds up to sqrt(2) sigma between a point and where the homography puts it.
    parallax = math.sqrt(2.0) * found.residuals_px
    least = max(options.min_parallax_px, 3.0 * math.sqrt(2.0) * noise_px)
    share = float((parallax > least).mean())
    decile = float(np.quantile(parallax, 0.9))
    facts = (estimator.to_pixels(found.model), noise_px, decile, difference / len(agreeing))
    unsure = difference <= 0 and share < options.sure_parallax_share
    if unsure or share < options.min_parallax_share:
        reason = (
            f"a homography explains {100 * (1 - share):.0f} % of the points within {least:.2f} px: "
            "the camera only turned, or the scene is distant or planar"
        )
        return MotionClass("rotation", reason, *facts)
    return MotionClass("general", f"{100 * share:.0f} % of the points show parallax", *facts)
