"""Comparison of trajectories: the similarity that brings one nearest to another, and what is left.

References
----------
[Umeyama1991] S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
IEEE Trans. Pattern Anal. Mach. Intell. 13(4), 1991.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Similarity(NamedTuple):
    """A similarity transform: ``scale * R x + t``."""

    scale: float
    R: Floats
    t: Floats

    def apply(self, points: Floats) -> Floats:
        """Transform points (N, 3)."""
        return np.asarray(self.scale * points @ self.R.T + self.t)


class TrajectoryError(NamedTuple):
    """How far a trajectory is from the truth after the best similarity."""

    rms: float  # of the distances between centres, in the unit of the truth
    length: float  # of the true trajectory of the located frames
    num_located: int  # frames that are compared
    scale: float  # from the unit of the trajectory to that of the truth

    @property
    def relative(self) -> float:
        """Error relative to the length of the trajectory."""
        return self.rms / self.length if self.length > 0 else float("inf")


def centre(pose: Floats) -> Floats:
    """Return where a camera stands."""
    return np.asarray(-pose[:, :3].T @ pose[:, 3])


def align(source: Floats, target: Floats) -> Similarity:
    """Find the similarity that brings points nearest to others [Umeyama1991]."""
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < 3:
        raise ValueError(f"three pairs of points are needed, got shapes {source.shape} and {target.shape}")
    means = source.mean(axis=0), target.mean(axis=0)
    a, b = source - means[0], target - means[1]
    U, singular, Vt = np.linalg.svd(b.T @ a / len(a))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = (U * sign) @ Vt
    variance = float((a * a).sum() / len(a))
    scale = float((singular * sign).sum()) / variance if variance > 0 else 1.0
    return Similarity(scale, R, means[1] - scale * R @ means[0])


def trajectory_error(poses: Mapping[int, Floats], truth: Mapping[int, Floats]) -> TrajectoryError:
    """Compare the camera centres of frames that both have."""
    frames = sorted(poses.keys() & truth.keys())
    own, true = (np.array([centre(each[frame]) for frame in frames]) for each in (poses, truth))
    similarity = align(own, true)
    rms = float(np.sqrt(((similarity.apply(own) - true) ** 2).sum(axis=1).mean()))
    length = float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return TrajectoryError(rms, length, len(frames), similarity.scale)
