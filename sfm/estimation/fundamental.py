"""Fundamental matrices from points: seven points, many points, and the least Sampson distance."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sfm.estimation.epipolar import TINY, skew, unit_norm
from sfm.estimation.robust import Indices, Mask, noise_scale

Floats = NDArray[np.float64]
Loss = Literal["squared", "cauchy"]

CAUCHY_TUNING = 2.385  # in noise scales: 95 % efficient under Gaussian noise
DAMPING = 1e-4  # of the first step, relative to the curvature


@dataclass(frozen=True, eq=False)
class SharedScale:
    """Coordinates for both images: each has its centroid at 0, and both share one scale.

    With one scale, distances in these coordinates are distances in pixels up to a constant.

    Attributes
    ----------
    first_px, second_px : ndarray of shape (2,), float64
        Centroids.
    scale_px : float
        Pixels per unit.
    """

    first_px: Floats
    second_px: Floats
    scale_px: float

    @classmethod
    def of(cls, first: Floats, second: Floats) -> "SharedScale":
        """Fit the coordinates to points.

        Parameters
        ----------
        first, second : ndarray of shape (N, 2), float64
            Points in pixels; N may be 0.

        Returns
        -------
        SharedScale
            With a root mean square coordinate of about 1.
        """
        if not len(first):
            return cls(np.zeros(2), np.zeros(2), 1.0)
        a, b = first.mean(axis=0), second.mean(axis=0)
        spread = math.sqrt(0.25 * float((((first - a) ** 2) + (second - b) ** 2).sum(axis=1).mean()))
        return cls(a, b, spread if spread > 1e-9 else 1.0)

    def matrices(self) -> tuple[Floats, Floats]:
        """Return the homographies (3, 3) from pixels to these coordinates, for both images."""
        s = 1.0 / self.scale_px
        a, b = np.diag([s, s, 1.0]), np.diag([s, s, 1.0])
        a[:2, 2], b[:2, 2] = -s * self.first_px, -s * self.second_px
        return a, b

    def to_pixels(self, fundamental: Floats) -> Floats:
        """Convert a fundamental matrix to pixels.

        Parameters
        ----------
        fundamental : ndarray of shape (3, 3), float64
            F in these coordinates.

        Returns
        -------
        ndarray of shape (3, 3), float64
            F in pixels, unit norm.
        """
        a, b = self.matrices()
        return unit_norm(b.T @ fundamental @ a)

    def from_pixels(self, fundamental: Floats) -> Floats:
        """Convert a fundamental matrix from pixels; inverse of `to_pixels`.

        Parameters
        ----------
        fundamental : ndarray of shape (3, 3), float64
            F in pixels.

        Returns
        -------
        ndarray of shape (3, 3), float64
            F in these coordinates, unit norm.
        """
        a, b = self.matrices()
        return unit_norm(np.linalg.inv(b).T @ fundamental @ np.linalg.inv(a))


class FundamentalEstimator:
    """Fundamental matrices of sets of correspondences, as an `sfm.estimation.robust.Estimator`.

    Models are in the coordinates of `scale`; residuals are Sampson distances in pixels.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Finite points in pixels.
    """

    min_num_samples = 7

    def __init__(self, first: Floats, second: Floats) -> None:
        self.num_data = len(first)
        self.scale = SharedScale.of(first, second)
        self._first = (first - self.scale.first_px) / self.scale.scale_px
        self._second = (second - self.scale.second_px) / self.scale.scale_px
        self._rows = constraint_rows(self._first, self._second)

    def estimate(self, samples: Indices) -> Floats:
        """Solve samples of seven points, or more than seven, all at once.

        Parameters
        ----------
        samples : ndarray of shape (S, m), int64
            Correspondences of each sample, m >= 7.

        Returns
        -------
        ndarray of shape (K, 3, 3), float64
            For seven points the one or three solutions of each sample, else one per sample; all of rank 2.
        """
        if len(samples) == 0:
            return np.empty((0, 3, 3))
        if samples.shape[1] == self.min_num_samples:
            return seven_point(self._rows[samples])
        return eight_point(self._rows[samples])

    def residuals(self, models: Floats) -> Floats:
        """Measure all correspondences under all models.

        Parameters
        ----------
        models : ndarray of shape (K, 3, 3), float64
            Fundamental matrices.

        Returns
        -------
        ndarray of shape (K, N), float64
            Sampson distances in pixels, not negative.
        """
        x, y = self._first[:, 0], self._first[:, 1]
        u, v = self._second[:, 0], self._second[:, 1]
        f = models.reshape(-1, 9, 1)
        a, b, c = (f[:, k] * x + f[:, k + 1] * y + f[:, k + 2] for k in (0, 3, 6))
        d, e = (f[:, k] * u + f[:, k + 3] * v + f[:, k + 6] for k in (0, 1))
        squared_gradient = a * a + b * b + d * d + e * e
        distances: Floats = np.abs(u * a + v * b + c) / np.sqrt(np.maximum(squared_gradient, TINY))
        return distances * self.scale.scale_px

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Minimise the sum of squared Sampson distances of the inliers.

        Parameters
        ----------
        model : ndarray of shape (3, 3), float64
            Where to start.
        inliers : ndarray of shape (N,), bool
            Which correspondences count.

        Returns
        -------
        ndarray of shape (3, 3), float64
            The refined matrix, of rank 2.
        """
        return minimize_sampson(model, self._first[inliers], self._second[inliers], max_iterations=5)


