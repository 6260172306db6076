"""Incremental mapping: cameras of key frames and points of the scene, then cameras of all other frames."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dvc.arrays import Floats
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.colmap_estimators import pinhole_camera, relative_pose
from sfm.mapping.sequence_tracks import SequenceTracks
from sfm.mapping.structure import (
    MAX_ERROR_PX,
    SEED,
    Observations,
    Structure,
    adjust_bundle,
    observations,
    rays_through,
    register_frame,
    reprojection_errors,
    stacked,
    triangulate,
    widest_angles_deg,
)

SEED_KEYS = 12
"""Number of key frames that are searched for the initial pair of a piece."""
LOCAL_KEYS = 8
"""Number of latest key frames that are adjusted when a key frame is added."""
LOCAL_CONTEXT = 24
"""Number of latest key frames with observations that count in that adjustment."""
GLOBAL_GROWTH = 1.25
"""Growth of the number of key frames after which all of them are adjusted."""
MAX_SKIPPED = 3
"""Largest number of key frames in a row without a pose; more end the piece."""
MAX_JOINT_FRAMES = 400
"""Largest number of frames that are adjusted together; in larger pieces only key frames are adjusted."""
MIN_KEYS = 3
"""Least number of key frames of a piece."""
FOCAL_LENGTHS = (0.7, 1.0, 1.4, 2.0)
"""Initial focal lengths, in units of the longer side of the frame."""
USUAL_FOCAL_LENGTH = 1.2
"""Focal length for the choice of the initial pair."""
FOCAL_RANGE = (0.35, 5.0)
"""Focal lengths of real lenses, in the same units."""
MIN_COMMON = 60
"""Least number of points that a pair shares."""
GOOD_ANGLE_DEG = 5.0
"""Median angle between rays that ends the search for a pair."""
LEAST_ANGLE_DEG = 1.5
"""Least median angle of a pair; below it the camera turned or stood still."""
MAX_EPIPOLAR_PX = 1.5
MAX_FOCAL_ERROR_PX = 4.0
"""Largest reprojection error that influences the choice of a focal length."""


def map_pieces(tracks: SequenceTracks, report: Callable[[str], None]) -> list[Structure]:
    """Reconstruct a sequence as structures that share no coordinate frame, in temporal order."""
    pieces: list[Structure] = []
    keys = tracks.key_frames
    start = first_frame = 0
    while start < len(keys) - 1:
        seed = initial_structure(tracks, keys[start : start + SEED_KEYS])
        if seed is None:
            start += 1
            continue
        mapper = IncrementalMapper(tracks, seed)
        end = mapper.register_key_frames([key for key in keys if key > max(seed.poses)])
        report(f"mapping: {len(mapper.structure.poses)} key frames from frame {min(seed.poses)}")
        if len(mapper.structure.poses) >= MIN_KEYS:
            piece = mapper.register_all_frames(range(first_frame, min(end + 1, len(tracks.seen))))
            pieces.append(piece)
            first_frame = max(piece.poses) + 1
        start = max(start + 1, next((k for k, key in enumerate(keys) if key > end), len(keys)))
    return pieces


def register_frames(structure: Structure, tracks: SequenceTracks, frames: Sequence[int]) -> Structure:
    """Add the poses of frames that can be registered."""
    poses = dict(structure.poses)
    for frame in frames:
        if frame not in poses:
            pose = register_frame(structure, frame, observations(tracks.seen, [frame]))
            if pose is not None:
                poses[frame] = pose
    return replace(structure, poses=poses)


class IncrementalMapper:
    """A piece that grows by one key frame after the other."""

    def __init__(self, tracks: SequenceTracks, seed: Structure) -> None:
        self.structure = seed
        self._tracks = tracks
        self._keys = sorted(seed.poses)
        self._num_adjusted = len(self._keys)
        self._seen = observations(tracks.seen, self._keys)

    def register_key_frames(self, keys: Sequence[int]) -> int:
        """Add key frames until they cannot be registered; return the last frame of the piece."""
        skipped = 0
        for key in keys:
            pose = register_frame(self.structure, key, observations(self._tracks.seen, [key]))
            if pose is None:
                skipped += 1
                if skipped > MAX_SKIPPED:
                    break
                continue
            skipped = 0
            self.structure.poses[key] = pose
            self._keys.append(key)
            self._seen = observations(self._tracks.seen, self._keys)
            if len(self._keys) >= GLOBAL_GROWTH * self._num_adjusted:
                self._adjust_globally()
                continue
            recent = self._seen[self._seen.frames >= self._keys[-LOCAL_CONTEXT:][0]]
            self._triangulate(recent)
            free = set(self._keys[-LOCAL_KEYS:])
            self.structure = adjust_bundle(self.structure, self._agreeing(recent), free, focal=False)
        self._adjust_globally()
        return self._keys[-1] if skipped else len(self._tracks.seen)

    def register_all_frames(self, frames: Sequence[int]) -> Structure:
        """Register all other frames, and adjust all together unless they are too many."""
        self.structure = register_frames(self.structure, self._tracks, frames)
        if len(self.structure.poses) <= MAX_JOINT_FRAMES:
            self._seen = observations(self._tracks.seen, sorted(self.structure.poses))
            self._adjust_globally()
            self.structure = register_frames(self.structure, self._tracks, frames)
        return self.structure

    def _adjust_globally(self) -> None:
        for _ in range(2):
            self._triangulate(self._seen)
            self.structure = adjust_bundle(self.structure, self._agreeing(self._seen))
            # Drop the positions of points that fewer than two observations agree with.
            errors = reprojection_errors(self.structure, self._seen)
            points = self._seen.points[errors <= MAX_ERROR_PX]
            self.structure.points[np.bincount(points, minlength=len(self.structure.points)) < 2] = np.nan
        self._num_adjusted = len(self._keys)

    def _triangulate(self, seen: Observations) -> None:
        """Triangulate points without a position."""
        numbers, positions = triangulate(self.structure, seen[~self.structure.triangulated[seen.points]])
        points = self.structure.points.copy()
        points[numbers] = positions
        self.structure = replace(self.structure, points=points)

    def _agreeing(self, seen: Observations) -> Observations:
        """Return the observations that agree with the structure."""
        return seen[reprojection_errors(self.structure, seen) <= 2.0 * MAX_ERROR_PX]


def initial_structure(tracks: SequenceTracks, keys: Sequence[int]) -> Structure | None:
    """Reconstruct the first key frames of a piece with the best focal length; None without parallax."""
    usual = _initial_pair(tracks, keys, intrinsics(tracks, USUAL_FOCAL_LENGTH))
    if usual is None:
        return None
    first, last = min(usual.poses), max(usual.poses)
    best: tuple[float, Structure] | None = None
    for ratio in FOCAL_LENGTHS:
        pair = _pair(tracks, intrinsics(tracks, ratio), first, last)
        candidate = None if pair is None else _with_frames_between(tracks, pair[1], keys)
        if candidate is not None and (best is None or candidate[0] < best[0]):
            best = candidate
    return None if best is None else best[1]


def intrinsics(tracks: SequenceTracks, ratio: float) -> Floats:
    """Return the calibration matrix of a focal length in units of the longer side."""
    focal = ratio * max(tracks.width_px, tracks.height_px)
    x, y = 0.5 * (tracks.width_px - 1), 0.5 * (tracks.height_px - 1)
    return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])


def _initial_pair(tracks: SequenceTracks, keys: Sequence[int], K: Floats) -> Structure | None:
    """Return the first key frame with the nearest key frame that shows enough parallax."""
    best: tuple[float, Structure] | None = None
    for other in keys[1:]:
        if len(np.intersect1d(tracks.seen[keys[0]].ids, tracks.seen[other].ids)) < MIN_COMMON:
            break
        pair = _pair(tracks, K, keys[0], other)
        if pair is not None and pair[0] >= GOOD_ANGLE_DEG:
            return pair[1]
        if pair is not None and (best is None or pair[0] > best[0]):
            best = pair
    return best[1] if best is not None and best[0] >= LEAST_ANGLE_DEG else None


def _pair(tracks: SequenceTracks, K: Floats, first: int, second: int) -> tuple[float, Structure] | None:
    """Return the median angle between the rays of two frames, and their structure."""
    import pycolmap

    seen = observations(tracks.seen, [first, second])
    seen = seen[np.isin(seen.points, np.intersect1d(tracks.seen[first].ids, tracks.seen[second].ids))]
    parts = seen[seen.frames == first], seen[seen.frames == second]
    positions = [part.positions[np.argsort(part.points)] + COLMAP_FIRST_PIXEL_PX for part in parts]
    ransac = pycolmap.RANSACOptions(
        max_error=MAX_EPIPOLAR_PX, random_seed=SEED, num_threads=1, max_num_trials=2000
    )
    answer = relative_pose(pinhole_camera(K), positions[0], positions[1], ransac)
    norm = 0.0 if answer is None else float(np.linalg.norm(answer[0][:, 3]))
    if answer is None or np.count_nonzero(answer[1]) < MIN_COMMON or not norm > 0:
        return None
    pose, inliers = answer
    pose[:, 3] /= norm
    structure = Structure(K, {first: np.eye(3, 4), second: pose}, np.full((tracks.num_points, 3), np.nan))
    numbers, points = triangulate(structure, seen)
    structure.points[numbers] = points
    if len(numbers) < MIN_COMMON // 2:
        return None
    # All inliers count, even points too far away to be triangulated.
    number, which = np.unique(seen.points, return_inverse=True)
    rays = rays_through(K, seen.positions)
    angles = widest_angles_deg(stacked(structure.poses, seen.frames), rays, which, len(number))
    return float(np.median(angles[inliers])), structure


def _with_frames_between(
    tracks: SequenceTracks, pair: Structure, keys: Sequence[int]
) -> tuple[float, Structure] | None:
    """Register the key frames between a pair, and adjust all with the focal length; return the error, too."""
    first, last = min(pair.poses), max(pair.poses)
    structure = adjust_bundle(pair, observations(tracks.seen, [first, last]), focal=False)
    structure = register_frames(structure, tracks, [key for key in keys if first < key < last])
    seen = observations(tracks.seen, sorted(structure.poses))
    for _ in range(2):
        errors = reprojection_errors(structure, seen)
        structure = adjust_bundle(structure, seen[errors <= MAX_FOCAL_ERROR_PX])
        numbers, points = triangulate(structure, seen)
        structure.points[:] = np.nan
        structure.points[numbers] = points
    focal = structure.K[0, 0] / max(tracks.width_px, tracks.height_px)
    errors = reprojection_errors(structure, seen)
    finite = errors[np.isfinite(errors)]
    if not FOCAL_RANGE[0] <= focal <= FOCAL_RANGE[1] or len(finite) < 2 * MIN_COMMON:
        return None
    share = len(finite) / len(errors)
    return float(np.sqrt(np.mean(np.minimum(finite, MAX_FOCAL_ERROR_PX) ** 2)) / share), structure
