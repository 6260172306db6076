"""Triangulation: depths of points that two views see, or many."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dvc.arrays import Floats, Mask
from dvc.geometry.cameras import PixelFrame, homogeneous
from dvc.geometry.warping import warp_matrix

NUM_STEPS = 6
"""Gauss-Newton steps; the problem has one unknown a point, and is nearly linear."""
MIN_DEPTH = 1e-6
"""Smallest third coordinate of a point that a view sees."""


def triangulate_depth(first: Floats, camera: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Find the projective depths of correspondences, by least squares of (5.3)."""
    a = homogeneous(first) @ camera[:, :3].T
    b, t = homogeneous(second), camera[:, 3]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    at, bt = a @ t, b @ t
    determinant = aa * bb - ab * ab
    with np.errstate(divide="ignore", invalid="ignore"):
        return (ab * bt - bb * at) / determinant, (aa * bt - ab * at) / determinant


def inverse_depths(first: Floats, camera: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Find the inverse depths that project points of the first image nearest to points of the second."""
    a, t = homogeneous(first) @ camera[:, :3].T, camera[:, 3]
    lines = np.cross(t, a)
    norm2 = (lines[:, :2] ** 2).sum(axis=1)
    offset = (lines[:, :2] * second).sum(axis=1) + lines[:, 2]
    foot = homogeneous(second - (offset / np.where(norm2 > 0, norm2, np.inf))[:, None] * lines[:, :2])
    along, across = np.cross(foot, t), np.cross(foot, a)
    along2 = (along * along).sum(axis=1)
    inverse = -(along * across).sum(axis=1) / np.where(along2 > 0, along2, np.inf)
    return inverse, a[:, 2] + inverse * t[2]


class TrackDepths(NamedTuple):
    """Depths of tracked points in one view."""

    # inverse depth in that view; NaN for points that are not in it, or in no other view
    inverse_depth: Floats
    # root mean square distance between positions in the other views and projections
    rms_px: Floats
    # standard deviation of the projection into the most sensitive of the views that see the point, if
    # positions have an error of one pixel
    sigma_px: Floats


def track_depths(
    positions: Floats, cameras: Sequence[Floats | None], view: int, frame: PixelFrame
) -> TrackDepths:
    """Find the inverse depths in one view that project points nearest to their positions in other views."""
    source = cameras[view]
    if source is None:
        raise ValueError(f"view {view} has no camera")
    points = positions[:, view]
    defined: Mask = np.asarray(np.isfinite(points).all(axis=1))
    rays = np.column_stack([np.where(defined[:, None], points, 0.0), np.ones(len(points))])
    targets = [(k, camera) for k, camera in enumerate(cameras) if camera is not None and k != view]
    warps = [warp_matrix(source, camera, frame) for _, camera in targets]
    seen = [positions[:, k] for k, _ in targets]
    size = np.array([frame.width_px, frame.height_px])
    inverse = np.zeros(len(points))
    for step in range(NUM_STEPS + 1):
        sums = np.zeros((4, len(points)))
        farthest = np.zeros(len(points))
        for warp, there in zip(warps, seen, strict=True):
            image = rays @ warp[:, :3].T + inverse[:, None] * warp[:, 3]
            depth = np.maximum(image[:, 2:], MIN_DEPTH)
            position = image[:, :2] / depth
            change = (warp[:2, 3] - position * warp[2, 3]) / depth
            used: Mask = defined & np.asarray(np.isfinite(there).all(axis=1))
            offset = np.where(used[:, None], there - position, 0.0)
            squares = (change * change).sum(axis=1)
            inside = (image[:, 2] > MIN_DEPTH) & ((position >= 0) & (position < size)).all(axis=1)
            farthest = np.where(used | inside, np.maximum(farthest, squares), farthest)
            sums += np.stack(
                [used * squares, (change * offset).sum(axis=1), (offset * offset).sum(axis=1), 1.0 * used]
            )
        information, slope, error, count = sums
        determined = (count > 0) & (information > 0)
        safe = np.where(determined, information, 1.0)
        if step < NUM_STEPS:
            inverse = inverse + np.where(determined, slope / safe, 0.0)
    return TrackDepths(
        np.where(determined, inverse, np.nan),
        np.where(determined, np.sqrt(error / np.maximum(count, 1.0)), np.inf),
        np.where(determined, np.sqrt(farthest / safe), np.inf),
    )
