"""Incremental mapping: cameras of key frames and points of the scene, then cameras of all other frames."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from sfm.mapping.point_tracker import SequenceTracks
from sfm.mapping.structure import (
    MAX_ERROR_PX,
    SEED,
    Observations,
    Structure,
    adjust,
    locate,
    observations,
    rays_through,
    reprojection,
    stacked,
    triangulate,
    widest_angles_deg,
)

Floats = NDArray[np.float64]

SEED_KEYS = 12
"""Key frames among which the first pair of a piece is looked for."""
LOCAL_KEYS = 8
"""Latest key frames that are adjusted whenever one is added."""
LOCAL_CONTEXT = 24
"""Latest key frames whose observations then count."""
GLOBAL_GROWTH = 1.25
"""All key frames are adjusted whenever there are so many times more of them."""
MAX_SKIPPED = 3
"""Key frames in a row that cannot be located; then the piece ends."""
MAX_JOINT_FRAMES = 400
"""With more frames in a piece only its key frames are adjusted together; others follow from the points."""
MIN_KEYS = 3
"""A piece has at least so many key frames."""
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


def reconstruct_pieces(tracks: SequenceTracks, report: Callable[[str], None]) -> list[Structure]:
    """Find the cameras of a sequence: structures that share no coordinate frame, in order."""
    pieces: list[Structure] = []
    keys = tracks.key_frames
    start = 0
    first_frame = 0
    while start < len(keys) - 1:
        seed = first_structure(tracks, keys[start : start + SEED_KEYS])
        if seed is None:
            start += 1
            continue
        growing = GrowingPiece(tracks, seed)
        end = growing.grow([key for key in keys if key > max(seed.poses)])
        report(f"mapping: {len(growing.structure.poses)} key frames from frame {min(seed.poses)}")
        if len(growing.structure.poses) >= MIN_KEYS:
            piece = growing.complete(range(first_frame, min(end + 1, len(tracks.seen))))
            pieces.append(piece)
            first_frame = max(piece.poses) + 1
        start = max(start + 1, next((k for k, key in enumerate(keys) if key > end), len(keys)))
    return pieces


def complete_by_tracks(structure: Structure, tracks: SequenceTracks, frames: Sequence[int]) -> Structure:
    """Find the tracked points from frames with known poses, and the poses of other frames from the points."""
    numbers, points = triangulate(structure, observations(tracks.seen, sorted(structure.poses)))
    found = structure.points.copy()
    found[numbers] = points
    return _with_other_frames(replace(structure, points=found), tracks, frames)


def _with_other_frames(structure: Structure, tracks: SequenceTracks, frames: Sequence[int]) -> Structure:
    poses = dict(structure.poses)
    for frame in frames:
        if frame not in poses:
            pose = locate(structure, frame, observations(tracks.seen, [frame]))
            if pose is not None:
                poses[frame] = pose
    return replace(structure, poses=poses)


class GrowingPiece:
    """A piece to which key frames are added, one after the other."""

    def __init__(self, tracks: SequenceTracks, seed: Structure) -> None:
        self.structure = seed
        self._tracks = tracks
        self._keys = sorted(seed.poses)
        self._adjusted = len(self._keys)
        self._seen = observations(tracks.seen, self._keys)

    def grow(self, keys: Sequence[int]) -> int:
        """Add key frames while they can be located; return the last frame that belongs to the piece."""
        skipped = 0
        for key in keys:
            seen = observations(self._tracks.seen, [key])
            pose = locate(self.structure, key, seen)
            if pose is None:
                skipped += 1
                if skipped > MAX_SKIPPED:
                    break
                continue
            skipped = 0
            self._add(key, pose, seen)
        self._adjust_all()
        return self._keys[-1] if skipped else len(self._tracks.seen)

    def complete(self, frames: Sequence[int]) -> Structure:
        """Locate all other frames, and adjust everything together if there are not too many of them."""
        self.structure = _with_other_frames(self.structure, self._tracks, frames)
        if len(self.structure.poses) <= MAX_JOINT_FRAMES:
            self._seen = observations(self._tracks.seen, sorted(self.structure.poses))
            self._adjust_all()
            self.structure = _with_other_frames(self.structure, self._tracks, frames)
        return self.structure

    def _add(self, key: int, pose: Floats, seen: Observations) -> None:
        self.structure.poses[key] = pose
        self._keys.append(key)
        self._seen = self._seen.joined(seen)
        if len(self._keys) >= GLOBAL_GROWTH * self._adjusted:
            self._adjust_all()
            return
        recent = self._seen[self._seen.frames >= self._keys[-LOCAL_CONTEXT:][0]]
        self._triangulate(recent)
        near = self._near(recent)
        self.structure = adjust(self.structure, near, set(self._keys[-LOCAL_KEYS:]), focal=False)

    def _adjust_all(self) -> None:
        for _ in range(2):
            self._triangulate(self._seen)
            self.structure = adjust(self.structure, self._near(self._seen))
            self._forget_wrong()
        self._adjusted = len(self._keys)

    def _triangulate(self, seen: Observations) -> None:
        """Find points that are not known yet."""
        unknown = seen[~self.structure.known[seen.points]]
        numbers, points = triangulate(self.structure, unknown)
        found = self.structure.points.copy()
        found[numbers] = points
        self.structure = replace(self.structure, points=found)

    def _near(self, seen: Observations) -> Observations:
        """Observations that agree with the structure."""
        errors, _ = reprojection(self.structure, seen)
        return seen[errors <= 2.0 * MAX_ERROR_PX]

    def _forget_wrong(self) -> None:
        """Forget points that fewer than two frames see where they are."""
        errors, _ = reprojection(self.structure, self._seen)
        count = np.bincount(self._seen.points[errors <= MAX_ERROR_PX], minlength=len(self.structure.points))
        self.structure.points[count < 2] = np.nan


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
