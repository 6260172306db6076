"""Depth maps of two views: dense inverse depth, its discontinuities, and what the other view sees of it.

The plane sweep gives both views a depth. What the two agree on is consistent; what lies outside the other
view or disagrees is continued from consistent neighbours by their planes, across as few edges as possible,
and not to a place that the other view looks through: a point that it does not see must be occluded there.
"""

import enum
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels
from dvc.geometry.cameras import ViewPair
from dvc.geometry.continuation import SeenDepth, Slopes, continue_surfaces
from dvc.geometry.plane_sweep import GRADIENT_SWEEP, SweepSettings, depth_hypotheses, sweep
from dvc.geometry.warping import inverse_warp, warp_matrix

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
Mask = NDArray[np.bool_]

AGREEMENT_PX = 1.5
"""Largest distance, there and back, between points on which two maps agree: a pixel, and both errors."""
MIN_CONFIDENCE = 20.0
"""Of a consistent depth, in units of the sweep's costs: about what noise makes over eight directions."""
MIN_REGION_PX = 40
"""Consistent regions with fewer pixels are speckles: accidental matches."""
TRACK_RADIUS_PX = 8.0
"""How far around a known point its depth is taken where the views do not agree on one: half a macroblock."""
MAX_STRETCH = 1.0
"""How far a known point may stretch the range of depth, as a share of it: it may be wrong."""
SLOPE_RADIUS_PX = 8
"""Radius in which the slope of a surface is measured: wide against the steps of the hypotheses."""
SLOPE_SPACING_PX = 2
"""Distance of the points that it is measured with."""
MAX_CONTINUATION_PX = 40.0
"""How far slopes are continued; farther away their error would be larger than that of constant depth."""
MEDIAN_RADIUS_PX = 5
"""Radius of the median that aligns depth with edges of the image: what the sweep's box and jumps blur."""
MEDIAN_LEVELS = 8.0
"""Difference in luma that quarters a neighbour's weight in this median."""
DISCONTINUITY_PX = 1.5
"""Neighbours whose motions differ by more belong to different surfaces."""


class Visibility(enum.IntEnum):
    """What another view sees of a point."""

    CONSISTENT = _kernels.CONSISTENT
    """It sees the point: both depth maps agree."""
    OUTSIDE = _kernels.OUTSIDE
    """The point lies outside its frame."""
    OCCLUDED = _kernels.OCCLUDED
    """It shows something else there, or one of both depths is wrong."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of a view."""

    inverse_depth: Floats  # inverse depth of every pixel
    visibility: NDArray[np.int8]  # a `Visibility` of every pixel, in the view that the map was checked with

    @property
    def reliable(self) -> Mask:
        """Where two views agree on the depth, shape (H, W)."""
        reliable: Mask = self.visibility == Visibility.CONSISTENT
        return reliable


@dataclass(frozen=True, eq=False)
class DepthView:
    """A picture with its camera and its depth."""

    luma: Luma  # the picture
    camera: Floats  # in normalised coordinates
    depth: DepthMap  # of the picture, checked with the other view
    discontinuities: Mask  # cells between four pixels that do not belong to one surface
    to_other: Floats  # warp to the other view


class KnownDepth(NamedTuple):
    """What is known of the depth of a view from others than the two that are compared."""

    depth: DepthMap | None  # as earlier pairs of views have shown it
    points: Floats  # known points (x, y) in pixels, inside the frame
    inverse_depth: Floats  # inverse depth of each
    is_settled: bool = False  # whether the depth is taken as it is, and not found anew


Known = tuple[KnownDepth | None, KnownDepth | None]


class _Side(NamedTuple):
    """One view while its depth map is being made, and the warps to the other and back."""

    luma: Luma
    there: Floats
    back: Floats


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
    sides = (_Side(first, there, back), _Side(second, back, there))
    swept = [
        _settled(known[k])
        or _swept(sides[k], sides[1 - k].luma, pair.inverse_depth_ranges[k], known[k], settings)
        for k in (0, 1)
    ]
    visible = [_checked(sides[k], swept[k], swept[1 - k][0]) for k in (0, 1)]
    maps = [_with_points(swept[k][0], visible[k], known[k]) for k in (0, 1)]
    maps = [_continued(sides[k], maps[k], maps[1 - k]) for k in (0, 1)]
    maps = [_aligned(sides[k], maps[k], maps[1 - k]) for k in (0, 1)]
    first_view, second_view = (
        DepthView(side.luma, camera, depth, discontinuities(depth.inverse_depth, side.there), side.there)
        for side, camera, depth in zip(sides, pair.cameras, maps, strict=True)
    )
    return first_view, second_view


def checked_depth(own: tuple[Floats, Floats], other: Floats, there: Floats) -> DepthMap:
    """Check inverse depths, given with their confidence, against those of another view."""
    side = _Side(np.empty((0, 0), np.uint8), there, inverse_warp(there))
    return DepthMap(own[0], _checked(side, own, other))


def completed_depth(luma: Luma, own: DepthMap, other: DepthMap, there: Floats) -> DepthMap:
    """Continue what is consistent over the rest, and align its discontinuities with edges of the picture."""
    side = _Side(luma, there, inverse_warp(there))
    return _aligned(side, _continued(side, own, other), other)


