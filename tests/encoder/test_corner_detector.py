"""Corners: inside, apart, on their grid, where edges meet."""

import numpy as np
import pytest

from encoder.corner_detector import TRACKED_CORNERS, CornerDetector, CornerSettings, _strongest, find_corners
from tests.clips import moving_texture, odd_frames

STILL_LIFE = moving_texture(1, 120, 160)[0].luma


@pytest.mark.parametrize("settings", [CornerSettings(), TRACKED_CORNERS, CornerSettings(grid_px=2)])
@pytest.mark.parametrize("name", odd_frames())
def test_corners_keep_inside_and_apart(name: str, settings: CornerSettings) -> None:
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
    luma = np.full((64, 64), 50, np.uint8)
    luma[20:44, 16:40] = 200
    corners = find_corners(luma, 10, 3)
    expected = np.array([(x, y) for x in (15.5, 39.5) for y in (19.5, 43.5)])
    distances = np.hypot(*(corners[:, None] - expected[None]).transpose(2, 0, 1))
    assert len(corners) == 4
    assert distances.min(axis=0).max() < 2.5


def test_detector_counts_and_scans_columns() -> None:
    detector = CornerDetector(30)
    points = detector.detect([STILL_LIFE, STILL_LIFE[:, ::-1]])
    assert [len(frame) for frame in points.frames] == [30, 30]
    assert all((np.diff(frame[:, 0]) >= 0).all() for frame in points.frames)
    assert detector.work.num_corners == 60


@pytest.mark.parametrize("most", [1, 7, 60, 500])
def test_strongest_responses_come_first(most: int) -> None:
    response = np.random.default_rng(most).integers(0, 9, (20, 30)).astype(np.float32) / 8
    worthy = response > 0.3
    places = np.flatnonzero(worthy)
    expected = places[np.argsort(-response.ravel()[places], kind="stable")][:most]
    assert _strongest(response, worthy, most).tolist() == expected.tolist()
