"""Tracks from received corners: synthetic truth, hostile points, repeatability."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from decoder.tracking.matching import choose_paired_corners, match_points, strongest_nearby
from dvc.corners import corner_response
from dvc.tracks import FeaturePoints
from sfm.scene_model import Correspondences, Reconstruction

Floats = NDArray[np.float64]
WIDTH, HEIGHT = 352, 288
MOTION, ASIDE = np.array([4.0, 2.0]), np.array([1.0, 0.0])


class Clip(NamedTuple):
    """A group of pictures of which only points exist."""

    reconstruction: Reconstruction
    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    truth: Floats
    points: FeaturePoints


def dotted(points: Floats, shape: tuple[int, int] = (HEIGHT, WIDTH)) -> NDArray[np.uint8]:
    """Draw a luma plane with a round spot at each point."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    luma = np.full(shape, 60.0)
    for x, y in points:
        luma += 120.0 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 3.0)
    drawn: NDArray[np.uint8] = np.clip(np.rint(luma), 0, 255).astype(np.uint8)
    return drawn


@cache
def hand_held_clip(seed: int, num_frames: int = 9, jitter_px: float = 5.0, clutter: int = 60) -> Clip:
    """Move points of a scene with parallax before a shaking camera; detect two in three, among others."""
    rng = np.random.default_rng(seed)
    columns, rows = np.meshgrid(np.arange(24, WIDTH - 24, 20), np.arange(24, HEIGHT - 24, 20))
    first = np.column_stack([columns.ravel(), rows.ravel()]) + rng.uniform(-4, 4, (columns.size, 2))
    motion = np.array([14.0, -3.0]) * rng.uniform(0.4, 1.2, (len(first), 1))
    temporal_positions = np.linspace(0, 1, num_frames + 2)
    shake = np.cumsum(rng.uniform(-1, 1, (num_frames + 2, 2)) * jitter_px, axis=0)
    shake[[0, -1]] = 0
    turn = np.radians(rng.uniform(-1, 1, num_frames + 2))
    turn[[0, -1]] = 0
    centred = first - [WIDTH / 2, HEIGHT / 2]
    turned = turn[None, :, None] * np.column_stack([-centred[:, 1], centred[:, 0]])[:, None]
    truth = first[:, None] + temporal_positions[:, None] * motion[:, None] + shake + turned
    frames = []
    for k in range(1, num_frames + 1):
        seen = truth[rng.random(len(first)) < 0.65, k]
        seen = seen + rng.normal(0, 0.4, seen.shape)
        others = rng.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (clutter, 2))
        points = np.rint(np.concatenate([seen, others]))
        frames.append(points[np.logical_and(points >= 0, points < [WIDTH, HEIGHT]).all(axis=1)])
    matches = Correspondences(first, truth[:, -1], np.zeros(len(first)))
    reconstruction = Reconstruction(None, "not tried", "unknown", {"matching": matches})
    return Clip(reconstruction, dotted(first), dotted(truth[:, -1]), truth, FeaturePoints(tuple(frames)))


def track(clip: Clip, points: FeaturePoints | None = None) -> Floats:
    received = clip.points if points is None else points
    return match_points(clip.reconstruction, clip.first, clip.second, received).positions


def errors_px(clip: Clip, positions: Floats) -> Floats:
    """Return the distance of each known position between the keys from the truth."""
    start = np.abs(positions[:, None, 0] - clip.truth[None, :, 0]).sum(axis=2).argmin(axis=1)
    error: Floats = np.linalg.norm(positions - clip.truth[start], axis=2)[:, 1:-1]
    known: Floats = error[np.isfinite(error)]
    return known


@pytest.mark.parametrize("seed", range(4))
def test_a_shaking_camera_is_followed(seed: int) -> None:
    clip = hand_held_clip(seed)
    error = errors_px(clip, track(clip))
    assert len(error) > 0.4 * len(clip.truth) * 9
    assert np.median(error) < 0.5
    assert np.quantile(error, 0.95) < 1.2


def test_ends_are_correspondences() -> None:
    clip = hand_held_clip(5)
    positions = track(clip)
    ends = {(*a, *b) for a, b in zip(clip.truth[:, 0], clip.truth[:, -1], strict=True)}
    assert {(*a, *b) for a, b in zip(positions[:, 0], positions[:, -1], strict=True)} <= ends


def test_tracks_are_the_same_each_time() -> None:
    clip = hand_held_clip(6)
    np.testing.assert_array_equal(track(clip), track(clip))


def test_a_frame_without_points_has_no_positions() -> None:
    clip = hand_held_clip(7)
    frames = list(clip.points.frames)
    frames[4] = np.empty((0, 2))
    positions = track(clip, FeaturePoints(tuple(frames)))
    assert np.isnan(positions[:, 5]).all()
    assert np.median(errors_px(clip, positions)) < 0.5