def without_speckles(depth: DepthMap) -> DepthMap:
    """Doubt small regions that are consistent, but not with what is around them."""
    visibility, inverse = depth.visibility.copy(), depth.inverse_depth
    span = float(np.ptp(inverse)) + 1e-300
    levels = ((inverse - inverse.min()) / span * 30000.0).astype(np.int16)
    levels[visibility != Visibility.CONSISTENT] = -1
    cv2.filterSpeckles(levels, -1, MIN_REGION_PX, 600)
    visibility[(levels == -1) & (visibility == Visibility.CONSISTENT)] = Visibility.OCCLUDED
    return DepthMap(inverse, visibility)


def discontinuities(inverse_depth: Floats, warp: Floats) -> Mask:
    """Find the cells of a grid of pixels whose corners do not move together."""
    height, width = inverse_depth.shape
    found = np.empty((height - 1, width - 1), np.bool_)
    _kernels.discontinuities(inverse_depth, warp, DISCONTINUITY_PX, found)
    return found


def _settled(known: KnownDepth | None) -> tuple[Floats, Floats] | None:
    """Inverse depth that is not to be found anew, and that nothing doubts."""
    if known is None or known.depth is None or not known.is_settled:
        return None
    return known.depth.inverse_depth, np.full(known.depth.inverse_depth.shape, np.inf)


def _swept(
    side: _Side,
    other: Luma,
    inverse_depth_range: tuple[float, float],
    known: KnownDepth | None,
    settings: SweepSettings,
) -> tuple[Floats, Floats]:
    """Inverse depth and its confidence."""
    to_search = _with_nearest(inverse_depth_range, known, settings)
    hypotheses = depth_hypotheses(to_search, side.there, side.luma.shape, settings)
    expected = known.depth if known else None
    prior = (expected.inverse_depth, expected.reliable) if expected else None
    return sweep(side.luma, other, side.there, hypotheses, settings, prior)


def _with_nearest(
    inverse_depth_range: tuple[float, float], known: KnownDepth | None, settings: SweepSettings
) -> tuple[float, float]:
    """Stretch a range of inverse depth to the nearest known point, if hypotheses would not reach it."""
    if known is None or not len(known.points):
        return inverse_depth_range
    lowest, highest = inverse_depth_range
    span, nearest = highest - lowest, float(known.inverse_depth.max())
    if nearest <= highest + settings.near_margin * span:
        return inverse_depth_range
    return lowest, min(nearest, highest + MAX_STRETCH * span)


def _checked(side: _Side, own: tuple[Floats, Floats], other: Floats) -> NDArray[np.int8]:
    """Tell what the other view sees: consistent in both, confident, and not a speckle."""
    depth, confidence = own
    visibility = np.empty(depth.shape, np.int8)
    _kernels.check_consistency(depth, other, side.there, side.back, AGREEMENT_PX, visibility)
    visibility[(visibility == Visibility.CONSISTENT) & (confidence < MIN_CONFIDENCE)] = Visibility.OCCLUDED
    return without_speckles(DepthMap(depth, visibility)).visibility


def _with_points(depth: Floats, visibility: NDArray[np.int8], known: KnownDepth | None) -> DepthMap:
    """Take the depth of known points around them, where the views agree on none; call it consistent."""
    if known is None or not len(known.points):
        return DepthMap(depth, visibility)
    from scipy.ndimage import distance_transform_edt

    column, row = np.floor(known.points + 0.5).astype(np.int64).T
    at_points = np.full(depth.shape, np.nan)
    at_points[row, column] = known.inverse_depth
    distance, nearest = distance_transform_edt(np.isnan(at_points), return_indices=True)
    taken = (visibility != Visibility.CONSISTENT) & (distance <= TRACK_RADIUS_PX)
    return DepthMap(
        np.where(taken, at_points[nearest[0], nearest[1]], depth),
        np.where(taken, np.int8(Visibility.CONSISTENT), visibility),
    )


def _continued(side: _Side, own: DepthMap, other: DepthMap) -> DepthMap:
    """Continue the consistent planes over the rest."""
    limit = 0.03 * float(np.ptp(own.inverse_depth))
    slopes = Slopes(SLOPE_RADIUS_PX, limit, MAX_CONTINUATION_PX, SLOPE_SPACING_PX)
    seen = (SeenDepth(depth.inverse_depth, depth.visibility) for depth in (own, other))
    luma, warps = side.luma.astype(np.float64), (side.there, side.back)
    filled = continue_surfaces(next(seen), luma, next(seen), warps, slopes, AGREEMENT_PX)
    return DepthMap(filled, own.visibility)


def _aligned(side: _Side, own: DepthMap, other: DepthMap) -> DepthMap:
    """Align what was continued, and the discontinuities, with the edges of the image."""
    depth, reliable = own.inverse_depth, own.reliable
    span = float(np.ptp(depth)) + 1e-300
    around = np.ones((5, 5), np.uint8)
    jump = cv2.dilate(depth, around) - cv2.erode(depth, around) > 0.04 * span
    aligned = np.empty_like(depth)
    _kernels.guided_median(
        depth,
        np.where(reliable, 1.0, 0.3),
        side.luma,
        jump | ~reliable,
        _kernels.Median(MEDIAN_RADIUS_PX, MEDIAN_LEVELS, depth.min(), span / 255.0),
        _kernels.OtherView(side.there, side.back, other.inverse_depth, other.visibility, AGREEMENT_PX),
        aligned,
    )
    return DepthMap(aligned, own.visibility)
