"""Dense depth of some located frames, and the cloud of their points.

Plane sweeps over several other frames are checked, and fused as in P. Merrell et al., "Real-time
visibility-based fusion of depth maps", ICCV 2007: depth maps of other frames, which see longer what soon
leaves a frame, are drawn into it as candidates besides its own depth; votes and expected errors decide.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.geometry.continuation import CONSISTENT, DepthMap
from dvc.geometry.depth_maps import (
    MIN_CONFIDENCE,
    checked_depth,
    completed_depth,
    discontinuities,
    without_speckles,
)
from dvc.geometry.plane_sweep import SweepSettings, depth_hypotheses, parallax_px, sweep_views
from dvc.geometry.rendering import draw
from dvc.geometry.viewpoints import CalibratedViewpoint, calibrated_warp
from dvc.geometry.warping import EMPTY, inverse_warp, warp_grid
from dvc.video import Frame
from dvc.video.pixels import rgb_from_frame
from sfm.mapping.scene_map import MapPiece
from sfm.mapping.sequence_tracks import SequenceTracks, evenly_spaced
from sfm.mapping.structure import Structure

MAX_DEPTH_FRAMES = 48
"""Largest number of frames with depth in a sequence: each costs seconds, and all are in memory."""
MIN_VIEW_POINTS = 20
"""Least number of triangulated points in a frame with depth."""
COMPANION_SHARE = 3
"""Quotient of the distances to the next frame with depth and to the companions of such a frame."""
MAX_PIXELS = 350_000
"""Number of pixels above which depth is estimated at a half, a third, ... of the frame's size."""
MAX_POINTS = 500_000
"""Largest number of points in a cloud that viewers turn smoothly and pages hold."""
CUBE_PX = 1.5
"""Initial side of the cubes, in pixels at the median depth."""
FARTHEST = 8.0
"""Largest depth of points in the cloud, in medians of a frame: farther points are sparse and imprecise."""
ANGLES_DEG = (5.0, 0.7, 2.0)
"""Target median angles between the rays of two views: wide ones are precise, narrow ones see near points."""
MIN_OVERLAP = 0.4
"""Least share of a frame's points that a neighbour sees."""
MAX_NEIGHBOURS = 5
"""Largest number of frames that a frame is compared with."""
SWEEP = SweepSettings(step_px=0.5, max_hypotheses=224, near_margin=0.25)
MIN_INVERSE_DEPTH = 1e-3
"""Least inverse depth, relative to the median of a frame's points; below it is sky, or unknown."""
ERROR_PX = 0.5
"""Expected position error of a point in the frame that shows its depth best."""
FUSED_A_SIDE = 4
"""Number of frames before and after a frame with depth maps that are fused with its own."""
TOLERANCE = 2.0
"""Largest difference of agreeing candidates, in units of the larger of their expected errors."""
MIN_VOTES = 2
"""Number of candidates that must agree if the frame itself is not confident."""


class View(NamedTuple):
    """A frame, in the size of its depth map."""

    luma: Bytes
    K: Floats
    pose: Floats
    points: Floats  # triangulated points that it sees


class SweptDepth(NamedTuple):
    """Result of a plane sweep."""

    inverse_depth: Floats  # of every pixel
    confidence: Floats
    error: float  # expected error of the inverse depth

    @property
    def confident(self) -> Mask:
        """Mask of pixels with a depth that noise would hardly produce."""
        return np.asarray(self.confidence >= MIN_CONFIDENCE)


class Candidate(NamedTuple):
    """Inverse depth of the pixels of a frame, nan if unknown, and its expected error."""

    inverse_depth: Floats
    error: Floats


