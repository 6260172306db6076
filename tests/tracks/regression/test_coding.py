"""Coding of tracks by regression: its kernels, cost, and tracks of any motion."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.config import CodecConfig
from dvc.tracks import PointTracks, decode_tracks, encode_tracks
from dvc.tracks import _kernels as point_kernels
from dvc.tracks.regression import _kernels
from tests.reference import track_regression as reference
from tests.tracks.test_coding import config_of, drawn_tracks, rows_of


def scene_tracks(seed: int, count: int = 100, num_instants: int = 12) -> PointTracks:
    """Return tracks of points at several depths under a camera that moves unevenly."""
    rng = np.random.default_rng(seed)
    start = rng.integers(15, 55, (count, 1, 2)) * 4.0
    inverse_depth = rng.uniform(0.2, 1.0, (count, 1, 1))
    path = np.concatenate([[[0.0, 0.0]], np.cumsum(rng.normal(0.0, 1.0, (num_instants - 1, 2)), axis=0)])
    turn = np.concatenate([[0.0], np.cumsum(rng.normal(0.0, 0.002, num_instants - 1))])[None, :, None]
    centred = start - 140.0
    across = np.stack([-centred[..., 1], centred[..., 0]], axis=-1)
    return PointTracks(start + 3.0 * inverse_depth * path[None] + turn * across + path[None])


@pytest.mark.parametrize("seed", range(3))
def test_tracks_of_a_scene_cost_little(seed: int) -> None:
    """What a camera explains costs 32 bits for a track of twelve instants, first position included."""
    tracks = scene_tracks(seed)
    payload = encode_tracks(tracks, config_of(subpixel_bits=1))
    assert 8 * len(payload) < 32 * len(tracks)


def wild_tracks(seed: int, config: CodecConfig) -> PointTracks:
    """Return tracks that leap between the corners of the frame, of which some rest or go anywhere."""
    rng = np.random.default_rng(seed)
    count, num_instants = int(rng.integers(1, 24)), int(rng.choice([2, 5, 30, 120]))
    ends = np.array([config.video.width - 1, config.video.height - 1])
    positions = rng.integers(0, 2, (count, num_instants, 1 + seed % 2)) * ends.astype(np.float64)
    rests, strays = rng.random(count) < 0.2, rng.random(count) < 0.2 * (seed % 3)
    positions[rests, 1:] = positions[rests, :1]
    positions[strays] = np.round(rng.uniform(size=(int(strays.sum()), num_instants, 2)) * ends)
    return PointTracks(positions, int(rng.integers(0, count + 1)))


@pytest.mark.parametrize("size", [(3840, 2160), (640, 480), (16384, 1024), (4, 16384)])
def test_wild_tracks_come_back(size: tuple[int, int]) -> None:
    """Whatever the motion, legal tracks are coded, and none diverges."""
    for seed in range(250):
        config = config_of(*size, 24, seed % 4)
        tracks = wild_tracks(seed, config)
        decoded = decode_tracks(encode_tracks(tracks, config), tracks.num_instants, config)
        assert rows_of(decoded.forward) == rows_of(tracks.forward)
        assert rows_of(decoded.backward) == rows_of(tracks.backward)


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_motion_is_that_of_least_squares(seed: int, twin: bool) -> None:
    """Drawn to one position after the other, coefficients become those of all at once."""
    choose = python_twin if twin else (lambda kernel: kernel)
    rng = np.random.default_rng(seed)
    features, errors = rng.normal(size=(30, 10)), rng.normal(0.0, 0.3, (30, 2))
    prior, noise = rng.uniform(0.5, 2.0, 10), 5.0
    instant = _kernels.new_instant(30)
    covariance = instant.covariance.reshape(10, _kernels.STRIDE)
    instant.features[:] = features
    covariance[:, :10] = np.diag(prior)
    for i, (row, wanted) in enumerate(zip(features, errors, strict=True)):
        variance = choose(_kernels.set_gain)(instant, i)
        np.testing.assert_allclose(instant.gain[:10], covariance[:, :10] @ row, atol=1e-12)
        rest = wanted - row @ instant.coefficients
        choose(_kernels.learn_motion)(instant, *rest, variance, noise)
    expected, spread = reference.regularised_least_squares(features, errors, prior, noise)
    np.testing.assert_allclose(instant.coefficients, expected, atol=1e-10)
    np.testing.assert_allclose(covariance[:, :10], spread, atol=1e-10)
    assert np.array_equal(covariance[:, :10], covariance[:, :10].T)
    assert not covariance[:, 10:].any()


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_neighbours_are_the_nearest(seed: int, twin: bool) -> None:
    """Neighbours of a track are the nearest of those before it, the first of equals first."""
    nearest_before = python_twin(_kernels.nearest_before) if twin else _kernels.nearest_before
    first = np.random.default_rng(seed).integers(0, 12, (40, 2)).astype(np.float64)
    neighbours, weights = np.empty((40, 8), np.int64), np.zeros((40, 8))
    nearest_before(first, 30.0, neighbours, weights)
    for i in range(40):
        expected = reference.nearest_before(first, i, 30.0)
        count = len(expected)
        assert neighbours[i, :count].tolist() == [j for j, _ in expected]
        assert (neighbours[i, count:] == -1).all()
        np.testing.assert_allclose(weights[i, :count], [weight for _, weight in expected])


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 8, 77])
def test_first_tracks_are_far_apart(count: int, twin: bool) -> None:
    """Tracks are in the order of their numbers with binary digits reversed."""
    spread_order = python_twin(point_kernels.spread_order) if twin else point_kernels.spread_order
    assert spread_order(count).tolist() == reference.spread_order(count)


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_cells_near_given_tracks_are_not_free(seed: int, twin: bool) -> None:
    """Cells are taken whose corner is nearer than so many cells to a given position, and no others."""
    choose = python_twin if twin else (lambda kernel: kernel)
    rng = np.random.default_rng(seed)
    exponent, guard = int(rng.integers(0, 4)), int(rng.integers(0, 7))
    shape = (21, 17)
    taken = rng.integers(0, [shape[0] << exponent, shape[1] << exponent], (5, 2))
    points = rng.integers(0, 100, (6, 2))
    free = np.ones(shape, np.bool_)
    choose(point_kernels.take_guarded)(free, taken, guard, exponent)
    assert np.array_equal(free, reference.unguarded_cells(shape, taken, guard << exponent, 1 << exponent))
    square = ((points[:, None] - taken) ** 2).sum(axis=-1).min()
    assert choose(point_kernels.min_square)(points, taken) == square
    assert choose(point_kernels.min_square)(points, taken[:0]) == 0


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("reach", [0, 2, 7])
def test_points_are_counted_in_cells_around_them(reach: int, twin: bool) -> None:
    """Cells after a point in the scan know how many points are within reach, up to three."""
    count_near = python_twin(point_kernels.count_near) if twin else point_kernels.count_near
    rng = np.random.default_rng(reach)
    points = sorted((int(x), int(y)) for x, y in rng.integers(0, [20, 15], (12, 2)))
    near = np.zeros((20, 15), np.uint8)
    for k, (x, y) in enumerate(points):
        count_near(near, x, y, reach, 3)
        for later in range(15 * x + y + 1, 300):
            cell = divmod(later, 15)
            assert near[cell] == min(reference.num_within(points[: k + 1], cell, reach), 3)


def test_motion_of_lost_tracks_is_not_followed() -> None:
    """Tracks of which most are lost at once come back as such."""
    config = config_of()
    tracks = drawn_tracks(5, config, 60, 9, 0.3)
    positions = tracks.positions.copy()
    positions[5:, 4:] = np.nan
    decoded = decode_tracks(encode_tracks(PointTracks(positions), config), 9, config)
    assert rows_of(decoded.positions) == rows_of(positions)
