"""Which frames of a sequence have depth."""

import pytest

from sfm.mapping.dense import MAX_DEPTH_FRAMES, dense_pieces, depth_frames
from sfm.mapping.structure import Structure
from tests.sfm.mapping.moving_camera import K, pose_of, scene, tracks_of


@pytest.mark.parametrize("lengths", [(3, 4), (130, 70), (3,) * 40, (100, *(2,) * 50), (1,) * 60])
def test_frames_with_depth_are_bounded(lengths: tuple[int, ...]) -> None:
    """In all pieces together; the longest ones have some, and all key frames where these are few."""
    total = sum(lengths)
    points, poses = scene(), [pose_of(0.01 * k) for k in range(total)]
    tracks = tracks_of(poses, points, spacing=1)
    structures, start = [], 0
    for length in lengths:
        structures.append(Structure(K, {k: poses[k] for k in range(start, start + length)}, points))
        start += length
    chosen = depth_frames(tracks, structures)
    assert sum(map(len, chosen)) == total if total <= MAX_DEPTH_FRAMES else sum(map(len, chosen)) > 0
    assert sum(map(len, chosen)) <= MAX_DEPTH_FRAMES
    longest = lengths.index(max(lengths))
    assert len(chosen[longest]) == max(map(len, chosen))
    assert all(set(keys) <= set(each.poses) for keys, each in zip(chosen, structures, strict=True))


def test_a_piece_without_depth_has_cameras() -> None:
    """And no points."""
    poses = {k: pose_of(k) for k in range(2)}
    tracks = tracks_of(list(poses.values()), scene(5))
    (piece,) = dense_pieces([], tracks, [Structure(K, poses, scene(5))], lambda _: None)
    assert (list(piece.poses), piece.depths, len(piece.points)) == ([0, 1], {}, 0)
