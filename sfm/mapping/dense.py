"""From cameras and points to pieces of a map: depth of some frames, and the cloud of their points."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.video import Frame
from dvc.video.pixels import rgb_from_frame
from sfm.mapping.keyframe_depth import View, complete_depths, inverse_depth_span, sweep_depth
from sfm.mapping.scene_map import MapPiece
from sfm.mapping.sequence_tracks import SequenceTracks
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


def dense_pieces(
    frames: Iterable[Frame],
    tracks: SequenceTracks,
    structures: Sequence[Structure],
    report: Callable[[str], None],
) -> tuple[MapPiece, ...]:
    """Add depth and clouds to the pieces of a sequence, reading its frames once."""
    chosen = depth_frames(tracks, structures)
    needed = {
        k for keys, each in zip(chosen, structures, strict=True) for k in (*keys, *companions(keys, each))
    }
    pictures = {index: frame for index, frame in enumerate(frames) if index in needed}
    return tuple(
        _piece(structure, keys, pictures, tracks, report)
        for structure, keys in zip(structures, chosen, strict=True)
    )


def depth_frames(tracks: SequenceTracks, structures: Sequence[Structure]) -> list[list[int]]:
    """Choose the key frames of each piece that get depth, a limited number in all.

    If even two frames of each piece are too many, the shortest pieces get none.
    """
    keys = [
        [
            k
            for k in tracks.key_frames
            if k in structure.poses
            and np.count_nonzero(structure.triangulated[tracks.seen[k].ids]) >= MIN_VIEW_POINTS
        ]
        for structure in structures
    ]
    total = sum(len(each) for each in keys)
    if total <= MAX_DEPTH_FRAMES:
        return keys
    shares = [max(2, len(each) * MAX_DEPTH_FRAMES // total) for each in keys]
    chosen = [
        [each[k] for k in np.unique(np.linspace(0, len(each) - 1, share).round().astype(int))] if each else []
        for each, share in zip(keys, shares, strict=True)
    ]
    room = MAX_DEPTH_FRAMES
    for number in sorted(range(len(keys)), key=lambda number: -len(keys[number])):
        chosen[number] = chosen[number] if len(chosen[number]) <= room else []
        room -= len(chosen[number])
    return chosen


def companions(keys: Sequence[int], structure: Structure) -> list[int]:
    """Return located frames near the frames with depth, which see longer what soon leaves a frame."""
    gaps = np.diff(keys) if len(keys) > 1 else np.ones(1)
    step = max(1, round(float(np.median(gaps)) / COMPANION_SHARE))
    return [k for key in keys for k in (key - step, key + step) if k in structure.poses and k not in keys]


def _piece(
    structure: Structure,
    keys: Sequence[int],
    pictures: Mapping[int, Frame],
    tracks: SequenceTracks,
    report: Callable[[str], None],
) -> MapPiece:
    """Estimate the depths and the cloud of one piece."""
    factor = reduction(tracks.width_px, tracks.height_px)
    near = sorted({*keys, *companions(keys, structure)})
    views = {k: _view(structure, tracks, k, pictures[k], factor) for k in near}
    nearest = max((inverse_depth_span(views[k])[1] for k in keys), default=0.0)
    swept = {}
    for number, frame in enumerate(keys, start=1):
        report(f"depth: frame {frame}, {number} of {len(keys)}")
        estimate = sweep_depth(views, frame, nearest)
        if estimate is not None:
            swept[frame] = estimate
    shape = tracks.height_px, tracks.width_px
    depths = {k: _enlarged(depth, factor, shape) for k, depth in complete_depths(views, swept).items()}
    maps = ((depth, structure.poses[k], rgb_from_frame(pictures[k])) for k, depth in depths.items())
    points, colours = dense_cloud(maps, structure.K)
    return MapPiece(structure.K, dict(sorted(structure.poses.items())), points, colours, depths)


def reduction(width_px: int, height_px: int) -> int:
    """Return the reduction factor of frames before the estimation of their depth."""
    return max(1, int(np.ceil(np.sqrt(width_px * height_px / MAX_PIXELS))))


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


def _enlarged(depth: Singles, factor: int, shape: tuple[int, int]) -> Singles:
    if factor == 1:
        return depth
    return np.ascontiguousarray(depth.repeat(factor, axis=0).repeat(factor, axis=1)[: shape[0], : shape[1]])


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
