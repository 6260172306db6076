"""Dense depth of some located frames: plane sweeps over several others, checked and fused with each other."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.continuation import Visibility
from dvc.geometry.depth_maps import DepthMap, checked_depth, completed_depth, without_speckles
from dvc.geometry.plane_sweep import SweepSettings, depth_hypotheses, parallax_px, sweep_views
from dvc.geometry.viewpoints import CalibratedViewpoint, calibrated_warp
from sfm.mapping.fusion import MIN_VOTES, SweptDepth, drawn_candidate, fused_depth

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
Mask = NDArray[np.bool_]

ANGLES_DEG = (5.0, 0.7, 2.0)
"""Median angles between the rays of two views: wide ones make depth precise, narrow ones see what is near."""
MIN_OVERLAP = 0.4
"""Share of a frame's points that another one must see to be compared with it."""
MAX_NEIGHBOURS = 5
"""Frames that one is compared with."""
SWEEP = SweepSettings(step_px=0.5, max_hypotheses=224, near_margin=0.25)
MIN_INVERSE_DEPTH = 1e-3
"""Relative to the median of a frame's points: what is farther is sky, or not known."""
ERROR_PX = 0.5
"""Expected error of the place of a point in the frame that shows its depth best."""
FUSED_A_SIDE = 4
"""Frames before one, and after it, whose depth maps are fused with its own."""


class View(NamedTuple):
    """A frame whose depth is wanted, at the size at which it is found."""

    luma: Luma
    K: Floats
    pose: Floats
    points: Floats  # known points that it sees


def warp_between(source: View, target: View) -> Floats:
    """Return the warp from one view to another, in pixels; see `dvc.geometry.warping`."""
    return calibrated_warp(*(CalibratedViewpoint(view.K, view.pose) for view in (source, target)))


def neighbours(views: Mapping[int, View], frame: int) -> tuple[int, ...]:
    """Choose the frames that one is best compared with: on both sides, and at several distances."""
    seen = {k: _overlap(views[frame], views[k]) for k in views if k != frame}
    seen = {k: each for k, each in seen.items() if each[0] >= MIN_OVERLAP and each[1] > 0}
    chosen: list[int] = []
    for angle in ANGLES_DEG:
        for side in ([k for k in seen if k < frame], [k for k in seen if k > frame]):
            free = [k for k in side if k not in chosen]
            if free and len(chosen) < MAX_NEIGHBOURS:
                chosen.append(max(free, key=lambda k: seen[k][0] * _nearness(seen[k][1], angle)))
    return tuple(chosen)


def _nearness(angle_deg: float, wanted_deg: float) -> float:
    return min(angle_deg / wanted_deg, wanted_deg / angle_deg)


def _overlap(own: View, other: View) -> tuple[float, float]:
    """Return the share of a view's points that another one sees, and the median angle between their rays."""
    inside = own.points @ other.pose[:, :3].T + other.pose[:, 3]
    image = inside @ other.K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        place = image[:, :2] / image[:, 2:]
    height, width = other.luma.shape
    seen = (inside[:, 2] > 0) & ((place >= 0) & (place <= [width - 1, height - 1])).all(axis=1)
    if not seen.any():
        return 0.0, 0.0
    rays = [own.points[seen] + view.pose[:, :3].T @ view.pose[:, 3] for view in (own, other)]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    cosine = np.clip((rays[0] * rays[1]).sum(axis=1), -1.0, 1.0)
    return float(np.mean(seen)), float(np.median(np.degrees(np.arccos(cosine))))


def inverse_depth_span(view: View) -> tuple[float, float]:
    """Return the range of the inverse depths of the points that a view sees."""
    depth = view.points @ view.pose[2, :3] + view.pose[2, 3]
    lowest, highest = np.quantile(1.0 / depth[depth > 0], (0.005, 0.995))
    return float(lowest), float(highest)


def sweep_depth(views: Mapping[int, View], frame: int, nearest: float) -> SweptDepth | None:
    """Find the inverse depth of a frame, with confidence and error; None where no other frame can tell.

    `nearest` is the largest inverse depth that any frame knows: what is near is not seen for long.
    """
    own = views[frame]
    others = [(views[k].luma, warp_between(own, views[k])) for k in neighbours(views, frame)]
    if not others:
        return None
    lowest, highest = inverse_depth_span(own)
    span = lowest, max(highest, nearest)
    hypotheses = [depth_hypotheses(span, warp, own.luma.shape, SWEEP) for _, warp in others]
    finest = max(hypotheses, key=lambda each: each.num_hypotheses)
    finest = finest._replace(lowest=max(finest.lowest, 0.0))
    parallax = max(parallax_px((lowest, highest), warp, own.luma.shape) for _, warp in others)
    error = ERROR_PX * (highest - lowest) / max(parallax, ERROR_PX)
    return SweptDepth(*sweep_views(own.luma, others, finest, SWEEP), error)


def complete_depths(
    views: Mapping[int, View], swept: Mapping[int, SweptDepth]
) -> dict[int, NDArray[np.float32]]:
    """Check and fuse depths, continue what is consistent; return distances (nan: not known, or far away)."""
    known = {k: views[k] for k in swept}
    beside = {k: others for k in swept if (others := neighbours(known, k))}
    fused = {k: _fused(known, swept, k, others) for k, others in beside.items()}
    found = {}
    for frame, depth in fused.items():
        other = beside[frame][0]
        if other not in fused:
            continue
        warp = warp_between(views[frame], views[other])
        completed = completed_depth(views[frame].luma, depth, fused[other], warp)
        found[frame] = _distances(views[frame], completed.inverse_depth)
    return found


def _fused(
    views: Mapping[int, View], swept: Mapping[int, SweptDepth], frame: int, others: Sequence[int]
) -> DepthMap:
    """Check the depth of a frame against that of others, and fuse it with that of frames around it."""
    own, view = swept[frame], views[frame]
    maps = [
        checked_depth(
            (own.inverse_depth, own.confidence), swept[k].inverse_depth, warp_between(view, views[k])
        )
        for k in others
    ]
    consistent = np.logical_or.reduce([each.reliable for each in maps])
    around = [drawn_candidate(swept[k], warp_between(views[k], view)) for k in _around(views, frame)]
    depth, votes = fused_depth(own, around, consistent)
    reliable = consistent | (votes >= MIN_VOTES)
    visibility = np.where(reliable, np.int8(Visibility.CONSISTENT), maps[0].visibility)
    return without_speckles(DepthMap(depth, visibility))


def _around(views: Mapping[int, View], frame: int) -> list[int]:
    """Choose the frames on both sides whose points a frame sees."""
    seeing = sorted(k for k in views if k != frame and _overlap(views[k], views[frame])[0] >= MIN_OVERLAP)
    before, after = [k for k in seeing if k < frame], [k for k in seeing if k > frame]
    return [*before[-FUSED_A_SIDE:], *after[:FUSED_A_SIDE]]


def _distances(view: View, inverse: Floats) -> NDArray[np.float32]:
    depth = view.points @ view.pose[2, :3] + view.pose[2, 3]
    least = MIN_INVERSE_DEPTH * float(np.median(1.0 / depth[depth > 0]))
    return np.where(inverse > least, 1.0 / np.maximum(inverse, least), np.nan).astype(np.float32)
