"""Homographies from points: what a camera that only turns, or a plane, makes of an image."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import homogeneous
from sfm.decompositions import least_singular
from sfm.estimation.sample_consensus import Mask
from sfm.estimation.two_view import TwoViewEstimator

Floats = NDArray[np.float64]


class HomographyEstimator(TwoViewEstimator):
    """Homographies, one for each sample of four points or more."""

    min_num_samples = 4

    def _equations(self) -> Floats:
        a, zero = homogeneous(self._first), np.zeros((self.num_data, 3))
        horizontal = np.hstack([a, zero, -self._second[:, :1] * a])
        vertical = np.hstack([zero, a, -self._second[:, 1:] * a])
        return np.stack([horizontal, vertical], axis=1)

    def _solve(self, rows: Floats) -> Floats:
        equations = rows.reshape(len(rows), -1, 9)
        solution: Floats = least_singular(equations).reshape(-1, 3, 3)
        return solution

    def _distances(self, models: Floats) -> Floats:
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
        distances: Floats = np.sqrt(np.maximum(squared, 0.0))
        return distances

    def refine(self, model: Floats, inliers: Mask) -> Floats:
        """Fit the inliers by linear least squares, reweighted so that the distance in the image counts."""
        points = homogeneous(self._first[inliers])
        for _ in range(3):
            depth = points @ model[2]
            weight = 1.0 / np.maximum(np.abs(depth), 1e-6)
            rows = self._rows[inliers] * weight[:, None, None]
            normal = np.einsum("nki,nkj->ij", rows, rows)
            model = least_singular(normal).reshape(3, 3)
        return model
