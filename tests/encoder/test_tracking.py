"""Tracks of points: known motion, losses, operations, odd frames."""

import numpy as np
import pytest

from dvc.video import Frame
from encoder.point_tracker import PointTracker, PointTrackerSettings
from tests.clips import moving_texture, odd_frames

FULL_SEARCH_BLOCKS = 961  # of +-15 px, for each 8x8 block


def followed(
    frames: list[Frame], settings: PointTrackerSettings | None = None, subpixel_bits: int = 0
) -> PointTracker:
    tracker = PointTracker(40, subpixel_bits, settings)
    tracker.start(frames[0].luma)
    for frame in frames[1:]:
        tracker.step(frame.luma)
    return tracker


@pytest.mark.parametrize("motion_px", [(0.0, 0.0), (3.0, -2.0), (1.0, 4.0)])
@pytest.mark.parametrize("subpixel_bits", [0, 2])
def test_known_motion_is_followed(motion_px: tuple[float, float], subpixel_bits: int) -> None:
    frames = moving_texture(6, 120, 160, motion_px)
    tracker = followed(frames, None, subpixel_bits)
    tracks = tracker.tracks(6).positions
    assert len(tracks) >= 15
    motion = tracks[:, 1:] - tracks[:, :1]
    expected = np.arange(1, 6)[:, None] * motion_px[::-1]
    assert np.nanmax(np.abs(motion - expected)) <= (0.25 if subpixel_bits else 0.0)
    assert tracker.longest_px == pytest.approx(5 * np.hypot(*motion_px))


def test_parts_of_a_pixel_are_found() -> None:
    frames = moving_texture(4, 120, 160, (0.3, 1.4))
    errors = []
    for bits in (0, 2):
        tracks = followed(frames, None, bits).tracks(4).positions
        expected = tracks[:, :1] + np.arange(4)[:, None] * (1.4, 0.3)
        errors.append(np.nanmean(np.hypot(*(tracks - expected)[:, 1:].transpose(2, 0, 1))))
        assert np.array_equal(tracks * 2**bits, np.round(tracks * 2**bits), equal_nan=True)
    assert errors[1] < 0.6 * errors[0]