def dense_pieces(
    frames: Iterable[Frame],
    tracks: SequenceTracks,
    structures: Sequence[Structure],
    report: Callable[[str], None],
) -> tuple[MapPiece, ...]:
    """Add depth and clouds to the pieces of a sequence, reading its frames once."""
    chosen = depth_frames(tracks, structures)
    near = []  # frames with depth, and located companions, which see longer what soon leaves a frame
    for keys, structure in zip(chosen, structures, strict=True):
        gaps = np.diff(keys) if len(keys) > 1 else np.ones(1)
        step = max(1, round(float(np.median(gaps)) / COMPANION_SHARE))
        located = {k for key in keys for k in (key - step, key + step) if k in structure.poses}
        near.append(sorted(located | set(keys)))
    needed = {k for each in near for k in each}
    pictures = {index: frame for index, frame in enumerate(frames) if index in needed}
    shape = tracks.height_px, tracks.width_px
    factor = max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / MAX_PIXELS))))
    pieces = []
    for structure, keys, around in zip(structures, chosen, near, strict=True):
        views = {k: _view(structure, tracks, k, pictures[k], factor) for k in around}
        nearest = max((inverse_depth_span(views[k])[1] for k in keys), default=0.0)
        swept = {}
        for number, frame in enumerate(keys, start=1):
            report(f"depth: frame {frame}, {number} of {len(keys)}")
            estimate = sweep_depth(views, frame, nearest)
            if estimate is not None:
                swept[frame] = estimate
        depths = complete_depths(views, swept)
        for k, depth in depths.items() if factor > 1 else ():
            enlarged = depth.repeat(factor, axis=0).repeat(factor, axis=1)
            depths[k] = np.ascontiguousarray(enlarged[: shape[0], : shape[1]])
        maps = ((depth, structure.poses[k], rgb_from_frame(pictures[k])) for k, depth in depths.items())
        cloud = dense_cloud(maps, structure.K)
        pieces.append(MapPiece(structure.K, dict(sorted(structure.poses.items())), *cloud, depths))
    return tuple(pieces)


