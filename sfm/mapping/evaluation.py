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

from dvc.geometry.view_synthesis import PictureWithDepth, SynthesisedView, agreed_surface, synthesise
from dvc.geometry.viewpoints import CalibratedViewpoint, calibrated_warp
from sfm.mapping.scene_map import MapPiece

Floats = NDArray[np.float64]

NUM_SOURCES = 4
"""Frames that a view is made of: what one does not see another one does, and their noise is averaged."""
DISTANCE_FLOOR = 0.1
"""Least distance that weighs a frame, relative to that of the farthest one chosen."""


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


def nearest_frames(piece: MapPiece, pose: Floats, count: int = NUM_SOURCES) -> list[int]:
    """Return the frames with depth that look most alike, nearest first."""
    scale = _typical_depth(piece)

    def difference(frame: int) -> float:
        own = piece.poses[frame]
        turned = float(np.trace(own[:, :3] @ pose[:, :3].T))
        angle = float(np.arccos(np.clip(0.5 * (turned - 1.0), -1.0, 1.0)))
        return float(np.linalg.norm(centre(own) - centre(pose))) / scale + angle

    return sorted(piece.depths, key=difference)[:count]


def render_view(
    piece: MapPiece, pictures: Mapping[int, NDArray[np.uint8]], pose: Floats, num_sources: int = NUM_SOURCES
) -> SynthesisedView:
    """Render the view of a pose from pictures (H, W, C) of the frames with depth, by number of frame."""
    chosen = nearest_frames(piece, pose, num_sources)
    if not chosen:
        raise ValueError("`piece` must have a frame with depth")
    distances = np.array([np.linalg.norm(centre(piece.poses[k]) - centre(pose)) for k in chosen])
    floor = DISTANCE_FLOOR * max(float(distances.max()), 1e-12)
    weights = floor / np.maximum(distances, floor)
    sources = []
    for frame, weight in zip(chosen, weights, strict=True):
        depth = piece.depths[frame].astype(np.float64)
        inverse = np.where(np.isfinite(depth), 1.0 / depth, 0.0)  # what is not known is mostly sky
        warp = warp_to(piece, piece.poses[frame], pose)
        sources.append(PictureWithDepth(pictures[frame], inverse, warp, weight=float(weight)))
    return synthesise(sources, piece.depths[chosen[0]].shape, agreed_surface)


def warp_to(piece: MapPiece, source: Floats, target: Floats) -> Floats:
    """Return the warp from one pose to another, in pixels; see `dvc.geometry.warping`."""
    return calibrated_warp(*(CalibratedViewpoint(piece.intrinsics, pose) for pose in (source, target)))


def _typical_depth(piece: MapPiece) -> float:
    depths = [float(np.nanmedian(depth)) for depth in piece.depths.values() if np.isfinite(depth).any()]
    return float(np.median(depths)) if depths else 1.0
