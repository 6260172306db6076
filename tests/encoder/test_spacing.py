"""How far apart key frames lie where nothing is sent of other frames."""

from math import isqrt, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.keyframes import KeyPicture
from encoder import _kernels
from encoder.encoder_report import TrackingWork
from encoder.point_tracker import PointTracker
from encoder.spacing import (
    ALONE_COST,
    CLOSE_SHARE,
    MANY_BLOCKS,
    SHORT_COST,
    SPACING_PX,
    Spacing,
    interpolation_error,
)
from tests.clips import moving_texture
from tests.reference import interpolation as reference
from tests.twins import Choose

COSTS = {2: ALONE_COST, 4: SHORT_COST}


@pytest.mark.nojit
@pytest.mark.parametrize(("height", "width"), [(8, 8), (24, 31), (45, 40), (7, 60), (3, 2)])
@pytest.mark.parametrize("num_points", [0, 1, 2, 5, 20])
def test_error_is_that_of_its_twin(choose: Choose, height: int, width: int, num_points: int) -> None:
    """On noise, moved anywhere, beyond the borders too; frames without a whole block have none."""
    rng = np.random.default_rng(height + num_points)
    frame, before, after = rng.integers(0, 256, (3, height, width)).astype(np.uint8)
    positions = rng.uniform(-9.0, 60.0, (num_points, 3, 2))
    for spacing in (8, 16, 21):
        error, count = choose(_kernels.interpolation_error)(frame, before, after, positions, spacing)
        expected, num_blocks = reference.error(frame, (before, after), positions, spacing)
        assert (error, count) == (pytest.approx(expected), num_blocks)


@given(st.integers(-4, 4), st.integers(-4, 4), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_what_tracks_follow_has_no_error(dx: int, dy: int, num_points: int, seed: int) -> None:
    """A picture that is shifted as all points are is predicted exactly; without points it is not."""
    rng, work = np.random.default_rng(seed), TrackingWork()
    whole = np.full((90, 110), 128, np.uint8)
    whole[20:70, 20:90] = rng.integers(0, 256, (50, 70))
    before, frame, after = (whole[8 + k * dy :, 8 + k * dx :][:72, :92].copy() for k in (1, 0, -1))
    positions = np.repeat(rng.uniform(0, (91, 71), (num_points, 1, 2)), 3, axis=1)
    positions[:, 1] -= (dx, dy)
    positions[:, 2] += (dx, dy)
    assert interpolation_error(frame, (before, after), positions, work) < 1e-20
    still = interpolation_error(frame, (before, after), positions[:0], work)
    assert (still > 1.0) == bool(dx or dy)


@pytest.mark.parametrize("size", [(0, 0), (8, 8), (72, 92), (720, 1280)])
def test_work_is_counted(size: tuple[int, int]) -> None:
    frame, work = np.zeros(size, np.uint8), TrackingWork()
    interpolation_error(frame, (frame, frame), np.zeros((5, 3, 2)), work)
    spacing = max(SPACING_PX, isqrt(frame.size // MANY_BLOCKS))
    places = [len(range(0, side - 7, spacing)) for side in size]
    assert work.num_interpolated == places[0] * places[1] <= 1.2 * MANY_BLOCKS
    assert work.num_near == 5 * work.num_interpolated


def tracker_of(frames: list[np.ndarray]) -> PointTracker:
    tracker = PointTracker(30)
    tracker.start(frames[0])
    for frame in frames[1:]:
        tracker.step(frame)
    return tracker


def clip_with(num_frames: int, changed: int) -> tuple[list[np.ndarray], PointTracker]:
    """Return frames of which one does not fit between the others, and tracks of them."""
    frames = [frame.luma.copy() for frame in moving_texture(num_frames, 64, 96, (0.0, 1.0))]
    frames[changed][::2] ^= 8
    return frames, tracker_of(frames)


def error_of(frames: list[np.ndarray], tracker: PointTracker) -> float:
    """Return the error of the middle frame, by the twin."""
    last = len(frames) - 1
    positions = tracker.path(last + 1)[:, (last // 2, 0, last)]
    positions = positions[np.isfinite(positions).all(axis=(1, 2))]
    assert len(positions) > 3
    return reference.error(frames[last // 2], (frames[0], frames[last]), positions, SPACING_PX)[0]


@pytest.mark.parametrize("last", [2, 4])
def test_key_frames_lie_close_where_prediction_costs_more(last: int) -> None:
    """Just above what a key frame costs, and not just below it; nothing is decided of other lengths."""
    frames, tracker = clip_with(last + 1, last // 2)
    bits = error_of(frames, tracker) * frames[0].size / COSTS[last] / 1.25**2
    for share, is_too_far in ((0.99, True), (1.01, False)):
        spacing = Spacing(TrackingWork())
        spacing.update(KeyPicture(bytes(round(share * bits / 8)), True), 6, 2)
        assert spacing.is_too_far(frames, tracker) is is_too_far
        assert not spacing.is_too_far(frames[:-1], tracker)


@pytest.mark.parametrize("last", [2, 4])
def test_nothing_is_too_far_without_an_error(last: int) -> None:
    """Even where key frames cost nothing; without a point, frames are compared as they are."""
    frames = [np.full((64, 96), 77, np.uint8)] * (last + 1)
    tracker, spacing = tracker_of(frames), Spacing(TrackingWork())
    assert tracker.path(last + 1).shape == (0, last + 1, 2)
    assert not spacing.is_too_far(frames, tracker)
    frames[last // 2] = frames[0] + 1
    assert spacing.is_too_far(frames, tracker)
    tiny = list(np.random.default_rng(0).integers(0, 256, (3, 7, 5)).astype(np.uint8))
    assert not spacing.is_too_far(tiny, tracker_of(tiny))  # none of their blocks is compared


@pytest.mark.parametrize(
    ("predicted", "distance", "share"),
    [
        (True, 2, 1.0),
        (True, 1, sqrt(2.0)),
        (True, 8, 0.5),
        (False, 1, CLOSE_SHARE),
        (False, 8, CLOSE_SHARE),
        (False, 0, 1.0),
    ],
)
def test_cost_is_that_of_a_key_frame_two_frames_on(predicted: bool, distance: int, share: float) -> None:
    """By what the last one took and from where it was predicted; intra pictures cost the same everywhere.

    Steps of H.264 double every six QPs: 10 at 24.
    """
    spacing = Spacing(TrackingWork())
    for qp, step in ((24, 10.0), (12, 2.5)):
        spacing.update(KeyPicture(bytes(100), predicted), qp, distance)
        assert spacing._cost == pytest.approx(step**2 * 800 * share)
