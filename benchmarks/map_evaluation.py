"""Evaluation of maps: new views rendered from frames with depth, and errors of trajectories."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dvc.arrays import Bytes, Floats
from dvc.geometry.view_synthesis import (
    FALLBACK_WEIGHT,
    SAME_SURFACE_PX,
    PictureWithDepth,
    SynthesisedView,
    drawn_depth,
    synthesise,
)
from dvc.geometry.viewpoints import CalibratedViewpoint, calibrated_warp
from dvc.geometry.warping import EMPTY, inverse_warp, warp_grid
from sfm.mapping.scene_map import MapPiece

NUM_SOURCES = 4
"""Number of frames that a view is rendered from: they fill each other's holes and average noise."""
DISTANCE_FLOOR = 0.1
"""Least distance in the weight of a frame, relative to that of the farthest frame chosen."""


class TrajectoryError(NamedTuple):
    """Distance of a trajectory from the truth after the best similarity."""

    rms: float  # root mean square distance between centres, in the unit of the truth
    length: float  # length of the true trajectory over the located frames
    num_located: int  # number of compared frames
    scale: float  # from the unit of the trajectory to that of the truth

    @property
    def relative(self) -> float:
        """Error relative to the length of the trajectory."""
        return self.rms / self.length if self.length > 0 else float("inf")


def centre(pose: Floats) -> Floats:
    """Return the position of a camera in the world."""
    return np.asarray(-pose[:, :3].T @ pose[:, 3])


def trajectory_error(poses: Mapping[int, Floats], truth: Mapping[int, Floats]) -> TrajectoryError:
    """Compare the camera centres of frames with a pose in both trajectories, after the best similarity.

    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    IEEE Trans. Pattern Anal. Mach. Intell. 13(4), 1991.
    """
    frames = sorted(poses.keys() & truth.keys())
    if len(frames) < 3:
        raise ValueError(f"three frames with both poses are needed, got {len(frames)}")
    estimated, true = (np.array([centre(each[frame]) for frame in frames]) for each in (poses, truth))
    a, b = estimated - estimated.mean(axis=0), true - true.mean(axis=0)
    U, singular, Vt = np.linalg.svd(b.T @ a / len(a))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    variance = float((a * a).sum() / len(a))
    scale = float((singular * sign).sum()) / variance if variance > 0 else 1.0
    rms = float(np.sqrt(((scale * a @ ((U * sign) @ Vt).T - b) ** 2).sum(axis=1).mean()))
    length = float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return TrajectoryError(rms, length, len(frames), scale)


def render_view(
    piece: MapPiece, pictures: Mapping[int, Bytes], pose: Floats, num_sources: int = NUM_SOURCES
) -> SynthesisedView:
    """Render the view of a pose from pictures (H, W, C) of the frames with depth, by frame index."""
    depths = [float(np.nanmedian(depth)) for depth in piece.depths.values() if np.isfinite(depth).any()]
    scale = float(np.median(depths)) if depths else 1.0

    def difference(frame: int) -> float:
        candidate = piece.poses[frame]
        turned = float(np.trace(candidate[:, :3] @ pose[:, :3].T))
        angle = float(np.arccos(np.clip(0.5 * (turned - 1.0), -1.0, 1.0)))
        return float(np.linalg.norm(centre(candidate) - centre(pose))) / scale + angle

    chosen = sorted(piece.depths, key=difference)[:num_sources]  # those with the most similar poses
    if not chosen:
        raise ValueError("`piece` must have a frame with depth")
    distances = np.array([np.linalg.norm(centre(piece.poses[k]) - centre(pose)) for k in chosen])
    floor = DISTANCE_FLOOR * max(float(distances.max()), 1e-12)
    weights = floor / np.maximum(distances, floor)
    target, sources = CalibratedViewpoint(piece.intrinsics, pose), []
    for frame, weight in zip(chosen, weights, strict=True):
        depth = piece.depths[frame].astype(np.float64)
        inverse = np.where(np.isfinite(depth), 1.0 / depth, 0.0)  # unknown depth is mostly sky
        warp = calibrated_warp(CalibratedViewpoint(piece.intrinsics, piece.poses[frame]), target)
        sources.append(PictureWithDepth(pictures[frame], inverse, warp, weight=float(weight)))
    shape = piece.depths[chosen[0]].shape
    return synthesise(sources, shape, agreed_surface(sources, [drawn_depth(one, shape) for one in sources]))


def agreed_surface(sources: Sequence[PictureWithDepth], drawn: Sequence[Floats]) -> Floats:
    """Choose the depth with the largest weight of agreeing sources: a wrong one covers nothing."""
    backs = [inverse_warp(source.warp) for source in sources]
    chosen, most = np.full(drawn[0].shape, EMPTY), np.zeros(drawn[0].shape)
    for depth in drawn:
        votes = np.zeros(depth.shape)
        for source, back, other in zip(sources, backs, drawn, strict=True):
            both = (depth > EMPTY) & (other > EMPTY)
            first, second = (warp_grid(back, np.where(both, plane, 0.0)) for plane in (depth, other))
            same = np.hypot(*(first - second)[..., :2].transpose(2, 0, 1)) <= SAME_SURFACE_PX
            votes += np.where(both & same, max(source.weight, FALLBACK_WEIGHT), 0.0)
        better = (votes > most) | ((votes == most) & (depth > chosen))
        chosen, most = np.where(better, depth, chosen), np.where(better, votes, most)
    return chosen
