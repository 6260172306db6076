"""What estimators of fundamental matrices and of homographies share: coordinates, and data."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfm.estimation.epipolar import unit_norm
from sfm.estimation.sample_consensus import Indices, Mask

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SharedScale:
    """Coordinates for both images: each has its centroid at 0, and both share one scale."""

    first_px: Floats  # centroids
    second_px: Floats
    scale_px: float  # pixels per unit

    @classmethod
    def of(cls, first: Floats, second: Floats) -> "SharedScale":
        """Fit the coordinates to points."""
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
        """Convert a fundamental matrix to pixels."""
        a, b = self.matrices()
        return unit_norm(b.T @ fundamental @ a)


class TwoViewEstimator(ABC):
    """Matrices (3, 3) that relate two images, as an `sfm.estimation.sample_consensus.Estimator`."""

    min_num_samples: int

    def __init__(self, first: Floats, second: Floats) -> None:
        self.num_data = len(first)
        self.scale = SharedScale.of(first, second)
        self._first = (first - self.scale.first_px) / self.scale.scale_px
        self._second = (second - self.scale.second_px) / self.scale.scale_px
        self._rows = self._equations()

    @abstractmethod
    def _equations(self) -> Floats:
        """Return linear equations (N, ..., 9) in the entries of a model."""

    @abstractmethod
    def _solve(self, rows: Floats) -> Floats:
        """Return the models (K, 3, 3) of samples of equations (S, m, ..., 9)."""

    @abstractmethod
    def _distances(self, models: Floats) -> Floats:
        """Return Sampson distances (K, N) in the coordinates of `scale`."""

    @abstractmethod
    def refine(self, model: Floats, inliers: Mask) -> Floats:  # numpydoc ignore=PR01,RT01
        """Improve one model over its inliers."""

    def estimate(self, samples: Indices) -> Floats:
        """Solve many samples at once."""
        return self._solve(self._rows[samples]) if len(samples) else np.empty((0, 3, 3))

    def residuals(self, models: Floats) -> Floats:
        """Measure all correspondences under all models."""
        return self._distances(models) * self.scale.scale_px
