"""Depth of the frames of a sequence, and clouds of depth maps."""

import numpy as np
import pytest

from sfm.mapping.dense import MAX_DEPTH_FRAMES, dense_cloud, dense_pieces, depth_frames, points_in_world
from sfm.mapping.structure import Structure
from tests.sfm.mapping.moving_camera import HEIGHT, WIDTH, K, pose_of, scene, tracks_of


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


def test_points_project_to_their_pixels() -> None:
    """Back to where they come from, at their depth."""
    depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    depth[10, 20], depth[200, 300] = 3.0, 5.0
    pose = pose_of(7)
    points, known = points_in_world(depth, K, pose)
    inside = points @ pose[:, :3].T + pose[:, 3]
    np.testing.assert_allclose(inside[:, 2], [3.0, 5.0])
    image = inside @ K.T
    np.testing.assert_allclose(image[:, :2] / image[:, 2:], [[20, 10], [300, 200]], atol=1e-9)
    assert known.sum() == 2


def test_the_cloud_is_bounded() -> None:
    """However many maps there are; colours stay with their points."""
    depth = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[:, WIDTH // 2 :] = 200
    maps = [(depth, pose_of(k, turn=0.0), picture) for k in range(6)]
    points, colours = dense_cloud(maps, K, limit=5000)
    assert 1000 < len(points) <= 5000
    assert len(points) == len(colours)
    once, colours = dense_cloud(maps[:1], K, limit=5000)
    assert ((once[:, 0] > 0) == (colours[:, 0] > 0)).mean() > 0.95


def test_no_maps_no_points() -> None:
    """Neither do maps of which nothing is known."""
    unknown = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    points, colours = dense_cloud([(unknown, pose_of(0), np.zeros((HEIGHT, WIDTH, 3), np.uint8))], K)
    assert points.shape == (0, 3)
    assert colours.shape == (0, 3)
