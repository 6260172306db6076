"""Plane sweep of a virtual view in blocks: it has no picture, and two pictures are warped into it.

References
----------
[Maitre2008] Sec. 5.3.2: blocks of the virtual view are matched along their epipolar lines.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Floats, Singles
from dvc.geometry.plane_sweep import GRADIENT_LIMIT, LEVEL_LIMIT, OUTSIDE_COST, DepthHypotheses
from dvc.geometry.warping import warp_point

GOLDEN_STEPS = 6
"""Steps of the golden-section search; each keeps 0.618 of the interval."""
MIN_PARALLAX_PX = 0.05
"""Smallest displacement of a block by a search over two hypotheses that changes its depth."""


class VirtualView(NamedTuple):
    """A view without a picture, and two pictures of its scene."""

    features: tuple[Singles, Singles]  # `luma_features` of the pictures
    warps: tuple[Floats, Floats]  # from the view to each of them
    block_px: int  # side of the view's blocks


def block_costs(view: VirtualView, hypotheses: DepthHypotheses, spacing_px: float) -> NDArray[np.int16]:
    """Compare two pictures along the epipolar lines through each block of a virtual view."""
    height, width = view.features[0].shape[1:]
    rows, columns = -(-height // view.block_px), -(-width // view.block_px)
    cost = np.empty((rows, columns, hypotheses.num_hypotheses), np.int16)
    lowest, step, _ = hypotheses
    _block_cost(*view.features, *view.warps, lowest, step, view.block_px, spacing_px, cost)
    return cost


@kernel
def _block_cost(first, second, to_first, to_second, low, step, block, spacing, cost):
    """Compare two pictures along the epipolar lines through each block of a view, per hypothesis."""
    height, width = first.shape[1:]
    for i in range(cost.shape[0]):
        for j in range(cost.shape[1]):
            left = (j + 0.5) * block - 0.5 - 1.5 * spacing
            top = (i + 0.5) * block - 0.5 - 1.5 * spacing
            for hypothesis in range(cost.shape[2]):
                total = 0.0
                rho = low + hypothesis * step
                for k in range(16):
                    x, y = left + (k % 4) * spacing, top + (k // 4) * spacing
                    a, b, _ = warp_point(to_first, x, y, rho)
                    c, d, _ = warp_point(to_second, x, y, rho)
                    if not (_inside(a, b, width, height) and _inside(c, d, width, height)):
                        total += OUTSIDE_COST
                        continue
                    for m in range(3):
                        difference = _bilinear(first[m], a, b) - _bilinear(second[m], c, d)
                        total += min(abs(difference), np.float32(LEVEL_LIMIT if m == 0 else GRADIENT_LIMIT))
                cost[i, j, hypothesis] = np.int16(total / 16.0)


def refine_blocks(view: VirtualView, depth: Floats, reach: float, window_radius_px: int) -> Floats:
    """Refine the depths of the blocks of a virtual view by golden sections."""
    refined = depth.copy()
    (first, *_), (second, *_) = view.features
    _golden_search(first, second, *view.warps, view.block_px, window_radius_px, reach, refined)
    return refined


@kernel
def _golden_search(first, second, to_first, to_second, block, half, reach, depth):
    """Refine the inverse depth of each block within `reach` by golden sections, if it moves enough."""
    golden = 0.6180339887498949
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            x, y, rho = (j + 0.5) * block - 0.5, (i + 0.5) * block - 0.5, depth[i, j]
            low, high = rho - reach, rho + reach
            if _parallax(to_first, to_second, x, y, low, high) < MIN_PARALLAX_PX:
                continue
            start = _block_error(first, second, to_first, to_second, x, y, rho, half)
            a, b = high - golden * (high - low), low + golden * (high - low)
            at_a = _block_error(first, second, to_first, to_second, x, y, a, half)
            at_b = _block_error(first, second, to_first, to_second, x, y, b, half)
            for _ in range(GOLDEN_STEPS):
                if at_a <= at_b:
                    high, b, at_b = b, a, at_a
                    a = high - golden * (high - low)
                    at_a = _block_error(first, second, to_first, to_second, x, y, a, half)
                else:
                    low, a, at_a = a, b, at_b
                    b = low + golden * (high - low)
                    at_b = _block_error(first, second, to_first, to_second, x, y, b, half)
            if min(at_a, at_b) < start:
                depth[i, j] = a if at_a <= at_b else b


@kernel
def _block_error(first, second, to_first, to_second, x, y, rho, half):
    """Return the mean squared difference over a window around a point; huge if it leaves a picture."""
    height, width = first.shape
    total = 0.0
    for dy in range(-half, half + 1):
        for dx in range(-half, half + 1):
            a, b, _ = warp_point(to_first, x + dx, y + dy, rho)
            c, d, _ = warp_point(to_second, x + dx, y + dy, rho)
            if not (_inside(a, b, width, height) and _inside(c, d, width, height)):
                return 1e9
            difference = _bilinear(first, a, b) - _bilinear(second, c, d)
            total += difference * difference
    return total / ((2 * half + 1) * (2 * half + 1))


@kernel
def _parallax(to_first, to_second, x, y, low, high):
    """Return the largest displacement between both pictures under a change of depth."""
    a, b, _ = warp_point(to_first, x, y, low)
    c, d, _ = warp_point(to_first, x, y, high)
    e, f, _ = warp_point(to_second, x, y, low)
    g, h, _ = warp_point(to_second, x, y, high)
    return abs(c - a) + abs(d - b) + abs(g - e) + abs(h - f)


@kernel
def _bilinear(plane, x, y):
    """Interpolate a plane linearly inside the image."""
    height, width = plane.shape
    x0, y0 = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - x0, y - y0
    upper = plane[y0, x0] + fx * (plane[y0, x0 + 1] - plane[y0, x0])
    lower = plane[y0 + 1, x0] + fx * (plane[y0 + 1, x0 + 1] - plane[y0 + 1, x0])
    return upper + fy * (lower - upper)


@kernel
def _inside(x, y, width, height):
    """Return whether a position lies between pixel centres."""
    return 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0
