"""The visible surface of each key frame: dense inverse depth, what of it is reliable, and where it is torn.

The plane sweep gives both key frames a depth. What the two agree on is reliable; what lies outside the other
frame or disagrees is continued from reliable neighbours by their planes, across as few edges as possible, and
not to a place that the other key frame looks through: a point that it does not see must be hidden from it.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from decoder.side_information import _kernels_3d
from decoder.side_information.plane_sweep import DepthMap, SweepSettings, label_range, sweep
from decoder.side_information.trifocal import inverse_transfer, transfer_matrix, transfer_surface
from sfm.model import Model

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
State = NDArray[np.int8]


RELIABLE, OUTSIDE, HIDDEN = 0, 1, 2
"""States of a point: both keys agree; it lies outside the other key; the other key shows something else."""


class KnownDepth(NamedTuple):
    """What is known of the depth of a key frame from other frames.

    Attributes
    ----------
    surface : DepthMap or None
        Its surface as earlier pairs of frames have shown it.
    points : ndarray of shape (N, 2), float64
        Tracked points (x, y) in pixels, inside the frame.
    inverse_depth : ndarray of shape (N,), float64
        Inverse depth of each.
    """

    surface: DepthMap | None
    points: Floats
    inverse_depth: Floats


Known = tuple[KnownDepth | None, KnownDepth | None]


@dataclass(frozen=True)
class SurfaceSettings:
    """How surfaces are checked, continued and torn.

    Attributes
    ----------
    sweep : SweepSettings
        The plane sweep.
    tolerance_px : float
        Largest distance, there and back, between points on which two surfaces agree.
    least_certainty : float
        Smallest certainty of a reliable depth, in units of the sweep's costs.
    least_part_px : int
        Reliable parts with fewer pixels are dropped.
    track_radius_px : float
        How far around a tracked point its depth is taken where the key frames do not agree on one.
    slope_radius_px : int
        Radius in which the slope of a surface is measured.
    reach_px : float
        How far slopes are continued.
    edge_levels : float
        A step in luma that halves the weight of what lies behind it.
    quantile_outside, quantile_hidden : float
        Which of the continued inverse depths is taken; 0 is the farthest.
    median_radius_px : int
        Radius of the median that aligns continued depths and jumps with edges of the image.
    median_levels : float
        Difference in luma that quarters a neighbour's weight in this median.
    tear_px : float
        Neighbours whose motions differ by more belong to different surfaces.
    """

    sweep: SweepSettings = field(default_factory=SweepSettings)
    tolerance_px: float = 1.5
    least_certainty: float = 20.0
    least_part_px: int = 40
    track_radius_px: float = 8.0
    slope_radius_px: int = 8
    reach_px: float = 40.0
    edge_levels: float = 15.0
    quantile_outside: float = 0.5
    quantile_hidden: float = 0.5
    median_radius_px: int = 5
    median_levels: float = 8.0
    tear_px: float = 1.5


@dataclass(frozen=True, eq=False)
class KeySurface:
    """What one key frame shows of the scene.

    Attributes
    ----------
    luma : ndarray of shape (H, W), uint8
        The frame.
    camera : ndarray of shape (3, 4), float64
        Its camera, in normalised coordinates.
    inverse_depth : ndarray of shape (H, W), float64
        Inverse depth of each pixel.
    state : ndarray of shape (H, W), int8
        `RELIABLE`, `OUTSIDE` or `HIDDEN`.
    torn : ndarray of shape (H - 1, W - 1), bool
        Cells between four pixels that do not belong to one surface.
    to_other : ndarray of shape (3, 4), float64
        Transfer to the other key frame.
    """

    luma: Luma
    camera: Floats
    inverse_depth: Floats
    state: State
    torn: NDArray[np.bool_]
    to_other: Floats


class _Side(NamedTuple):
    """One key frame while its surface is being made."""

    luma: Luma
    there: Floats
    back: Floats


def estimate_surfaces(
    model: Model,
    first: Luma,
    second: Luma,
    settings: SurfaceSettings,
    known: Known = (None, None),
) -> tuple[KeySurface, KeySurface]:
    """Estimate the surfaces that two key frames show.

    Parameters
    ----------
    model : Model
        Their cameras, and points that tell the range of depth.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    settings : SurfaceSettings
        Limits and weights.
    known : tuple of two (KnownDepth or None), optional
        What is known of the depth of each already, from other frames.

    Returns
    -------
    tuple of two KeySurface
        The surface of each.
    """
    cameras = (model.first_camera, model.second_camera)
    there = transfer_matrix(*cameras, model.pixel_frame)
    back = inverse_transfer(there)
    sides = (_Side(first, there, back), _Side(second, back, there))
    ranges = known_inverse_depths(model)
    swept = [_sweep_side(sides[k], sides[1 - k].luma, ranges[k], settings, known[k]) for k in (0, 1)]
    states = [_check(sides[k], swept[k], swept[1 - k], settings) for k in (0, 1)]
    raw = [_with_tracks(swept[k][0], states[k], known[k], settings.track_radius_px) for k in (0, 1)]
    for _ in range(2):  # the second time, what is continued in one key limits the other
        filled = [_fill(sides[k], raw[k], states[k], raw[1 - k], states[1 - k], settings) for k in (0, 1)]
        raw = filled
    aligned = [_align(sides[k], raw[k], states[k], raw[1 - k], states[1 - k], settings) for k in (0, 1)]
    surfaces = [
        KeySurface(side.luma, camera, depth, state, tear(depth, side.there, settings.tear_px), side.there)
        for side, camera, depth, state in zip(sides, cameras, aligned, states, strict=True)
    ]
    return surfaces[0], surfaces[1]


def known_inverse_depths(model: Model) -> tuple[Floats, Floats]:
    """Return the inverse depths of a model's points in both of its views.

    Parameters
    ----------
    model : Model
        Points and cameras.

    Returns
    -------
    first, second : ndarray of shape (N,), float64
        Inverse depths; points behind a camera are left out.
    """
    usable = np.isfinite(model.depths) & (model.depths > 0)
    points, first = model.points[usable], 1.0 / model.depths[usable]
    camera = model.second_camera * (-1.0 if np.linalg.det(model.second_camera[:, :3]) < 0 else 1.0)
    depth = points @ camera[2]
    before = depth > 0
    return first, 1.0 / depth[before]


def tear(inverse_depth: Floats, transfer: Floats, tear_px: float) -> NDArray[np.bool_]:
    """Find the cells of a grid of pixels whose corners do not move together.

    Parameters
    ----------
    inverse_depth : ndarray of shape (H, W), float64
        Surface.
    transfer : ndarray of shape (3, 4), float64
        To another view.
    tear_px : float
        Largest difference of motion within a surface.

    Returns
    -------
    ndarray of shape (H - 1, W - 1), bool
        True where the surface is torn.
    """
    moved = transfer_surface(transfer, inverse_depth)
    rows, columns = np.indices(inverse_depth.shape)
    motion = moved[..., :2] - np.stack([columns, rows], axis=-1)
    corners = np.stack([motion[:-1, :-1], motion[:-1, 1:], motion[1:, :-1], motion[1:, 1:]])
    torn: NDArray[np.bool_] = (corners.max(axis=0) - corners.min(axis=0)).max(axis=-1) > tear_px
    return torn


def _sweep_side(
    side: _Side, other: Luma, range_of: Floats, settings: SurfaceSettings, known: KnownDepth | None
) -> tuple[Floats, Floats]:
    labels = label_range(range_of, side.there, side.luma.shape, settings.sweep)
    return sweep(side.luma, other, side.there, labels, settings.sweep, known.surface if known else None)


def _with_tracks(depth: Floats, state: State, known: KnownDepth | None, radius_px: float) -> Floats:
    """Take the depth of tracked points around them, where the key frames agree on none; call it reliable."""
    if known is None or not len(known.points):
        return depth
    column, row = np.floor(known.points + 0.5).astype(np.int64).T
    at_points = np.full(depth.shape, np.nan)
    at_points[row, column] = known.inverse_depth
    distance, nearest = distance_transform_edt(np.isnan(at_points), return_indices=True)
    taken = (state != RELIABLE) & (distance <= radius_px)
    state[taken] = RELIABLE
    return np.where(taken, at_points[nearest[0], nearest[1]], depth)


def _check(
    side: _Side, own: tuple[Floats, Floats], other: tuple[Floats, Floats], settings: SurfaceSettings
) -> State:
    """Tell what is reliable: consistent in both keys, certain, and not a speckle."""
    depth, certainty = own
    state = np.empty(depth.shape, np.int8)
    _kernels_3d.check_consistency(depth, other[0], side.there, side.back, settings.tolerance_px, state)
    state[(state == RELIABLE) & (certainty < settings.least_certainty)] = HIDDEN
    span = float(np.ptp(depth)) + 1e-300
    levels = ((depth - depth.min()) / span * 30000.0).astype(np.int16)
    levels[state != RELIABLE] = -1
    cv2.filterSpeckles(levels, -1, settings.least_part_px, 600)
    state[(levels == -1) & (state == RELIABLE)] = HIDDEN
    return state


def _fill(
    side: _Side, depth: Floats, state: State, other: Floats, other_state: State, settings: SurfaceSettings
) -> Floats:
    """Continue the reliable planes over the rest."""
    slopes = np.empty((*depth.shape, 2))
    limit = 0.03 * float(np.ptp(depth))
    reliable = state == RELIABLE
    # only the rim of what is reliable is continued
    rim = reliable & (cv2.dilate((~reliable).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    _kernels_3d.local_slopes(depth, reliable, rim, settings.slope_radius_px, limit, slopes)
    filled = np.empty_like(depth)
    _kernels_3d.fill_surface(
        depth,
        state,
        side.luma.astype(np.float64),
        slopes,
        settings.edge_levels,
        settings.reach_px,
        np.array([0.0, settings.quantile_outside, settings.quantile_hidden]),
        other,
        other_state,
        side.there,
        side.back,
        settings.tolerance_px,
        filled,
    )
    return filled


def _align(
    side: _Side, depth: Floats, state: State, other: Floats, other_state: State, settings: SurfaceSettings
) -> Floats:
    """Align what was continued, and the jumps of depth, with the edges of the image."""
    span = float(np.ptp(depth)) + 1e-300
    around = np.ones((5, 5), np.uint8)
    jump = cv2.dilate(depth, around) - cv2.erode(depth, around) > 0.04 * span
    aligned = np.empty_like(depth)
    _kernels_3d.guided_median(
        depth,
        np.where(state == RELIABLE, 1.0, 0.3),
        side.luma.astype(np.float64),
        jump | (state != RELIABLE),
        settings.median_radius_px,
        settings.median_levels,
        depth.min(),
        span / 255.0,
        side.there,
        side.back,
        other,
        other_state,
        settings.tolerance_px,
        aligned,
    )
    return aligned
