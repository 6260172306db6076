"""Incremental mapping: cameras of key frames and points of the scene, then cameras of all other frames."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sfm.mapping.adjustment import adjust, locate
from sfm.mapping.initial_pair import first_structure
from sfm.mapping.structure import (
    MAX_ERROR_PX,
    Observations,
    Structure,
    observations,
    reprojection,
    triangulate,
)
from sfm.mapping.tracking import SequenceTracks

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
