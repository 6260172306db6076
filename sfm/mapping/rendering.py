"""New views of a map: the nearest frames with depth, drawn into a wanted pose."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.view_synthesis import PictureWithDepth, SynthesisedView, agreed_surface, synthesise
from dvc.geometry.viewpoints import CalibratedViewpoint, calibrated_warp
from sfm.mapping.scene_map import MapPiece
from sfm.mapping.trajectory import centre

Floats = NDArray[np.float64]

NUM_SOURCES = 4
"""Frames that a view is made of: what one does not see another one does, and their noise is averaged."""
DISTANCE_FLOOR = 0.1
"""Least distance that weighs a frame, relative to that of the farthest one chosen."""


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
