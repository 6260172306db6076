"""Coding of tracks by regression: exact inverse, cost, damaged and hostile payloads."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc._jit import python_twin
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.tracks import PointTracks, decode_tracks, encode_tracks
from dvc.tracks.regression import _kernels
from tests.reference import track_regression as reference
from tests.tracks.test_coding import config_of, drawn_tracks, rows_of, with_births


def regression_config(
    width: int = 352, height: int = 288, num_points: int = 128, subpixel_bits: int = 0
) -> CodecConfig:
    config = config_of(width, height, num_points, subpixel_bits)
    return replace(config, tracks=replace(config.tracks, coding="regression"))


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


@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(0, 60), st.integers(0, 60)),
    st.integers(2, 12),
    st.sampled_from([0.0, 0.3, 3.0, 90.0]),
    st.sampled_from([(352, 288), (16, 16), (1, 1), (33, 7), (16384, 1024)]),
    st.integers(0, 3),
)
@settings(max_examples=80)
def test_tracks_come_back(
    seed: int, counts: tuple[int, int], num_instants: int, spread: float, size: tuple[int, int], bits: int
) -> None:
    """Positions, births and losses are the same after decoding."""
    config = regression_config(*size, subpixel_bits=bits)
    tracks = with_births(seed, config, counts, num_instants, spread)
    decoded = decode_tracks(encode_tracks(tracks, config), num_instants, config)
    assert decoded.num_backward == tracks.num_backward
    assert rows_of(decoded.forward) == rows_of(tracks.forward)
    assert rows_of(decoded.backward) == rows_of(tracks.backward)


@pytest.mark.parametrize("seed", range(3))
def test_tracks_of_a_scene_cost_less(seed: int) -> None:
    """What a camera explains costs less than two thirds of what the filter needs for it."""
    tracks = scene_tracks(seed)
    config = regression_config(subpixel_bits=1)
    plain = replace(config, tracks=replace(config.tracks, coding="filter"))
    assert len(encode_tracks(tracks, config)) < 0.66 * len(encode_tracks(tracks, plain))


@given(st.binary(min_size=1, max_size=60), st.integers(2, 20), st.sampled_from([1, 7, 128, 1024]))
@settings(max_examples=150)
def test_any_bytes_are_tracks_or_refused(data: bytes, num_instants: int, num_points: int) -> None:
    """Arbitrary bytes decode to tracks that code to the same bytes, or are damaged."""
    config = regression_config(num_points=num_points)
    try:
        tracks = decode_tracks(data, num_instants, config)
    except BitstreamError:
        return
    assert encode_tracks(tracks, config) == data


@given(st.integers(0, 2**16), st.integers(1, 255), st.booleans())
@settings(max_examples=100)
def test_damaged_payloads_never_pass_for_the_original(place: int, change: int, cut: bool) -> None:
    """A changed or cut payload is refused, or makes tracks inside the frame that code to just these bytes."""
    config = regression_config(64, 48, 20)
    payload = encode_tracks(with_births(1, config, (20, 12), 6, 0.5), config)
    place %= len(payload)
    damaged = payload[:place] if cut else bytes(c ^ change * (i == place) for i, c in enumerate(payload))
    try:
        tracks = decode_tracks(damaged, 6, config)
    except BitstreamError:
        return
    assert encode_tracks(tracks, config) == damaged
    known = tracks.positions[np.isfinite(tracks.positions[..., 0])]
    assert (known >= 0).all()
    assert (known <= (63, 47)).all()


@pytest.mark.parametrize("trailer", [b"\0", b"\1", b"trailing"])
def test_trailing_bytes_are_refused(trailer: bytes) -> None:
    """A payload ends where its tracks do."""
    config = regression_config(64, 48, 20)
    for counts in ((20, 0), (20, 12), (0, 12)):
        payload = encode_tracks(with_births(1, config, counts, 6, 0.5), config)
        with pytest.raises(BitstreamError):
            decode_tracks(payload + trailer, 6, config)


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
        config = regression_config(*size, 24, seed % 4)
        tracks = wild_tracks(seed, config)
        decoded = decode_tracks(encode_tracks(tracks, config), tracks.num_instants, config)
        assert rows_of(decoded.forward) == rows_of(tracks.forward)
        assert rows_of(decoded.backward) == rows_of(tracks.backward)


@pytest.mark.nojit
def test_payload_is_frozen() -> None:
    """The bytes of a small set of tracks stay what they are, with and without compiled kernels."""
    positions = [
        [[8, 4], [9, 5], [11, 5]],
        [[20, 12], [21, 13], [np.nan, np.nan]],
        [[4, 16], [5, 16], [6, 17]],
        [[np.nan, np.nan], [26, 4], [28, 4]],
        [[13, 19], [14, 20], [16, 20]],
    ]
    payload = encode_tracks(PointTracks(np.array(positions, np.float64), 2), regression_config(32, 24, 8))
    assert payload.hex() == FROZEN


FROZEN = "5c72f65b81a564b5cfd3f14375f9ba"


@pytest.mark.parametrize(
    ("size", "bits", "counts", "num_instants", "spread", "frozen"),
    [
        ((352, 288), 1, (128, 48), 11, 0.3, "a22c3af61f35e9b35f98fd00f8a7ceac"),
        ((352, 288), 0, (60, 0), 4, 3.0, "0c3080157008d5eacd8197e41b9583f3"),
        ((33, 7), 3, (0, 40), 9, 0.5, "8b98c5197145c44d616a9b8748f0a1cb"),
        ((16384, 1024), 2, (40, 40), 5, 90.0, "6535deac24d8d5869eb646e09b0122de"),
    ],
)
def test_payloads_are_frozen(
    size: tuple[int, int], bits: int, counts: tuple[int, int], num_instants: int, spread: float, frozen: str
) -> None:
    """The bytes of many tracks stay what they are."""
    config = regression_config(*size, subpixel_bits=bits)
    payload = encode_tracks(with_births(7, config, counts, num_instants, spread), config)
    assert hashlib.sha256(payload).hexdigest()[:32] == frozen


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
    spread_order = python_twin(_kernels.spread_order) if twin else _kernels.spread_order
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
    choose(_kernels.take_guarded)(free, taken, guard, exponent)
    assert np.array_equal(free, reference.unguarded_cells(shape, taken, guard << exponent, 1 << exponent))
    square = ((points[:, None] - taken) ** 2).sum(axis=-1).min()
    assert choose(_kernels.min_square)(points, taken) == square
    assert choose(_kernels.min_square)(points, taken[:0]) == 0


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("reach", [0, 2, 7])
def test_points_are_counted_in_cells_around_them(reach: int, twin: bool) -> None:
    """Cells after a point in the scan know how many points are within reach, up to three."""
    count_near = python_twin(_kernels.count_near) if twin else _kernels.count_near
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
    config = regression_config()
    tracks = drawn_tracks(5, config, 60, 9, 0.3)
    positions = tracks.positions.copy()
    positions[5:, 4:] = np.nan
    decoded = decode_tracks(encode_tracks(PointTracks(positions), config), 9, config)
    assert rows_of(decoded.positions) == rows_of(positions)
