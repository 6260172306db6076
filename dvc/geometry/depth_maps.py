"""Depth maps of two views: dense inverse depth, its discontinuities, and its visibility in the other view.

The plane sweep gives both views a depth. Points on which both agree are consistent. Points outside the other
view or without agreement continue the planes of consistent neighbours, across as few edges as possible, and
not to a position that the other view looks through: a point that it does not see must be occluded there.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Mask
from dvc.geometry.cameras import ViewPair
from dvc.geometry.continuation import (
    CONSISTENT,
    OCCLUDED,
    OUTSIDE,
    DepthMap,
    OtherView,
    Slopes,
    continue_surfaces,
    is_transparent,
)
from dvc.geometry.plane_sweep import GRADIENT_SWEEP, SweepSettings, depth_hypotheses, sweep_views
from dvc.geometry.warping import inverse_warp, warp_matrix, warp_point

Luma = Bytes

AGREEMENT_PX = 1.5
"""Largest distance, there and back, between points on which two maps agree: a pixel, and both errors."""
MIN_CONFIDENCE = 20.0
"""Smallest confidence of a consistent depth, in costs of the sweep: the noise of eight directions."""
MIN_REGION_PX = 40
"""Smallest consistent region; smaller ones are speckles, accidental matches."""
TRACK_RADIUS_PX = 8.0
"""Radius around a known point in which its depth replaces inconsistent depth: half a macroblock."""
MAX_STRETCH = 1.0
"""Largest extension of the range of depth by a known point, as a share of it: it may be wrong."""
SLOPE_RADIUS_PX = 8
"""Radius in which the slope of a surface is measured: wide against the steps of the hypotheses."""
SLOPE_SPACING_PX = 2
"""Spacing of the points that measure it."""
MAX_CONTINUATION_PX = 40.0
"""Reach of slopes; farther away their error would be larger than that of constant depth."""
MEDIAN_RADIUS_PX = 5
"""Radius of the median that aligns depth with edges of the image, which the sweep blurs."""
MEDIAN_LEVELS = 8.0
"""Difference in luma that quarters the weight of a neighbour in this median."""
_WEIGHTS_BY_LEVEL = 1.0 / (1.0 + (np.arange(256) / MEDIAN_LEVELS) ** 2) ** 2
_SQUARED_OFFSETS = np.add.outer(*2 * [np.arange(-MEDIAN_RADIUS_PX, MEDIAN_RADIUS_PX + 1) ** 2])
_WEIGHTS_BY_OFFSET = 1.0 / (1.0 + 2.0 * _SQUARED_OFFSETS / MEDIAN_RADIUS_PX**2)
DISCONTINUITY_PX = 1.5
"""Largest difference of motion between neighbours on one surface."""


@dataclass(frozen=True, eq=False)
class DepthView:
    """A picture with its camera and its depth."""

    luma: Luma
    camera: Floats  # in normalised coordinates
    depth: DepthMap  # depth of the picture, checked with the other view
    discontinuities: Mask  # cells between four pixels of different surfaces
    to_other: Floats  # warp to the other view


class KnownDepth(NamedTuple):
    """Depth of a view from other views than the two that are compared."""

    depth: DepthMap | None  # result of earlier pairs of views
    points: Floats  # known points (x, y) in pixels, inside the frame
    inverse_depth: Floats  # inverse depth of each
    is_settled: bool = False  # whether the depth is taken as it is


Known = tuple[KnownDepth | None, KnownDepth | None]
Warps = tuple[Floats, Floats]
"""Warps from a view to the other one and back."""


def estimate_depths(
    pair: ViewPair,
    first: Luma,
    second: Luma,
    known: Known = (None, None),
    settings: SweepSettings = GRADIENT_SWEEP,
) -> tuple[DepthView, DepthView]:
    """Estimate the depth of two views."""
    there = warp_matrix(*pair.cameras, pair.pixel_frame)
    back = inverse_warp(there)
    lumas, warps = (first, second), ((there, back), (back, there))
    swept = [
        _swept(lumas[k], lumas[1 - k], warps[k][0], pair.inverse_depth_ranges[k], known[k], settings)
        for k in (0, 1)
    ]
    maps = [_with_points(checked_depth(swept[k], swept[1 - k][0], *warps[k]), known[k]) for k in (0, 1)]
    maps = [_continued(lumas[k], maps[k], maps[1 - k], warps[k]) for k in (0, 1)]
    maps = [_aligned(lumas[k], maps[k], maps[1 - k], warps[k]) for k in (0, 1)]
    first_view, second_view = (
        DepthView(luma, camera, depth, discontinuities(depth.inverse_depth, to_other), to_other)
        for luma, camera, depth, (to_other, _) in zip(lumas, pair.cameras, maps, warps, strict=True)
    )
    return first_view, second_view


def checked_depth(
    estimate: tuple[Floats, Floats], other: Floats, there: Floats, back: Floats | None = None
) -> DepthMap:
    """Check inverse depths with confidence against another view; consistent depth is sure and no speckle."""
    depth, confidence = estimate
    back = inverse_warp(there) if back is None else back
    visibility = _check_consistency(depth, other, there, back, AGREEMENT_PX)
    visibility[(visibility == CONSISTENT) & (confidence < MIN_CONFIDENCE)] = OCCLUDED
    return without_speckles(DepthMap(depth, visibility))


def completed_depth(luma: Luma, own: DepthMap, other: DepthMap, there: Floats) -> DepthMap:
    """Continue consistent depth over the rest, and align its discontinuities with edges of the picture."""
    warps = there, inverse_warp(there)
    return _aligned(luma, _continued(luma, own, other, warps), other, warps)


def without_speckles(depth: DepthMap) -> DepthMap:
    """Mark small consistent regions as occluded if they disagree with their surroundings."""
    visibility, inverse = depth.visibility.copy(), depth.inverse_depth
    span = float(np.ptp(inverse)) + 1e-300
    levels = ((inverse - inverse.min()) / span * 30000.0).astype(np.int16)
    levels[visibility != CONSISTENT] = -1
    cv2.filterSpeckles(levels, -1, MIN_REGION_PX, 600)
    visibility[(levels == -1) & (visibility == CONSISTENT)] = OCCLUDED
    return DepthMap(inverse, visibility)


def _with_points(checked: DepthMap, known: KnownDepth | None) -> DepthMap:
    """Replace inconsistent depth around known points by theirs, as consistent depth."""
    if known is None or not len(known.points):
        return checked
    from scipy.ndimage import distance_transform_edt

    depth, visibility = checked
    column, row = np.floor(known.points + 0.5).astype(np.int64).T
    at_points = np.full(depth.shape, np.nan)
    at_points[row, column] = known.inverse_depth
    distance, nearest = distance_transform_edt(np.isnan(at_points), return_indices=True)
    replaced = (visibility != CONSISTENT) & (distance <= TRACK_RADIUS_PX)
    return DepthMap(
        np.where(replaced, at_points[nearest[0], nearest[1]], depth),
        np.where(replaced, np.int8(CONSISTENT), visibility),
    )


def _continued(luma: Luma, own: DepthMap, other: DepthMap, warps: Warps) -> DepthMap:
    """Continue the consistent planes over the rest of a view."""
    limit = 0.03 * float(np.ptp(own.inverse_depth))
    slopes = Slopes(SLOPE_RADIUS_PX, limit, MAX_CONTINUATION_PX, SLOPE_SPACING_PX)
    filled = continue_surfaces(own, luma.astype(np.float64), other, warps, slopes, AGREEMENT_PX)
    return DepthMap(filled, own.visibility)


def _swept(
    luma: Luma,
    other: Luma,
    there: Floats,
    inverse_depth_range: tuple[float, float],
    known: KnownDepth | None,
    settings: SweepSettings,
) -> tuple[Floats, Floats]:
    """Return inverse depth and its confidence: settled ones, or by a plane sweep up to the nearest point."""
    expected = known.depth if known else None
    if expected and known and known.is_settled:
        return expected.inverse_depth, np.full(expected.inverse_depth.shape, np.inf)
    lowest, highest = inverse_depth_range
    if known is not None and len(known.points):
        span, nearest = highest - lowest, float(known.inverse_depth.max())
        if nearest > highest + settings.near_margin * span:
            highest = min(nearest, highest + MAX_STRETCH * span)
    hypotheses = depth_hypotheses((lowest, highest), there, luma.shape, settings)
    prior = (expected.inverse_depth, expected.reliable) if expected else None
    return sweep_views(luma, [(other, there)], hypotheses, settings, prior)


@kernel
def _check_consistency(depth, other, there, back, tolerance):
    """Compare a depth map with another view: consistent, outside it, or occluded (or wrong)."""
    height, width = depth.shape
    visibility = np.empty((height, width), np.int8)
    for y in range(height):
        for x in range(width):
            u, v, _ = warp_point(there, x, y, depth[y, x])
            if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
                visibility[y, x] = OUTSIDE
                continue
            visibility[y, x] = OCCLUDED
            column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if abs(i - v) + abs(j - u) > 1.5:
                        continue
                    a, b, _ = warp_point(back, u, v, other[i, j])
                    if abs(a - x) + abs(b - y) <= tolerance:
                        visibility[y, x] = CONSISTENT
                        break
    return visibility


@kernel
def discontinuities(depth: Floats, warp: Floats, tolerance_px: float = DISCONTINUITY_PX) -> Mask:
    """Find the cells of a grid of pixels with corners that do not move together."""
    height, width = depth.shape
    cells, motion = np.empty((height - 1, width - 1), np.bool_), np.empty((2, width, 2))
    for y in range(height):
        below, above = motion[y & 1], motion[1 - (y & 1)]
        for x in range(width):
            u, v, _ = warp_point(warp, x, y, depth[y, x])
            below[x, 0], below[x, 1] = u - x, v - y
        if y == 0:
            continue
        for x in range(width - 1):
            spread = 0.0
            for axis in range(2):
                a, b, c, d = above[x, axis], above[x + 1, axis], below[x, axis], below[x + 1, axis]
                spread = max(spread, max(a, b, c, d) - min(a, b, c, d))
            cells[y - 1, x] = spread > tolerance_px
    return cells


def _aligned(luma: Luma, own: DepthMap, other: DepthMap, warps: Warps) -> DepthMap:
    """Align continued depth and discontinuities with the edges of the image."""
    depth, reliable = own.inverse_depth, own.reliable
    span = float(np.ptp(depth)) + 1e-300
    around = np.ones((5, 5), np.uint8)
    jump = cv2.dilate(depth, around) - cv2.erode(depth, around) > 0.04 * span
    trust, chosen = np.where(reliable, 1.0, 0.3), jump | ~reliable
    view = OtherView(*warps, *other, AGREEMENT_PX)
    aligned = _guided_median(depth, trust, luma, chosen, depth.min(), span / 255.0, view)
    return DepthMap(aligned, own.visibility)


@kernel
def _guided_median(depth, trust, image, chosen, low, step, other):
    """Replace the chosen depths by the median of every second neighbour, weighted by likeness of level."""
    height, width = depth.shape
    radius, median = MEDIAN_RADIUS_PX, depth.copy()
    bins, sums, number = np.zeros(256), np.zeros(256), np.empty((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            number[y, x] = min(max(int((depth[y, x] - low) / step), 0), 255)
    for y in range(height):
        for x in range(width):
            if not chosen[y, x]:
                continue
            first = last = np.int64(number[y, x])
            total, level = 0.0, np.int64(image[y, x])
            left, right = max(x - radius, 0), min(x + radius + 1, width)
            for i in range(max(y - radius, 0), min(y + radius + 1, height)):
                for j in range(left + ((left + x + i + y) & 1), right, 2):
                    weight = trust[i, j] * _WEIGHTS_BY_LEVEL[abs(image[i, j] - level)]
                    weight *= _WEIGHTS_BY_OFFSET[i - y + radius, j - x + radius]
                    k = np.int64(number[i, j])
                    first, last = min(first, k), max(last, k)
                    bins[k] += weight
                    sums[k] += weight * depth[i, j]
                    total += weight
            reached, k = bins[first], first
            while reached < 0.5 * total and k < last:
                k += 1
                reached += bins[k]
            if bins[k] > 0.0:
                value = sums[k] / bins[k]
                if not is_transparent(other, x, y, value):
                    median[y, x] = value
            bins[first : last + 1] = 0.0
            sums[first : last + 1] = 0.0
    return median