def test_nothing_received_gives_no_tracks() -> None:
    clip = hand_held_clip(8)
    assert track(clip, FeaturePoints((np.empty((0, 2)),) * 9)).shape == (0, 11, 2)
    assert track(clip, FeaturePoints(())).shape == (0, 2, 2)


@given(
    frames=st.lists(
        st.lists(
            st.tuples(st.integers(0, WIDTH - 1), st.integers(0, HEIGHT - 1))
            | st.just((100, 100))
            | st.tuples(st.floats(), st.floats()),
            max_size=12,
        ),
        min_size=1,
        max_size=4,
    )
)
def test_any_points_give_tracks(frames: list[list[tuple[float, float]]]) -> None:
    clip = hand_held_clip(9, num_frames=2)
    points = FeaturePoints(tuple(np.array(frame, dtype=np.float64).reshape(-1, 2) for frame in frames))
    positions = track(clip, points)
    assert positions.shape[1:] == (len(frames) + 2, 2)
    assert np.isfinite(positions[:, [0, -1]]).all()


def test_few_correspondences_do_no_harm() -> None:
    clip = hand_held_clip(10)
    matches = clip.reconstruction.stages["matching"]
    for chosen in (np.arange(0), np.arange(1), np.arange(2), np.arange(5), np.arange(15)):
        few = Reconstruction(None, "", "none", {"matching": matches[chosen]})
        tracks = match_points(few, clip.first, clip.second, clip.points)
        assert len(tracks) <= len(chosen)
    assert len(match_points(Reconstruction(None, "", "none"), clip.first, clip.second, clip.points)) == 0


@pytest.mark.parametrize("seed", range(3))
def test_points_that_lie_anywhere_give_no_tracks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    anywhere = [np.rint(rng.uniform(0, [WIDTH - 1, HEIGHT - 1], (176, 2))) for _ in range(9)]
    assert len(track(hand_held_clip(11), FeaturePoints(tuple(anywhere)))) == 0


def test_peaks_of_a_parabola_are_exact() -> None:
    rows, columns = np.mgrid[:40, :50]
    centre = np.array([20.3, 15.8])
    response = 100.0 - (columns - centre[0]) ** 2 - 2.0 * (rows - centre[1]) ** 2
    peaks, strength = strongest_nearby(response, np.array([[21.0, 15.0], [19.4, 17.2]]), 2)
    np.testing.assert_allclose(peaks, [centre, centre], atol=1e-12)
    assert (strength > 99).all()


def test_a_slope_has_no_peak() -> None:
    response = np.add.outer(np.arange(30.0), np.arange(40.0)) + 1.0
    places = np.array([[20.0, 10.0], [39.0, 29.0], [-5.0, 90.0]])
    assert (strongest_nearby(response, places, 2)[1] == 0).all()
    assert strongest_nearby(response, np.empty((0, 2)), 2)[0].shape == (0, 2)


def test_the_peak_of_a_spot_is_found() -> None:
    place = np.array([[60.4, 40.7]])
    peaks, _ = strongest_nearby(corner_response(dotted(place, (96, 128)), np.ones(5)), np.rint(place), 2)
    np.testing.assert_allclose(peaks, place, atol=0.15)


def test_corners_are_followed_not_points() -> None:
    centres = np.array([[30.3, 30.6], [80.0, 40.2], [60.5, 70.0]])
    beside = np.concatenate([np.rint(centres), np.rint(centres) + ASIDE, [[15.0, 80.0]]])
    moved = beside + MOTION
    pairs = Correspondences(beside, moved, np.zeros(len(beside)))
    chosen = choose_paired_corners(
        pairs, dotted(centres, (96, 128)), dotted(centres + MOTION, (96, 128)), 10, 3.0
    )
    order = np.argsort(chosen.first[:, 0])
    np.testing.assert_allclose(chosen.first[order], centres[[0, 2, 1]], atol=0.15)
    np.testing.assert_allclose(chosen.second - chosen.first, np.tile(MOTION, (3, 1)), atol=0.1)
    middle = np.array([0.5])
    np.testing.assert_allclose(
        (chosen.corners(middle) - chosen.offsets(middle))[:, 0],
        0.5 * (chosen.pairs.first + chosen.pairs.second),
        atol=1e-9,
    )


def test_a_corner_that_wanders_is_no_pair() -> None:
    centre = np.array([[30.0, 30.0]])
    pairs = Correspondences(centre - ASIDE, centre + ASIDE, np.zeros(1))
    assert (
        len(choose_paired_corners(pairs, dotted(centre, (96, 128)), dotted(centre, (96, 128)), 10, 3.0)) == 0
    )
