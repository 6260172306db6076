"""Rendering of depth views into another view: forward with z-test, hole filling, and visibility.

Depth maps are drawn in depth order, reliable parts first; pixels that nothing reaches take the depth behind.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Floats, Mask
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.continuation import CONSISTENT, OCCLUDED, OUTSIDE, DepthMap, OtherView, fill_depth
from dvc.geometry.depth_maps import DepthView
from dvc.geometry.warping import EMPTY, warp_grid, warp_matrix, warp_point

OUTSIDE_WEIGHT, OCCLUDED_WEIGHT, EDGE_WEIGHT = 1e-6, 1e-4, 0.02
"""Weights of a view for points outside it, occluded, or next to something nearer; 1 for other points."""
PIECE = 0.5
"""Extent of each pixel next to a discontinuity, in pixels."""
VISIBILITY_TOLERANCE_PX = 1.0
"""Largest parallax between a point that a view sees and the surface that it shows there."""
HALO_PX = 1
"""Width of the border next to nearer surfaces, in which pixels mix both."""


def render_depth(views: Sequence[DepthView], camera: Floats, frame: PixelFrame) -> DepthMap:
    """Draw the depth of some views into another view."""
    reliable = np.full((frame.height_px, frame.width_px), EMPTY)
    rest = reliable.copy()
    for view in views:
        warp, known = warp_matrix(view.camera, camera, frame), view.depth.reliable
        doubtful = ~(known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:])
        for buffer, chosen in ((reliable, ~doubtful), (rest, doubtful)):
            draw(view.depth.inverse_depth, warp, view.discontinuities, chosen, buffer)
    drawn = reliable > EMPTY
    visibility = np.where(drawn, CONSISTENT, OCCLUDED).astype(np.int8)
    return DepthMap(fill_holes(np.where(drawn, reliable, rest)), visibility)


def draw(inverse_depth: Floats, warp: Floats, discontinuities: Mask, chosen: Mask, nearest: Floats) -> None:
    """Draw a depth map into another view, in front of surfaces behind it."""
    vertices = warp_grid(warp, inverse_depth)
    _rasterise(vertices, discontinuities | ~chosen, nearest)
    _rasterise_discontinuities(warp, inverse_depth, discontinuities & chosen, nearest)


@kernel
def _rasterise(positions, skipped, nearest):
    """Draw the triangles of a grid except skipped cells; `nearest` keeps the largest inverse depth."""
    for i in range(positions.shape[0] - 1):
        for j in range(positions.shape[1] - 1):
            if skipped[i, j]:
                continue
            _rasterise_triangle(positions[i, j], positions[i, j + 1], positions[i + 1, j], nearest)
            _rasterise_triangle(positions[i + 1, j + 1], positions[i + 1, j], positions[i, j + 1], nearest)


@kernel
def _rasterise_triangle(a, b, c, nearest):
    """Draw a triangle; its inverse depth is affine in the image."""
    height, width = nearest.shape
    if a[2] == EMPTY or b[2] == EMPTY or c[2] == EMPTY:
        return
    left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
    top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    if right < 0 or bottom < 0 or left > width - 1 or top > height - 1:
        return
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if not 1e-9 < area < np.inf:
        return
    left, right = max(left, 0.0), min(right, width - 1.0)
    top, bottom = max(top, 0.0), min(bottom, height - 1.0)
    for y in range(int(np.ceil(top)), int(np.floor(bottom)) + 1):
        for x in range(int(np.ceil(left)), int(np.floor(right)) + 1):
            weight_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
            weight_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
            if weight_b < -1e-9 or weight_c < -1e-9 or weight_b + weight_c > 1.0 + 1e-9:
                continue
            rho = a[2] + weight_b * (b[2] - a[2]) + weight_c * (c[2] - a[2])
            nearest[y, x] = max(nearest[y, x], rho)


@kernel
def _rasterise_discontinuities(warp, depth, chosen, nearest):
    """Draw the pieces of discontinuous cells: each at the depth of its corner, `PIECE` of a cell wide."""
    corners = np.empty((4, 3))
    for i in range(chosen.shape[0]):
        for j in range(chosen.shape[1]):
            if not chosen[i, j]:
                continue
            for k in range(4):
                y, x = i + k // 2, j + k % 2
                rho = depth[y, x]
                dy, dx = PIECE * (1 - 2 * (k // 2)), PIECE * (1 - 2 * (k % 2))
                top, bottom = y + min(0.0, dy), y + max(0.0, dy)
                left, right = x + min(0.0, dx), x + max(0.0, dx)
                for m in range(4):
                    x_m, y_m = right if m % 2 == 1 else left, bottom if m // 2 == 1 else top
                    corners[m, 0], corners[m, 1], w = warp_point(warp, x_m, y_m, rho)
                    corners[m, 2] = rho / w if w >= 1e-6 else EMPTY
                _rasterise_triangle(corners[0], corners[1], corners[2], nearest)
                _rasterise_triangle(corners[3], corners[2], corners[1], nearest)


def render_grid(vertices: Floats, shape: tuple[int, ...]) -> Floats:
    """Draw a connected grid of vertices."""
    drawn = np.full(shape, EMPTY)
    _rasterise(vertices, np.zeros((vertices.shape[0] - 1, vertices.shape[1] - 1), dtype=bool), drawn)
    return fill_holes(drawn)


def fill_holes(inverse_depth: Floats) -> Floats:
    """Fill pixels without depth from the farthest surface around them."""
    empty = inverse_depth <= EMPTY
    if empty.all():
        return np.zeros_like(inverse_depth)
    filled = inverse_depth
    outside = np.full(empty.shape, OUTSIDE, np.int8)
    # pixels that no ray reaches in eight directions are reached from filled ones
    while empty.any():
        visibility = np.where(empty, OUTSIDE, CONSISTENT).astype(np.int8)
        even, slopes, no_warp = np.zeros(empty.shape), np.zeros((*empty.shape, 2)), np.zeros((3, 4))
        no_view = OtherView(no_warp, no_warp, filled, outside, 0.0)
        filled = fill_depth(filled, visibility, even, slopes, 0.0, 0.0, no_view)
        empty = filled <= EMPTY
    return filled


def visibility_weights(view: DepthView, positions: Floats) -> Floats:
    """Return weights for how well a view sees points."""
    return np.asarray(_visibility_weights(positions, *view.depth, view.to_other))


@kernel
def _visibility_weights(positions, depth, visibility, back):
    """Weigh points (x, y, inverse depth) by their visibility: 1, edge, occluded or outside."""
    height, width = depth.shape
    weights = np.empty(positions.shape[:2])
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            u, v, rho = positions[i, j, 0], positions[i, j, 1], positions[i, j, 2]
            weights[i, j] = OUTSIDE_WEIGHT
            if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
                continue
            a, b, _ = warp_point(back, u, v, rho)
            column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
            free, near = 0, 0
            for y in range(max(row - HALO_PX, 0), min(row + HALO_PX + 1, height)):
                for x in range(max(column - HALO_PX, 0), min(column + HALO_PX + 1, width)):
                    blocked = False
                    if depth[y, x] > rho and visibility[y, x] == CONSISTENT:
                        c, d, _ = warp_point(back, u, v, depth[y, x])
                        blocked = abs(c - a) + abs(d - b) > VISIBILITY_TOLERANCE_PX
                    if blocked:
                        near = 1
                    elif abs(y - row) <= 1 and abs(x - column) <= 1:
                        free += 1
            if free == 0:
                weights[i, j] = OCCLUDED_WEIGHT
            else:
                weights[i, j] = EDGE_WEIGHT if near else 1.0
    return weights