def test_fast_motion_is_reached() -> None:
    """A jump far beyond the spiral is found by the coarse-to-fine search, within the operations allowed."""
    frames = moving_texture(20, 120, 240, (0.5, 3.0))
    tracker = followed([frames[0], frames[12]])
    motion = tracker.tracks(2).positions
    assert len(motion) >= 10
    assert np.nanmedian((motion[:, 1] - motion[:, 0])[:, 0]) == 36
    num_full = (120 // 8) * (240 // 8) * FULL_SEARCH_BLOCKS
    assert tracker.work.num_blocks <= 0.08 * num_full


def test_operations_stay_small() -> None:
    frames = moving_texture(6, 120, 160, (1.0, 2.0))
    counts = followed(frames).work
    assert counts.num_corners == 40
    assert counts.num_frames == 5
    assert counts.num_blocks < 5 * 40 * 60
    assert counts.num_samples <= counts.num_blocks * 121


def test_points_are_lost_for_good() -> None:
    frames = moving_texture(3, 120, 160)
    tracker = followed(frames[:2])
    assert tracker.last_lost_share < 0.3
    tracker.step(np.ascontiguousarray(moving_texture(1, 120, 160, seed=9)[0].luma))
    assert tracker.last_lost_share > 0.8
    lost = tracker.lost_share
    tracker.step(frames[2].luma)
    assert tracker.lost_share >= lost
    tracks = tracker.tracks(4).positions
    known = np.isfinite(tracks[:, :, 0])
    assert not (known[:, 1:] & ~known[:, :-1]).any()


def test_same_tracks_for_any_number_of_threads() -> None:
    import cv2

    frames: list[Frame] = moving_texture(3, 120, 160)
    found = []
    before = cv2.getNumThreads()
    for threads in (1, 4):
        cv2.setNumThreads(threads)
        found.append(followed(frames[:2], None, 2).tracks(2).positions)
    cv2.setNumThreads(before)
    assert np.array_equal(*found, equal_nan=True)


@pytest.mark.parametrize("motion_px", [(0.0, 6.0), (-4.0, 3.0)])
def test_points_that_appear_are_followed_back(motion_px: tuple[float, float]) -> None:
    frames = moving_texture(7, 120, 160, motion_px)
    tracker = followed(frames)
    tracks = tracker.close([frame.luma for frame in frames[1:]])
    new_tracks = tracks.backward
    assert tracks.num_backward == len(new_tracks) >= 4
    known = np.isfinite(new_tracks[:, :, 0])
    assert known[:, -3:].all()
    assert not (known[:, :-1] & ~known[:, 1:]).any()
    assert not known[:, 0].all()
    motion = new_tracks[:, 1:] - new_tracks[:, :-1]
    assert np.nanmax(np.abs(motion - motion_px[::-1])) == 0.0


def test_new_tracks_are_where_no_track_is() -> None:
    """Points followed back keep away from all tracks that reach the key frame, and from each other."""
    frames = moving_texture(7, 120, 160, (0.0, 6.0))
    settings = PointTrackerSettings(new_track_distance_px=20.0, max_new_tracks=5)
    tracks = followed(frames, settings).close([frame.luma for frame in frames[1:]])
    assert 0 < tracks.num_backward <= 5
    ends = tracks.forward[:, -1]
    distances = np.hypot(*(tracks.backward[:, None, -1] - ends[np.isfinite(ends[:, 0])]).transpose(2, 0, 1))
    assert distances.min() >= 20.0
    none = followed(frames, PointTrackerSettings(max_new_tracks=0)).close(
        [frame.luma for frame in frames[1:]]
    )
    assert none.num_backward == 0
    assert np.array_equal(none.positions, tracks.forward, equal_nan=True)


def test_new_tracks_need_frames_between_the_key_frames() -> None:
    frames = moving_texture(3, 120, 160, (0.0, 9.0))
    for num_frames, expected in ((2, False), (1, True)):
        settings = PointTrackerSettings(min_new_track_frames=num_frames)
        tracks = followed(frames, settings).close([frame.luma for frame in frames[1:]])
        assert (tracks.num_backward > 0) == expected


def test_nothing_appears_at_rest() -> None:
    frames = moving_texture(1, 120, 160) * 4
    tracks = followed(frames).close([frame.luma for frame in frames[1:]])
    assert len(tracks) > 20
    assert tracks.num_backward == 0


def test_closing_starts_the_next_group() -> None:
    frames = moving_texture(9, 120, 160, (0.0, 6.0))
    tracker = followed(frames[:7])
    before = tracker.work.num_blocks
    tracker.close([frame.luma for frame in frames[1:7]])
    assert tracker.work.num_blocks > before
    assert tracker.work.num_corners == 80
    fresh = followed(frames[6:])
    for frame in frames[7:]:
        tracker.step(frame.luma)
    assert np.array_equal(tracker.tracks(3).positions, fresh.tracks(3).positions, equal_nan=True)


@pytest.mark.parametrize("name", odd_frames())
def test_odd_frames_close_a_group(name: str) -> None:
    """Flat, tiny and noisy frames make tracks or none, and end groups, without a warning."""
    luma = np.ascontiguousarray(odd_frames()[name])
    other = np.ascontiguousarray(luma[::-1])
    tracker = followed([Frame(luma), Frame(luma), Frame(other)], subpixel_bits=1)
    assert tracker.longest_px >= 0
    assert 0 <= tracker.lost_share <= 1
    assert len(tracker.tracks(3)) == 0 or name not in ("black", "white", "1x1")
    for last in (luma, other, np.zeros_like(luma)):
        tracker = followed([Frame(luma), Frame(other), Frame(last)])
        tracks = tracker.close([other, last])
        assert tracks.num_instants == 3
        assert np.isfinite(tracks.backward[:, -2:]).all()


def test_points_lost_at_an_instant_are_told_later() -> None:
    first, *others = moving_texture(6, 64, 96, (0.0, 6.0))
    tracker, lost = PointTracker(30), []
    tracker.start(first.luma)
    for frame in others:
        tracker.step(frame.luma)
        lost.append(tracker.lost_share)
    assert lost[-1] > lost[0]
    known = np.isfinite(tracker.path(6)[:, 1:, 0])
    assert 1.0 - known.mean(axis=0) == pytest.approx(lost)
