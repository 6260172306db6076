"""Rendering of depth views into another view: forward with z-test, hole filling, and what each view sees.

Depth maps are drawn into the wanted view with depth order, reliable parts first; what nothing reaches takes
the depth behind it. Its pixels may then be fetched from every view that sees them (a backward warp).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.depth_maps import DepthMap, DepthView, Visibility
from dvc.geometry.warping import warp_grid, warp_matrix

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

EMPTY = _kernels.EMPTY
"""Inverse depth where nothing was drawn."""
OCCLUDED_WEIGHT = _kernels.OCCLUDED_WEIGHT
"""Weight of a view for a point that it does not see; above it, the view sees at least something beside it."""
PIECE = 0.5
"""How far each pixel beside a discontinuity extends, in pixels."""
VISIBILITY_TOLERANCE_PX = 1.0
"""Largest parallax between a point and what a view shows there, if it sees the point."""
HALO_PX = 1
"""Pixels beside something nearer mix both, and are avoided."""


def render_depth(views: Sequence[DepthView], camera: Floats, frame: PixelFrame) -> DepthMap:
    """Draw the depth of some views into another one."""
    reliable = np.full((frame.height_px, frame.width_px), EMPTY)
    rest = reliable.copy()
    for view in views:
        warp = warp_matrix(view.camera, camera, frame)
        doubtful = _cells(~view.depth.reliable)
        for buffer, chosen in ((reliable, ~doubtful), (rest, doubtful)):
            draw(view.depth.inverse_depth, warp, view.discontinuities, chosen, buffer)
    drawn = reliable > EMPTY
    visibility = np.where(drawn, Visibility.CONSISTENT, Visibility.OCCLUDED).astype(np.int8)
    return DepthMap(fill_holes(np.where(drawn, reliable, rest)), visibility)


def draw(inverse_depth: Floats, warp: Floats, discontinuities: Mask, chosen: Mask, nearest: Floats) -> None:
    """Draw a depth map into another view, before what lies behind it there."""
    vertices = warp_grid(warp, inverse_depth)
    _kernels.rasterise(vertices, discontinuities | ~chosen, nearest)
    _kernels.rasterise_discontinuities(warp, inverse_depth, discontinuities & chosen, PIECE, nearest)


def render_grid(vertices: Floats, shape: tuple[int, ...]) -> Floats:
    """Draw a grid of vertices that is one piece."""
    drawn = np.full(shape, EMPTY)
    _kernels.rasterise(vertices, np.zeros((vertices.shape[0] - 1, vertices.shape[1] - 1), dtype=bool), drawn)
    return fill_holes(drawn)


def _cells(points: Mask) -> Mask:
    """Cells with at least one of their four corners in a set."""
    cells: Mask = points[:-1, :-1] | points[:-1, 1:] | points[1:, :-1] | points[1:, 1:]
    return cells


def fill_holes(inverse_depth: Floats) -> Floats:
    """Give what nothing was drawn on the depth of what is around and behind it."""
    empty = inverse_depth <= EMPTY
    if empty.all():
        return np.zeros_like(inverse_depth)
    filled = inverse_depth
    nowhere = np.full(empty.shape, Visibility.OUTSIDE, np.int8)
    # what no ray reaches in eight directions is reached from what has been filled
    while empty.any():
        visibility = np.where(empty, Visibility.OUTSIDE, Visibility.CONSISTENT).astype(np.int8)
        even, slopes, none = np.zeros(empty.shape), np.zeros((*empty.shape, 2)), np.zeros((3, 4))
        source, filled = filled, np.empty(empty.shape)
        how = _kernels.Continuation(1.0, 0.0, 0.0)
        nobody = _kernels.OtherView(none, none, source, nowhere, 0.0)
        _kernels.fill_depth(source, visibility, even, slopes, how, nobody, filled)
        empty = filled <= EMPTY
    return filled


def visibility_weights(view: DepthView, positions: Floats) -> Floats:
    """Weigh how well a view sees points."""
    weights = np.empty(positions.shape[:2])
    depth = view.depth
    _kernels.visibility_weights(
        positions,
        depth.inverse_depth,
        depth.visibility,
        view.to_other,
        HALO_PX,
        VISIBILITY_TOLERANCE_PX,
        weights,
    )
    return weights
