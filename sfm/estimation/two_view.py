"""What estimators of fundamental matrices and of homographies share: coordinates, and data."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfm.estimation.epipolar import unit_norm

Floats = NDArray[np.float64]


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


class CorrespondenceEstimator:
    """Data of an `sfm.estimation.sample_consensus.Estimator` of 3x3 matrices that relate two images.

    Models are in the coordinates of `scale`; residuals are Sampson distances in pixels.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Finite points in pixels.
    """

    def __init__(self, first: Floats, second: Floats) -> None:
        self.num_data = len(first)
        self.scale = SharedScale.of(first, second)
        self._first = (first - self.scale.first_px) / self.scale.scale_px
        self._second = (second - self.scale.second_px) / self.scale.scale_px
