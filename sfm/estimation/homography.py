"""Homographies from points: what a camera that only turns, or a plane, makes of an image."""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import homogeneous
from sfm.estimation.sample_consensus import Indices, Mask
from sfm.estimation.two_view import CorrespondenceEstimator

Floats = NDArray[np.float64]


class HomographyEstimator(CorrespondenceEstimator):
    """Homographies of sets of correspondences, as an `sfm.estimation.sample_consensus.Estimator`."""

    min_num_samples = 4

    def __init__(self, first: Floats, second: Floats) -> None:
        super().__init__(first, second)
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
