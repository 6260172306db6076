"""Fundamental matrices from points: seven points, and many points."""

import numpy as np
from numpy.typing import NDArray

from sfm.decompositions import least_singular, real_roots, right_singular
from sfm.estimation.epipolar import TINY
from sfm.estimation.sample_consensus import Mask
from sfm.estimation.sampson import constraint_rows, minimize_sampson
from sfm.estimation.two_view import TwoViewEstimator

Floats = NDArray[np.float64]


class FundamentalEstimator(TwoViewEstimator):
    """Fundamental matrices; seven points have one or three, more points one, all of rank 2."""

    min_num_samples = 7

    def _equations(self) -> Floats:
        return constraint_rows(self._first, self._second)

    def _solve(self, rows: Floats) -> Floats:
        return seven_point(rows) if rows.shape[1] == self.min_num_samples else eight_point(rows)

    def _distances(self, models: Floats) -> Floats:
        x, y = self._first[:, 0], self._first[:, 1]
        u, v = self._second[:, 0], self._second[:, 1]
        f = models.reshape(-1, 9, 1)
        a, b, c = (f[:, k] * x + f[:, k + 1] * y + f[:, k + 2] for k in (0, 3, 6))
        d, e = (f[:, k] * u + f[:, k + 3] * v + f[:, k + 6] for k in (0, 1))
        squared_gradient = a * a + b * b + d * d + e * e
        distances: Floats = np.abs(u * a + v * b + c) / np.sqrt(np.maximum(squared_gradient, TINY))
        return distances

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Minimise the sum of squared Sampson distances of the inliers."""
        return minimize_sampson(model, self._first[inliers], self._second[inliers], max_iterations=5)


def seven_point(rows: Floats) -> Floats:
    """Find the matrices of rank 2 that satisfy seven equations."""
    null = right_singular(rows)[1][:, 7:].reshape(-1, 2, 3, 3)
    a, b = null[:, 0], null[:, 1]
    # det(z a + b) is a cubic in z: its outer coefficients are determinants, the others follow from z = 1, -1.
    c3, c0 = _determinants(a), _determinants(b)
    plus, minus = _determinants(a + b), _determinants(b - a)
    c2, c1 = 0.5 * (plus + minus) - c0, 0.5 * (plus - minus) - c3
    usable = np.abs(c3) > 1e-12 * (np.abs(c2) + np.abs(c1) + np.abs(c0) + TINY)
    a, b, c3 = a[usable], b[usable], c3[usable]
    roots = real_roots(np.stack([c0[usable], c1[usable], c2[usable], c3], axis=1))
    sample, which = np.nonzero(np.isfinite(roots))
    z = roots[sample, which][:, None, None]
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
    """Find matrices of rank 2 that nearly satisfy more than seven equations."""
    solution = least_singular(rows).reshape(-1, 3, 3)
    last = least_singular(solution)[:, :, None]
    models: Floats = solution - (solution @ last) @ last.transpose(0, 2, 1)
    unit: Floats = models / np.maximum(np.linalg.norm(models, axis=(1, 2)), TINY)[:, None, None]
    return unit