def constraint_rows(first: Floats, second: Floats) -> Floats:
    """Write ``x1' F x0 = 0`` as a linear equation in the nine entries of F.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Points of both images.

    Returns
    -------
    ndarray of shape (N, 9), float64
        Coefficients of F, row by row.
    """
    ones = np.ones((len(first), 1))
    a, b = np.hstack([first, ones]), np.hstack([second, ones])
    return (b[:, :, None] * a[:, None, :]).reshape(len(first), 9)


def seven_point(rows: Floats) -> Floats:
    """Find the matrices of rank 2 that satisfy seven equations.

    Parameters
    ----------
    rows : ndarray of shape (S, 7, 9), float64
        Equations of each sample, from `constraint_rows`.

    Returns
    -------
    ndarray of shape (K, 3, 3), float64
        Real solutions of all samples, unit norm; S <= K <= 3 S, fewer for degenerate samples.

    References
    ----------
    [HZ] Sec. 11.1.2.
    """
    null = np.linalg.svd(rows, full_matrices=True)[2][:, 7:].reshape(-1, 2, 3, 3)
    a, b = null[:, 0], null[:, 1]
    # det(z a + b) is a cubic in z: its outer coefficients are determinants, the others follow from z = 1, -1.
    c3, c0 = _determinants(a), _determinants(b)
    plus, minus = _determinants(a + b), _determinants(b - a)
    c2, c1 = 0.5 * (plus + minus) - c0, 0.5 * (plus - minus) - c3
    usable = np.abs(c3) > 1e-12 * (np.abs(c2) + np.abs(c1) + np.abs(c0) + TINY)
    a, b, c3 = a[usable], b[usable], c3[usable]
    companion = np.zeros((len(a), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    companion[:, :, 2] = -np.stack([c0[usable], c1[usable], c2[usable]], axis=1) / c3[:, None]
    roots = np.linalg.eigvals(companion)
    sample, which = np.nonzero(np.abs(roots.imag) <= 1e-8 * (1 + np.abs(roots.real)))
    z = roots.real[sample, which][:, None, None]
    models = z * a[sample] + b[sample]
    unit: Floats = models / np.linalg.norm(models, axis=(1, 2))[:, None, None]
    return unit


def _determinants(m: Floats) -> Floats:
    determinant: Floats = (
        m[:, 0, 0] * (m[:, 1, 1] * m[:, 2, 2] - m[:, 1, 2] * m[:, 2, 1])
        - m[:, 0, 1] * (m[:, 1, 0] * m[:, 2, 2] - m[:, 1, 2] * m[:, 2, 0])
        + m[:, 0, 2] * (m[:, 1, 0] * m[:, 2, 1] - m[:, 1, 1] * m[:, 2, 0])
    )
    return determinant


def eight_point(rows: Floats) -> Floats:
    """Find matrices of rank 2 that nearly satisfy more than seven equations.

    Parameters
    ----------
    rows : ndarray of shape (S, m, 9), float64
        Equations of each sample, m >= 8, in coordinates of about unit size.

    Returns
    -------
    ndarray of shape (S, 3, 3), float64
        Least squares solutions with the smallest singular value set to zero, unit norm.

    References
    ----------
    [HZ] Sec. 11.1.
    """
    solution = np.linalg.svd(rows, full_matrices=True)[2][:, 8].reshape(-1, 3, 3)
    u, s, vt = np.linalg.svd(solution)
    s[:, 2] = 0.0
    models: Floats = (u * s[:, None, :]) @ vt
    unit: Floats = models / np.maximum(np.linalg.norm(models, axis=(1, 2)), TINY)[:, None, None]
    return unit


def minimize_sampson(
    fundamental: Floats,
    first: Floats,
    second: Floats,
    weights: Floats | None = None,
    loss: Loss = "squared",
    scale: float = 0.0,
    max_iterations: int = 20,
) -> Floats:
    """Minimise the Sampson distance over matrices of rank 2, by Levenberg-Marquardt steps.

    F is ``U diag(cos p, sin p, 0) V'``; the seven parameters turn U, turn V and change p.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        Where to start; its smallest singular value is dropped.
    first, second : ndarray of shape (N, 2), float64
        Points of about unit size.
    weights : ndarray of shape (N,), float64, optional
        Weight of each squared distance.
    loss : {"squared", "cauchy"}
        Error of a distance r: ``r^2``, or ``c^2 log(1 + r^2 / c^2)`` with c in proportion to `scale`.
    scale : float
        Standard deviation of the noise of good points, for the robust loss.
    max_iterations : int
        Bound on the number of steps.

    Returns
    -------
    ndarray of shape (3, 3), float64
        The refined matrix, unit norm; never worse than the start without its smallest singular value.
    """
    u, s, vt = np.linalg.svd(fundamental)
    best = unit_norm((u * np.array([s[0], s[1], 0.0])) @ vt)
    if len(first) < 7 or not s[0] > 0:
        return best
    weight = np.ones(len(first)) if weights is None else weights
    width2 = (CAUCHY_TUNING * scale) ** 2 if loss == "cauchy" else math.inf
    rows = constraint_rows(first, second)
    distances, gradient = _sampson_gradient(best, first, second, rows)
    cost, damping = _cost(distances, weight, width2), DAMPING
    for _ in range(max_iterations):
        tangent = _tangent_space(best)
        jacobian = gradient @ tangent
        robust = weight / (1.0 + distances * distances / width2)
        normal = np.einsum("n,ni,nj->ij", robust, jacobian, jacobian)
        slope = np.einsum("n,ni->i", robust * distances, jacobian)
        candidate, step = best, np.zeros(7)
        for _ in range(8):
            step = -_solve(normal, slope, damping)
            candidate = _turned(best, step)
            new_distances, new_gradient = _sampson_gradient(candidate, first, second, rows)
            new_cost = _cost(new_distances, weight, width2)
            if new_cost <= cost:
                break
            damping *= 10.0
        else:
            return best
        decrease = cost - new_cost
        best, distances, gradient, cost = candidate, new_distances, new_gradient, new_cost
        damping *= 0.1
        if decrease <= 1e-12 * cost:
            break
    return best


def _cost(distances: Floats, weight: Floats, width2: float) -> float:
    squared = distances * distances
    if math.isfinite(width2):
        squared = width2 * np.log1p(squared / width2)
    return float((weight * squared).sum())


def _solve(normal: Floats, slope: Floats, damping: float) -> Floats:
    """Solve the damped normal equations; directions without any curvature are left alone."""
    values, vectors = np.linalg.eigh(normal)
    top = max(float(values[-1]), TINY)
    solution: Floats = vectors @ ((vectors.T @ slope) / (np.maximum(values, 1e-15 * top) + damping * top))
    return solution


def _sampson_gradient(
    fundamental: Floats, first: Floats, second: Floats, rows: Floats
) -> tuple[Floats, Floats]:
    """Return signed Sampson distances (N,) and their derivatives (N, 9) by the entries of F."""
    a = first @ fundamental[:, :2].T + fundamental[:, 2]
    b = second @ fundamental[:2] + fundamental[2]
    inverse = 1.0 / np.sqrt(np.maximum((a[:, :2] ** 2).sum(axis=1) + (b[:, :2] ** 2).sum(axis=1), TINY))
    distances: Floats = ((second * a[:, :2]).sum(axis=1) + a[:, 2]) * inverse
    gradient = rows * inverse[:, None]
    pull = -distances * inverse * inverse
    pa, pb = pull[:, None] * a[:, :2], pull[:, None] * b[:, :2]
    for i in range(2):
        gradient[:, 3 * i] += pa[:, i] * first[:, 0]
        gradient[:, 3 * i + 1] += pa[:, i] * first[:, 1]
        gradient[:, 3 * i + 2] += pa[:, i]
        gradient[:, i] += pb[:, i] * second[:, 0]
        gradient[:, 3 + i] += pb[:, i] * second[:, 1]
        gradient[:, 6 + i] += pb[:, i]
    return distances, gradient


def _tangent_space(fundamental: Floats) -> Floats:
    """Return the derivatives (9, 7) of the entries of F by the parameters of a step of `_turned`."""
    u, s, vt = np.linalg.svd(fundamental)
    diagonal = np.diag([s[0], s[1], 0.0])
    columns = [u @ skew(axis) @ diagonal @ vt for axis in np.eye(3)]
    columns += [-u @ diagonal @ skew(axis) @ vt for axis in np.eye(3)]
    columns.append(u @ np.diag([-s[1], s[0], 0.0]) @ vt)
    return np.stack([column.ravel() for column in columns], axis=1)


def _turned(fundamental: Floats, step: Floats) -> Floats:
    """Turn U by the first three and V by the next three parameters, and shift p by the last."""
    u, s, vt = np.linalg.svd(fundamental)
    angle = math.atan2(s[1], s[0]) + step[6]
    diagonal = np.array([math.cos(angle), math.sin(angle), 0.0])
    turned: Floats = (u @ _rotation(step[:3]) * diagonal) @ (_rotation(step[3:6]).T @ vt)
    return turned


def _rotation(vector: Floats) -> Floats:
    """Return the rotation about a vector, by the Cayley transform: orthogonal, no special case at 0."""
    half = skew(0.5 * vector)
    rotation: Floats = np.linalg.solve(np.eye(3) - half, np.eye(3) + half).astype(np.float64)
    return rotation


def robust_scale(fundamental: Floats, first: Floats, second: Floats, least: float) -> float:
    """Estimate the noise of points from their Sampson distances.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        A good estimate.
    first, second : ndarray of shape (N, 2), float64
        Points, fewer than half of them wrong.
    least : float
        Lower bound of the result, in the unit of the points.

    Returns
    -------
    float
        Standard deviation of the distances.
    """
    distances, _ = _sampson_gradient(fundamental, first, second, np.zeros((len(first), 9)))
    return max(least, noise_scale(distances, 7))
