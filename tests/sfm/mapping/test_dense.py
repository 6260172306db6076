"""Dense depth of views with known cameras, fusion of depth maps, and clouds."""

import numpy as np
import pytest

from dvc.geometry.cameras import PixelFrame
from dvc.geometry.depth_maps import MIN_CONFIDENCE
from sfm.mapping.dense import (
    MAX_DEPTH_FRAMES,
    Candidate,
    SweptDepth,
    View,
    complete_depths,
    dense_cloud,
    dense_pieces,
    depth_frames,
    drawn_candidate,
    fused_depth,
    inverse_depth_span,
    neighbours,
    points_in_world,
    sweep_depth,
)
from sfm.mapping.structure import Structure
from tests.scenes_3d import camera_at, render
from tests.sfm.mapping.moving_camera import HEIGHT, WIDTH, K, pose_of, scene, tracks_of

SIZE = PixelFrame(96, 80)
SMALL_K = np.array([[96.0, 0.0, 47.5], [0.0, 96.0, 39.5], [0.0, 0.0, 1.0]])
SPARSE_K = SMALL_K / [[8.0], [8.0], [1.0]]


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


def test_points_project_to_their_pixels() -> None:
    depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    depth[10, 20], depth[200, 300] = 3.0, 5.0
    pose = pose_of(7)
    points, known = points_in_world(depth, K, pose)
    inside = points @ pose[:, :3].T + pose[:, 3]
    np.testing.assert_allclose(inside[:, 2], [3.0, 5.0])
    image = inside @ K.T
    np.testing.assert_allclose(image[:, :2] / image[:, 2:], [[20, 10], [300, 200]], atol=1e-9)
    assert known.sum() == 2
    # A piece without depth has cameras and no points.
    poses = {k: pose_of(k) for k in range(2)}
    tracks = tracks_of(list(poses.values()), scene(5))
    (piece,) = dense_pieces([], tracks, [Structure(K, poses, scene(5))], lambda _: None)
    assert (list(piece.poses), piece.depths, len(piece.points)) == ([0, 1], {}, 0)


def test_the_cloud_is_bounded() -> None:
    depth = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[:, WIDTH // 2 :] = 200
    maps = [(depth, pose_of(k, turn=0.0), picture) for k in range(6)]
    points, colours = dense_cloud(maps, K, limit=5000)
    assert 1000 < len(points) <= 5000
    assert len(points) == len(colours)
    once, colours = dense_cloud(maps[:1], K, limit=5000)
    assert ((once[:, 0] > 0) == (colours[:, 0] > 0)).mean() > 0.95
    none, colours = dense_cloud([(np.full_like(depth, np.nan), pose_of(0), picture)], K)
    assert none.shape == colours.shape == (0, 3)


def _views(positions: list[float]) -> tuple[dict[int, View], dict[int, np.ndarray]]:
    views, depths = {}, {}
    for k, position in enumerate(positions):
        camera = camera_at(position)
        pose = camera / np.cbrt(np.linalg.det(camera[:, :3]))
        luma, inverse = render(position, SIZE)
        depths[k] = 1.0 / inverse
        points, _ = points_in_world(depths[k][::8, ::8].astype(np.float32), SPARSE_K, pose)
        views[k] = View(luma, SMALL_K, pose, points)
    return views, depths


def test_depth_of_exact_cameras() -> None:
    views, true = _views([0.0, 0.5, 1.0, 1.5])
    nearest = max(inverse_depth_span(view)[1] for view in views.values())
    swept = {k: found for k in views if (found := sweep_depth(views, k, nearest)) is not None}
    completed = complete_depths(views, swept)
    assert sorted(completed) == [0, 1, 2, 3]
    ratio = np.concatenate([(completed[k] / true[k]).ravel() for k in completed])
    ratio /= np.median(ratio)
    assert np.nanmedian(np.abs(ratio - 1.0)) < 0.02
    assert np.mean(np.abs(ratio - 1.0) < 0.05) > 0.85


def test_neighbours_lie_on_both_sides() -> None:
    views, _ = _views([0.0, 0.5, 1.0, 1.5, 2.0])
    chosen = neighbours(views, 2)
    assert 2 not in chosen
    assert min(chosen) < 2 < max(chosen)


@pytest.mark.parametrize("positions", [[0.0], [0.0, 0.0]])
def test_without_baseline_there_is_no_depth(positions: list[float]) -> None:
    views, _ = _views(positions)
    assert sweep_depth(views, 0, 1.0) is None


SHAPE = (6, 8)


def _swept(inverse_depth: float, error: float = 0.01) -> SweptDepth:
    return SweptDepth(np.full(SHAPE, inverse_depth), np.full(SHAPE, 2.0 * MIN_CONFIDENCE), error)


@pytest.mark.parametrize(
    ("others", "consistent", "depth", "votes"),
    [
        # Two that agree win against the frame.
        ([(0.2, 0.01), (0.21, 0.01), (np.nan, 0.01)], False, 0.205, 2),
        # Consistent depth is only averaged with depth that agrees, weighted by its error.
        ([(0.2, 0.01), (0.2, 0.01), (0.2, 0.01), (0.515, 0.005)], True, (0.5 + 4.0 * 0.515) / 5.0, 2),
        # A single candidate does not count.
        ([(0.2, 0.01)], False, 0.5, 1),
        # Of equal votes the smaller error wins.
        ([(0.51, 0.01), (0.2, 0.002), (0.2, 0.002)], False, 0.2, 2),
    ],
)
def test_fusion(others: list[tuple[float, float]], consistent: bool, depth: float, votes: int) -> None:
    candidates = [Candidate(np.full(SHAPE, value), np.full(SHAPE, error)) for value, error in others]
    found, counts = fused_depth(_swept(0.5), candidates, np.full(SHAPE, consistent))
    assert found == pytest.approx(depth)
    assert (counts == votes).all()


def test_a_nearer_frame_knows_depth_better() -> None:
    """A camera stands a unit behind another: what that one sees at depth 1 is at depth 2 here."""
    back = np.column_stack([np.eye(3), [3.5, 2.5, 1.0]])  # the epipole is the middle of the picture
    found = drawn_candidate(_swept(1.0), back)
    seen = np.isfinite(found.inverse_depth)
    assert 0 < seen.sum() < seen.size
    assert found.inverse_depth[seen] == pytest.approx(0.5)
    assert found.error[seen] == pytest.approx(0.0025)
    # Depth that noise would have produced as well is not drawn.
    doubtful = SweptDepth(np.full(SHAPE, 1.0), np.zeros(SHAPE), 0.01)
    assert np.isnan(drawn_candidate(doubtful, np.eye(3, 4)).inverse_depth).all()
