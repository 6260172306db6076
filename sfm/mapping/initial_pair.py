"""The first frames of a piece: a pair with enough parallax, and the focal length that suits them best."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.mapping.adjustment import SEED, adjust, locate
from sfm.mapping.structure import (
    Observations,
    Structure,
    observations,
    rays_through,
    reprojection,
    stacked,
    triangulate,
    widest_angles_deg,
)
from sfm.mapping.tracking import SequenceTracks

Floats = NDArray[np.float64]

FOCAL_LENGTHS = (0.7, 1.0, 1.4, 2.0)
"""Focal lengths to begin with, in units of the longer side of the frame."""
USUAL_FOCAL_LENGTH = 1.2
"""The one that the pair is chosen with."""
FOCAL_RANGE = (0.35, 5.0)
"""What lenses have, in the same units."""
MIN_COMMON = 60
"""Points that a pair must share."""
GOOD_ANGLE_DEG = 5.0
"""Median angle between rays from which a pair serves without looking for a better one."""
LEAST_ANGLE_DEG = 1.5
"""Below it the camera turned, or stood still."""
MAX_EPIPOLAR_PX = 1.5


def first_structure(tracks: SequenceTracks, keys: Sequence[int]) -> Structure | None:
    """Reconstruct the first key frames of a piece; None where they show no parallax."""
    usual = _first_pair(tracks, keys, intrinsics(tracks, USUAL_FOCAL_LENGTH))
    if usual is None:
        return None
    first, last = min(usual.poses), max(usual.poses)
    best: tuple[float, Structure] | None = None
    for ratio in FOCAL_LENGTHS:
        pair = _pair(tracks, intrinsics(tracks, ratio), first, last, _common(tracks, first, last))
        found = None if pair is None else _with_frames_between(tracks, pair[1], keys)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    return None if best is None else best[1]


def intrinsics(tracks: SequenceTracks, ratio: float) -> Floats:
    """Return the calibration matrix of a focal length in units of the longer side."""
    focal = ratio * max(tracks.width_px, tracks.height_px)
    x, y = 0.5 * (tracks.width_px - 1), 0.5 * (tracks.height_px - 1)
    return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])


def _first_pair(tracks: SequenceTracks, keys: Sequence[int], K: Floats) -> Structure | None:
    """Return the first frame with the nearest one that shows enough parallax."""
    best: tuple[float, Structure] | None = None
    for other in keys[1:]:
        seen = _common(tracks, keys[0], other)
        if len(seen.points) < 2 * MIN_COMMON:
            break
        pair = _pair(tracks, K, keys[0], other, seen)
        if pair is not None and pair[0] >= GOOD_ANGLE_DEG:
            return pair[1]
        if pair is not None and (best is None or pair[0] > best[0]):
            best = pair
    return best[1] if best is not None and best[0] >= LEAST_ANGLE_DEG else None


def _common(tracks: SequenceTracks, first: int, second: int) -> Observations:
    """Return what two frames see in common: all of the first, then the same points in the second."""
    seen = observations(tracks.seen, [first, second])
    both = np.intersect1d(tracks.seen[first].ids, tracks.seen[second].ids)
    return seen[np.isin(seen.points, both)]


def _pair(
    tracks: SequenceTracks, K: Floats, first: int, second: int, seen: Observations
) -> tuple[float, Structure] | None:
    """Return the median angle between the rays of a pair, and its structure."""
    import pycolmap

    size = tracks.width_px, tracks.height_px
    parameters = [K[0, 0], K[0, 2] + COLMAP_FIRST_PIXEL_PX, K[1, 2] + COLMAP_FIRST_PIXEL_PX]
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", params=parameters, width=size[0], height=size[1])
    places = [
        part.positions[np.argsort(part.points)] + COLMAP_FIRST_PIXEL_PX
        for part in (seen[seen.frames == first], seen[seen.frames == second])
    ]
    ransac = pycolmap.RANSACOptions(
        max_error=MAX_EPIPOLAR_PX, random_seed=SEED, num_threads=1, max_num_trials=2000
    )
    answer = pycolmap.estimate_relative_pose(camera, places[0], camera, places[1], ransac)
    if answer is None or np.count_nonzero(answer["inlier_mask"]) < MIN_COMMON:
        return None
    mask = answer["inlier_mask"]
    refined = pycolmap.refine_relative_pose(
        answer["cam2_from_cam1"], camera, places[0], camera, places[1], mask
    )
    rigid = answer["cam2_from_cam1"] if refined is None else refined["cam2_from_cam1"]
    pose = np.asarray(rigid.matrix(), np.float64)
    norm = float(np.linalg.norm(pose[:, 3]))
    if not norm > 0:
        return None
    pose[:, 3] /= norm
    structure = Structure(K, {first: np.eye(3, 4), second: pose}, np.full((tracks.num_points, 3), np.nan))
    numbers, points = triangulate(structure, seen)
    structure.points[numbers] = points
    if len(numbers) < MIN_COMMON // 2:
        return None
    # all rays that agree count, also those of points too far away to be triangulated
    number, which = np.unique(seen.points, return_inverse=True)
    rays = rays_through(K, seen.positions)
    angles = widest_angles_deg(stacked(structure.poses, seen.frames), rays, which, len(number))
    return float(np.median(angles[np.asarray(mask)])), structure


def _with_frames_between(
    tracks: SequenceTracks, pair: Structure, keys: Sequence[int]
) -> tuple[float, Structure] | None:
    """Locate the key frames between a pair, adjust all with the focal length; return the error, too."""
    first, last = min(pair.poses), max(pair.poses)
    structure = adjust(pair, observations(tracks.seen, [first, last]), focal=False)
    for key in (key for key in keys if first < key < last):
        pose = locate(structure, key, observations(tracks.seen, [key]))
        if pose is not None:
            structure.poses[key] = pose
    seen = observations(tracks.seen, sorted(structure.poses))
    for _ in range(2):
        errors, _ = reprojection(structure, seen)
        structure = adjust(structure, seen[errors <= 4.0])
        numbers, points = triangulate(structure, seen)
        structure.points[:] = np.nan
        structure.points[numbers] = points
    focal = structure.K[0, 0] / max(tracks.width_px, tracks.height_px)
    errors, _ = reprojection(structure, seen)
    finite = errors[np.isfinite(errors)]
    if not FOCAL_RANGE[0] <= focal <= FOCAL_RANGE[1] or len(finite) < 2 * MIN_COMMON:
        return None
    share = len(finite) / len(errors)
    return float(np.sqrt(np.mean(np.minimum(finite, 4.0) ** 2)) / share), structure
