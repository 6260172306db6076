"""Corners and their tracks: known motion, losses, operations, odd frames."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.video import Frame
from encoder import _kernels
from encoder.block_matching import PointTrackerSettings, spiral
from encoder.corners import TRACKED_CORNERS, CornerDetector, CornerSettings, find_corners
from encoder.tracking import PointTracker
from tests.clips import moving_texture
from tests.reference import block_tracking as reference

STILL_LIFE = moving_texture(1, 120, 160)[0].luma
FULL_SEARCH_BLOCKS = 961  # of +-15 px, for each 8x8 block


def odd_frames() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "black": np.zeros((48, 64), np.uint8),
        "white": np.full((48, 64), 255, np.uint8),
        "noise": rng.integers(0, 256, (48, 64)).astype(np.uint8),
        "16x16": rng.integers(0, 256, (16, 16)).astype(np.uint8),
        "1x1": np.zeros((1, 1), np.uint8),
        "odd": STILL_LIFE[:37, :53],
        "narrow": STILL_LIFE[:9],
    }


@pytest.mark.parametrize("settings", [CornerSettings(), TRACKED_CORNERS, CornerSettings(grid_px=2)])
@pytest.mark.parametrize("name", odd_frames())
def test_corners_keep_inside_and_apart(name: str, settings: CornerSettings) -> None:
    """Corners lie on the grid, inside the margin, and keep their distance."""
    luma = odd_frames()[name]
    corners = find_corners(luma, 20, 5, settings)
    assert corners.dtype == np.int64
    assert len(corners) <= 20
    assert (corners % settings.grid_px == 0).all()
    assert ((corners >= 5) & (corners < np.array(luma.shape[::-1]) - 5)).all()
    distances = np.hypot(*(corners[:, None] - corners[None]).transpose(2, 0, 1))
    np.fill_diagonal(distances, np.inf)
    assert (distances >= settings.min_distance * (luma.size / 20) ** 0.5).all()
    if name in ("black", "white"):
        assert len(corners) == 0


def test_corners_are_where_edges_meet() -> None:
    """The corners of a square are found, and nothing else."""
    luma = np.full((64, 64), 50, np.uint8)
    luma[20:44, 16:40] = 200
    corners = find_corners(luma, 10, 3)
    expected = np.array([(x, y) for x in (15.5, 39.5) for y in (19.5, 43.5)])
    distances = np.hypot(*(corners[:, None] - expected[None]).transpose(2, 0, 1))
    assert len(corners) == 4
    assert distances.min(axis=0).max() < 2.5


def test_detector_counts_and_scans_columns() -> None:
    """Corners of each frame come column by column, and are counted."""
    detector = CornerDetector(30)
    points = detector.detect([STILL_LIFE, STILL_LIFE[:, ::-1]])
    assert [len(frame) for frame in points.frames] == [30, 30]
    assert all((np.diff(frame[:, 0]) >= 0).all() for frame in points.frames)
    assert detector.num_corners == 60


def test_spiral_starts_at_rest_and_grows() -> None:
    """Each displacement of the square is there once, small ones first."""
    displacements = spiral(3)
    assert displacements[0].tolist() == [0, 0]
    assert len({tuple(d) for d in displacements.tolist()}) == 49
    assert (np.diff(np.hypot(*displacements.T)) >= -1e-12).all()


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_searches_agree_with_the_twin(seed: int, twin: bool) -> None:
    """Spiral and descent find what exhaustive comparisons find, in no more operations."""
    choose = python_twin if twin else (lambda kernel: kernel)
    rng = np.random.default_rng(seed)
    image = STILL_LIFE[:40, :48]
    for _ in range(15):
        x, y = (int(c) for c in rng.integers(2, [46, 38]))
        block = STILL_LIFE[40:45, 60:65] if rng.random() < 0.3 else image[y - 2 : y + 3, x - 2 : x + 3]
        if block.shape != (5, 5):
            continue
        block = np.ascontiguousarray(block)
        at = x + int(rng.integers(-4, 5)), y + int(rng.integers(-4, 5))
        counts = np.zeros(2, np.int64)
        small = int(rng.integers(0, 200))
        found = choose(_kernels.spiral_search)(image, *at, 2, block, small, spiral(4), counts)
        expected = reference.spiral_search(image, *at, block, small, spiral(4))
        assert found == (expected if expected[2] is not None else (*expected[:2], _kernels.UNKNOWN))
        assert counts[0] <= 81
        if expected[2] is None:
            continue
        went = choose(_kernels.descend)(image, *found[:2], 2, block, found[2], 50, counts)
        assert went == reference.descend(image, *expected[:2], block, 50)


@pytest.mark.parametrize("motion_px", [(0.0, 0.0), (3.0, -2.0), (1.0, 4.0)])
@pytest.mark.parametrize("subpixel_bits", [0, 2])
def test_known_motion_is_followed(motion_px: tuple[float, float], subpixel_bits: int) -> None:
    """Tracks of a moving texture stay on it: exactly if it moves by whole pixels."""
    frames = moving_texture(6, 120, 160, motion_px)
    tracker = PointTracker(40, subpixel_bits)
    tracker.start(frames[0].luma)
    for frame in frames[1:]:
        tracker.step(frame.luma)
    tracks = tracker.tracks(6).positions
    assert len(tracks) >= 15
    motion = tracks[:, 1:] - tracks[:, :1]
    expected = np.arange(1, 6)[:, None] * motion_px[::-1]
    assert np.nanmax(np.abs(motion - expected)) <= (0.25 if subpixel_bits else 0.0)
    assert tracker.longest_px == pytest.approx(5 * np.hypot(*motion_px))


def test_parts_of_a_pixel_are_found() -> None:
    """Sub-pixel tracks are nearer to the truth than tracks at whole pixels."""
    frames = moving_texture(4, 120, 160, (0.3, 1.4))
    errors = []
    for bits in (0, 2):
        tracker = PointTracker(40, bits)
        tracker.start(frames[0].luma)
        for frame in frames[1:]:
            tracker.step(frame.luma)
        tracks = tracker.tracks(4).positions
        expected = tracks[:, :1] + np.arange(4)[:, None] * (1.4, 0.3)
        errors.append(np.nanmean(np.hypot(*(tracks - expected)[:, 1:].transpose(2, 0, 1))))
        assert np.array_equal(tracks * 2**bits, np.round(tracks * 2**bits), equal_nan=True)
    assert errors[1] < 0.6 * errors[0]


def test_fast_motion_is_reached() -> None:
    """A jump far beyond the spiral is found by the coarse-to-fine search, within the operations allowed."""
    frames = moving_texture(20, 120, 240, (0.5, 3.0))
    tracker = PointTracker(40)
    tracker.start(frames[0].luma)
    tracker.step(frames[12].luma)
    motion = tracker.tracks(2).positions
    assert len(motion) >= 10
    assert np.nanmedian((motion[:, 1] - motion[:, 0])[:, 0]) == 36
    num_full = (120 // 8) * (240 // 8) * FULL_SEARCH_BLOCKS
    assert tracker.counts.num_blocks <= 0.08 * num_full


def test_operations_stay_small() -> None:
    """Smooth motion costs a few comparisons a point."""
    frames = moving_texture(6, 120, 160, (1.0, 2.0))
    tracker = PointTracker(40)
    tracker.start(frames[0].luma)
    for frame in frames[1:]:
        tracker.step(frame.luma)
    counts = tracker.counts
    assert counts.num_corners == 40
    assert counts.num_frames == 5
    assert counts.num_blocks < 5 * 40 * 60
    assert counts.num_samples <= counts.num_blocks * 121


def test_points_are_lost_for_good() -> None:
    """Another scene loses the points, and they do not come back with the first scene."""
    frames = moving_texture(3, 120, 160)
    tracker = PointTracker(40)
    tracker.start(frames[0].luma)
    tracker.step(frames[1].luma)
    assert tracker.last_lost_share < 0.3
    tracker.step(np.ascontiguousarray(moving_texture(1, 120, 160, seed=9)[0].luma))
    assert tracker.last_lost_share > 0.8
    lost = tracker.lost_share
    tracker.step(frames[2].luma)
    assert tracker.lost_share >= lost
    tracks = tracker.tracks(4).positions
    known = np.isfinite(tracks[:, :, 0])
    assert not (known[:, 1:] & ~known[:, :-1]).any()


@pytest.mark.parametrize("name", odd_frames())
def test_odd_frames_are_followed_or_not(name: str) -> None:
    """Flat, tiny and noisy frames make tracks or none, without a warning."""
    luma = np.ascontiguousarray(odd_frames()[name])
    tracker = PointTracker(20, 1, PointTrackerSettings())
    tracker.start(luma)
    tracker.step(luma)
    tracker.step(np.ascontiguousarray(luma[::-1]))
    tracks = tracker.tracks(3)
    assert tracks.num_instants == 3
    assert tracker.longest_px >= 0
    assert 0 <= tracker.lost_share <= 1
    if name in ("black", "white", "1x1"):
        assert len(tracks) == 0


def test_same_tracks_for_any_number_of_threads() -> None:
    """Corners and tracks do not depend on the threads of the image library."""
    import cv2

    frames: list[Frame] = moving_texture(3, 120, 160)
    found = []
    before = cv2.getNumThreads()
    for threads in (1, 4):
        cv2.setNumThreads(threads)
        tracker = PointTracker(40, 2)
        tracker.start(frames[0].luma)
        tracker.step(frames[1].luma)
        found.append(tracker.tracks(2).positions)
    cv2.setNumThreads(before)
    assert np.array_equal(*found, equal_nan=True)


def followed(frames: list[Frame], settings: PointTrackerSettings, subpixel_bits: int = 0) -> PointTracker:
    tracker = PointTracker(40, subpixel_bits, settings)
    tracker.start(frames[0].luma)
    for frame in frames[1:]:
        tracker.step(frame.luma)
    return tracker


@pytest.mark.parametrize("motion_px", [(0.0, 6.0), (-4.0, 3.0)])
def test_points_that_appear_are_followed_back(motion_px: tuple[float, float]) -> None:
    """Points that enter the frame move as they did before, and are not known before they were there."""
    frames = moving_texture(7, 120, 160, motion_px)
    tracker = followed(frames, PointTrackerSettings())
    tracks = tracker.close([frame.luma for frame in frames[1:]])
    births = tracks.backward
    assert tracks.num_backward == len(births) >= 4
    known = np.isfinite(births[:, :, 0])
    assert known[:, -3:].all()
    assert not (known[:, :-1] & ~known[:, 1:]).any()
    assert not known[:, 0].all()
    motion = births[:, 1:] - births[:, :-1]
    assert np.nanmax(np.abs(motion - motion_px[::-1])) == 0.0


def test_births_are_where_no_track_is() -> None:
    """Points followed back keep away from all tracks that reach the key frame, and from each other."""
    frames = moving_texture(7, 120, 160, (0.0, 6.0))
    settings = PointTrackerSettings(birth_distance_px=20.0, max_births=5)
    tracks = followed(frames, settings).close([frame.luma for frame in frames[1:]])
    assert 0 < tracks.num_backward <= 5
    ends = tracks.forward[:, -1]
    distances = np.hypot(*(tracks.backward[:, None, -1] - ends[np.isfinite(ends[:, 0])]).transpose(2, 0, 1))
    assert distances.min() >= 20.0
    none = followed(frames, PointTrackerSettings(max_births=0)).close([frame.luma for frame in frames[1:]])
    assert none.num_backward == 0
    assert np.array_equal(none.positions, tracks.forward, equal_nan=True)


def test_births_need_frames_between_the_key_frames() -> None:
    """Where a single frame lies between the key frames, none is followed back."""
    frames = moving_texture(3, 120, 160, (0.0, 9.0))
    for num_frames, expected in ((2, False), (1, True)):
        settings = PointTrackerSettings(min_birth_frames=num_frames)
        tracks = followed(frames, settings).close([frame.luma for frame in frames[1:]])
        assert (tracks.num_backward > 0) == expected


def test_nothing_appears_at_rest() -> None:
    """Where all points are still there, none is followed back."""
    frames = moving_texture(1, 120, 160) * 4
    tracks = followed(frames, PointTrackerSettings()).close([frame.luma for frame in frames[1:]])
    assert len(tracks) > 20
    assert tracks.num_backward == 0


def test_closing_starts_the_next_group() -> None:
    """The corners of the closing key frame are found once, and are those of the next group."""
    frames = moving_texture(9, 120, 160, (0.0, 6.0))
    tracker = followed(frames[:7], PointTrackerSettings())
    before = tracker.counts.num_blocks
    tracker.close([frame.luma for frame in frames[1:7]])
    assert tracker.counts.num_blocks > before
    assert tracker.counts.num_corners == 80
    fresh = followed(frames[6:], PointTrackerSettings())
    for frame in frames[7:]:
        tracker.step(frame.luma)
    assert np.array_equal(tracker.tracks(3).positions, fresh.tracks(3).positions, equal_nan=True)


@pytest.mark.parametrize("name", odd_frames())
def test_odd_frames_close_a_group(name: str) -> None:
    """Flat, tiny and noisy frames end groups without a warning."""
    luma = np.ascontiguousarray(odd_frames()[name])
    other = np.ascontiguousarray(luma[::-1])
    for last in (luma, other, np.zeros_like(luma)):
        tracker = followed([Frame(luma), Frame(other), Frame(last)], PointTrackerSettings())
        tracks = tracker.close([other, last])
        assert tracks.num_instants == 3
        assert np.isfinite(tracks.backward[:, -2:]).all()
