"""Points followed through pictures."""

import cv2
import numpy as np
import pytest

from dvc.video import Frame
from sfm.mapping.sequence_tracks import evenly_spaced, track_sequence

SHAPE = (120, 160)


def _picture(shift: tuple[float, float], seed: int = 0) -> Frame:
    noise = np.random.default_rng(seed).uniform(0, 255, (SHAPE[0] + 80, SHAPE[1] + 80)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    smooth = (smooth - smooth.min()) / np.ptp(smooth) * 255
    matrix = np.array([[1.0, 0.0, shift[0] - 40], [0.0, 1.0, shift[1] - 40]])
    moved = cv2.warpAffine(smooth, matrix, SHAPE[::-1], flags=cv2.INTER_CUBIC)
    return Frame(np.clip(np.rint(moved), 0, 255).astype(np.uint8))


def test_shifts_are_followed_to_a_tenth_of_a_pixel() -> None:
    shifts = [(1.3 * k, -0.7 * k) for k in range(12)]
    tracks = track_sequence(_picture(shift) for shift in shifts)
    assert tracks.key_frames[0] == 0
    assert 3 <= len(tracks.key_frames) < 12
    first, last = tracks.seen[0], tracks.seen[-1]
    common, own, other = np.intersect1d(first.ids, last.ids, return_indices=True)
    assert len(common) > 40
    moved = last.positions[other] - first.positions[own]
    assert np.median(np.abs(moved - np.subtract(shifts[-1], shifts[0]))) < 0.1


def test_a_still_camera_makes_no_key_frames() -> None:
    tracks = track_sequence(_picture((0.0, 0.0)) for _ in range(6))
    assert tracks.key_frames == (0, 5)


def test_points_end_at_a_cut() -> None:
    tracks = track_sequence(
        [*(_picture((k, 0.0)) for k in range(3)), *(_picture((k, 0.0), 1) for k in range(3))]
    )
    assert len(np.intersect1d(tracks.seen[2].ids, tracks.seen[3].ids)) < 0.2 * len(tracks.seen[2].ids)
    assert len(tracks.seen[3].ids) > 50


def test_frames_without_corners_have_no_points() -> None:
    black = Frame(np.full(SHAPE, 16, np.uint8))
    tracks = track_sequence([black, black, _picture((0, 0)), black])
    assert [len(each.ids) > 0 for each in tracks.seen] == [False, False, True, False]
    noise = Frame(np.random.default_rng(0).integers(0, 256, (10, 64), np.uint8))
    assert [len(each.ids) for each in track_sequence([noise, noise]).seen] == [0, 0]
    assert track_sequence([]).seen == ()
    with pytest.raises(ValueError, match="one size"):
        track_sequence([_picture((0, 0)), noise])


def test_many_key_frames_are_thinned_evenly() -> None:
    assert evenly_spaced([], 5) == []
    assert evenly_spaced([4, 9, 11], 5) == [4, 9, 11]
    assert evenly_spaced(range(0, 26, 2), 5) == [0, 6, 12, 18, 24]