def depth_frames(tracks: SequenceTracks, structures: Sequence[Structure]) -> list[list[int]]:
    """Choose the key frames of each piece that get depth, a limited number; short pieces may get none."""

    def visible(structure: Structure, frame: int) -> bool:
        count = np.count_nonzero(structure.triangulated[tracks.seen[frame].ids])
        return frame in structure.poses and bool(count >= MIN_VIEW_POINTS)

    keys = [[k for k in tracks.key_frames if visible(structure, k)] for structure in structures]
    total = sum(len(each) for each in keys)
    if total <= MAX_DEPTH_FRAMES:
        return keys
    chosen = [evenly_spaced(each, max(2, len(each) * MAX_DEPTH_FRAMES // total)) for each in keys]
    room = MAX_DEPTH_FRAMES
    for number in sorted(range(len(keys)), key=lambda number: -len(keys[number])):
        chosen[number] = chosen[number] if len(chosen[number]) <= room else []
        room -= len(chosen[number])
    return chosen


def _view(structure: Structure, tracks: SequenceTracks, index: int, frame: Frame, factor: int) -> View:
    """Reduce a frame and its intrinsics, and collect the points in it."""
    import cv2

    ids = tracks.seen[index].ids
    points = structure.points[ids[structure.triangulated[ids]]]
    pose = structure.poses[index]
    points = points[points @ pose[2, :3] + pose[2, 3] > 0]
    K, luma = structure.K.copy(), frame.luma
    if factor > 1:
        height, width = -(-frame.height // factor), -(-frame.width // factor)
        padding = (0, height * factor - frame.height), (0, width * factor - frame.width)
        padded = np.pad(luma, padding, mode="edge")
        luma = np.asarray(cv2.resize(padded, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        K[:2, 2] = (K[:2, 2] - 0.5 * (factor - 1)) / factor
        K[[0, 1], [0, 1]] /= factor
    return View(np.ascontiguousarray(luma, np.uint8), K, pose, points)


def points_in_world(depth: Singles, K: Floats, pose: Floats) -> tuple[Floats, Mask]:
    """Return the points of a depth map, and a mask of their pixels."""
    known = np.isfinite(depth)
    row, column = np.nonzero(known)
    z = depth[known].astype(np.float64)
    inside = np.column_stack([(column - K[0, 2]) / K[0, 0] * z, (row - K[1, 2]) / K[1, 1] * z, z])
    return (inside - pose[:, 3]) @ pose[:, :3], known


def dense_cloud(
    maps: Iterable[tuple[Singles, Floats, Bytes]], K: Floats, limit: int = MAX_POINTS
) -> tuple[Floats, Bytes]:
    """Join depth maps, each with its pose and picture, to at most `limit` points and their colours."""
    points, colours = np.empty((0, 3)), np.empty((0, 3), np.uint8)
    side = 0.0
    for depth, pose, picture in maps:
        if not np.isfinite(depth).any():
            continue
        middle = float(np.nanmedian(depth))
        near = np.where(depth <= FARTHEST * middle, depth, np.nan)
        side = side or CUBE_PX * middle / float(K[0, 0])
        new, known = points_in_world(near, K, pose)
        points, colours = np.concatenate([points, new]), np.concatenate([colours, picture[known]])
        points, colours = _thinned(points, colours, side)
        while len(points) > limit:
            side *= 1.25
            points, colours = _thinned(points, colours, side)
    return points, colours


def _thinned(points: Floats, colours: Bytes, side: float) -> tuple[Floats, Bytes]:
    """Keep the first point in every cube of a grid."""
    cubes = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    size = cubes.max(axis=0) + 1
    _, first = np.unique((cubes[:, 0] * size[1] + cubes[:, 1]) * size[2] + cubes[:, 2], return_index=True)
    first.sort()
    return points[first], colours[first]


def warp_between(source: View, target: View) -> Floats:
    """Return the warp from one view to another, in pixels; see `dvc.geometry.warping`."""
    return calibrated_warp(*(CalibratedViewpoint(view.K, view.pose) for view in (source, target)))


def neighbours(views: Mapping[int, View], frame: int) -> tuple[int, ...]:
    """Choose the best frames to compare a frame with: on both sides, and at several distances."""
    seen = {k: _overlap(views[frame], views[k]) for k in views if k != frame}
    seen = {k: each for k, each in seen.items() if each[0] >= MIN_OVERLAP and each[1] > 0}
    chosen: list[int] = []
    for angle in ANGLES_DEG:
        for side in ([k for k in seen if k < frame], [k for k in seen if k > frame]):
            free = [k for k in side if k not in chosen]
            if free and len(chosen) < MAX_NEIGHBOURS:
                score = {k: seen[k][0] * min(seen[k][1] / angle, angle / seen[k][1]) for k in free}
                chosen.append(max(free, key=score.__getitem__))
    return tuple(chosen)


def _overlap(view: View, other: View) -> tuple[float, float]:
    """Return the share of a view's points that another view sees, and the median angle between their rays."""
    inside = view.points @ other.pose[:, :3].T + other.pose[:, 3]
    image = inside @ other.K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        image = image[:, :2] / image[:, 2:]
    height, width = other.luma.shape
    seen = (inside[:, 2] > 0) & ((image >= 0) & (image <= [width - 1, height - 1])).all(axis=1)
    if not seen.any():
        return 0.0, 0.0
    rays = [view.points[seen] + each.pose[:, :3].T @ each.pose[:, 3] for each in (view, other)]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    cosine = np.clip((rays[0] * rays[1]).sum(axis=1), -1.0, 1.0)
    return float(np.mean(seen)), float(np.median(np.degrees(np.arccos(cosine))))


def inverse_depth_span(view: View) -> tuple[float, float]:
    """Return the range of the inverse depths of a view's points."""
    depth = view.points @ view.pose[2, :3] + view.pose[2, 3]
    lowest, highest = np.quantile(1.0 / depth[depth > 0], (0.005, 0.995))
    return float(lowest), float(highest)


def sweep_depth(views: Mapping[int, View], frame: int, nearest: float) -> SweptDepth | None:
    """Estimate depth of a frame; None without neighbours. `nearest` is the largest inverse depth anywhere."""
    view = views[frame]
    compared = [(views[k].luma, warp_between(view, views[k])) for k in neighbours(views, frame)]
    if not compared:
        return None
    lowest, highest = inverse_depth_span(view)
    span = lowest, max(highest, nearest)
    hypotheses = [depth_hypotheses(span, warp, view.luma.shape, SWEEP) for _, warp in compared]
    finest = max(hypotheses, key=lambda each: each.num_hypotheses)
    finest = finest._replace(lowest=max(finest.lowest, 0.0))
    parallax = max(parallax_px((lowest, highest), warp, view.luma.shape) for _, warp in compared)
    error = ERROR_PX * (highest - lowest) / max(parallax, ERROR_PX)
    return SweptDepth(*sweep_views(view.luma, compared, finest, SWEEP), error)


def complete_depths(views: Mapping[int, View], swept: Mapping[int, SweptDepth]) -> dict[int, Singles]:
    """Check, fuse and continue depths; return distances (nan: unknown, or far away)."""
    usable = {k: views[k] for k in swept}
    compared = {k: chosen for k in swept if (chosen := neighbours(usable, k))}
    fused = {k: _fuse(usable, swept, k, chosen) for k, chosen in compared.items()}
    completed = {}
    for frame, depth in fused.items():
        other = compared[frame][0]
        if other not in fused:
            continue
        warp = warp_between(views[frame], views[other])
        inverse = completed_depth(views[frame].luma, depth, fused[other], warp).inverse_depth
        z = views[frame].points @ views[frame].pose[2, :3] + views[frame].pose[2, 3]
        least = MIN_INVERSE_DEPTH * float(np.median(1.0 / z[z > 0]))
        distances = np.where(inverse > least, 1.0 / np.maximum(inverse, least), np.nan)
        completed[frame] = distances.astype(np.float32)
    return completed


def _fuse(
    views: Mapping[int, View], swept: Mapping[int, SweptDepth], frame: int, compared: Sequence[int]
) -> DepthMap:
    """Check the depth of a frame against that of other frames, and fuse it with that of frames around it."""
    depth, view = swept[frame], views[frame]
    maps = [
        checked_depth(
            (depth.inverse_depth, depth.confidence), swept[k].inverse_depth, warp_between(view, views[k])
        )
        for k in compared
    ]
    consistent = np.logical_or.reduce([each.reliable for each in maps])
    seeing = sorted(k for k in views if k != frame and _overlap(views[k], view)[0] >= MIN_OVERLAP)
    before, after = [k for k in seeing if k < frame], [k for k in seeing if k > frame]
    around = [*before[-FUSED_A_SIDE:], *after[:FUSED_A_SIDE]]
    candidates = [drawn_candidate(swept[k], warp_between(views[k], view)) for k in around]
    fused, votes = fused_depth(depth, candidates, consistent)
    reliable = consistent | (votes >= MIN_VOTES)
    visibility = np.where(reliable, np.int8(CONSISTENT), maps[0].visibility)
    return without_speckles(DepthMap(fused, visibility))


def drawn_candidate(other: SweptDepth, warp: Floats) -> Candidate:
    """Draw the confident depth of another frame into a frame, by the warp from the former to the latter."""
    doubtful = ~other.confident
    cells = doubtful[:-1, :-1] | doubtful[:-1, 1:] | doubtful[1:, :-1] | doubtful[1:, 1:]
    nearest = np.full(doubtful.shape, EMPTY)
    draw(other.inverse_depth, warp, discontinuities(other.inverse_depth, warp), ~cells, nearest)
    seen = nearest > EMPTY
    there = warp_grid(inverse_warp(warp), np.where(seen, nearest, 0.0))[..., 2]
    # An error of the inverse depth r is one of the depth, times r squared; depth has the same in both frames.
    near = seen & (there > 0.0)
    growth = np.square(np.where(near, nearest, 1.0) / np.where(near, there, 1.0))
    return Candidate(np.where(seen, nearest, np.nan), other.error * growth)


def fused_depth(
    depth: SweptDepth, candidates: Sequence[Candidate], consistent: Mask
) -> tuple[Floats, Integers]:
    """Fuse the depth of a frame with candidates; return inverse depth and the number of agreeing votes.

    Consistent depth is only averaged with the candidates that agree; other depth is replaced by the value
    that most candidates agree on, if they are enough.
    """
    error = np.full(consistent.shape, depth.error)
    first = Candidate(np.where(consistent | depth.confident, depth.inverse_depth, np.nan), error)
    every = [first, *candidates]
    best, votes, doubt = _mean_of_agreeing(first, every)
    for each in candidates:
        mean, number, variance = _mean_of_agreeing(each, every)
        better = ~consistent & ((number > votes) | ((number == votes) & (variance < doubt)))
        best, votes = np.where(better, mean, best), np.where(better, number, votes)
        doubt = np.where(better, variance, doubt)
    usable = consistent | (votes >= MIN_VOTES)
    return np.where(usable, best, depth.inverse_depth), votes


def _mean_of_agreeing(centre: Candidate, candidates: Sequence[Candidate]) -> tuple[Floats, Integers, Floats]:
    """Average the candidates that agree with one of them; return mean, number and variance."""
    total, mean = np.zeros(centre.error.shape), np.zeros(centre.error.shape)
    number = np.zeros(centre.error.shape, np.int64)
    for each in candidates:
        reach = TOLERANCE * np.maximum(centre.error, each.error)
        agrees = np.abs(each.inverse_depth - centre.inverse_depth) <= reach  # False for nan
        weight = np.where(agrees, 1.0 / np.square(each.error), 0.0)
        total += weight
        mean += weight * np.where(agrees, each.inverse_depth, 0.0)
        number += agrees
    divisor = np.where(number > 0, total, 1.0)
    return mean / divisor, number, 1.0 / divisor
