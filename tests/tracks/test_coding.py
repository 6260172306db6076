"""Coding of tracks and points: exact inverse, cost, damaged and hostile payloads."""

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.config import CodecConfig, TracksConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.tracks import (
    FeaturePoints,
    PointTracks,
    _kernels,
    decode_points,
    decode_tracks,
    encode_points,
)
from dvc.tracks import encode_tracks as encode
from dvc.tracks.coding import column_scan
from dvc.tracks.regression import _kernels as motion_kernels
from tests.reference import point_sets as reference
from tests.reference import track_regression as motion_reference
from tests.twins import Choose


def config_of(
    width: int = 352, height: int = 288, num_points: int = 128, subpixel_bits: int = 0, kind: str = "encoder"
) -> CodecConfig:
    tracks = TracksConfig(kind, num_points, subpixel_bits)
    return codec_config(VideoConfig(width, height, 25, 1), tracks=tracks)


def drawn_tracks(seed: int, config: CodecConfig, count: int, num_instants: int, spread: float) -> PointTracks:
    """Return tracks under a common motion and their own; some are lost on the way, or at the border."""
    rng = np.random.default_rng(seed)
    sides = np.array([config.video.width, config.video.height]) - 1
    scale = 2**config.tracks.subpixel_bits
    start = np.round(rng.uniform(size=(count, 1, 2)) * sides)
    steps = (
        rng.normal(size=(1, num_instants - 1, 2)) * 4 + rng.normal(size=(count, num_instants - 1, 2)) * spread
    )
    positions = np.concatenate([start, start + np.cumsum(steps, axis=1)], axis=1)
    positions = np.round(positions * scale) / scale
    inside = ((positions >= 0) & (positions <= sides)).all(axis=-1)
    known = np.logical_and.accumulate(inside & (rng.random(inside.shape) > 0.02), axis=1)
    known[:, 0] = True
    positions[~known] = np.nan
    return PointTracks(positions)


def with_births(
    seed: int, config: CodecConfig, counts: tuple[int, int], num_instants: int, spread: float
) -> PointTracks:
    """Return tracks in both directions of time."""
    forward, backward = (drawn_tracks(seed + k, config, counts[k], num_instants, spread) for k in range(2))
    return PointTracks(np.concatenate([forward.positions, backward.positions[:, ::-1]]), counts[1])


def in_order(tracks: PointTracks) -> NDArray[np.float64]:
    return tracks.positions[column_scan(tracks.positions[:, 0])]


def rows_of(positions: NDArray[np.float64]) -> list[tuple[float, ...]]:
    """Return the tracks in an order that does not depend on the one they had."""
    return sorted(
        map(tuple, np.nan_to_num(positions, nan=-1.0).reshape(len(positions), 2 * positions.shape[1]))
    )


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
    """Positions, births and losses are the same after decoding, each direction in column scan of its key."""
    config = config_of(*size, subpixel_bits=bits)
    tracks = with_births(seed, config, counts, num_instants, spread)
    decoded = decode_tracks(encode(tracks, config), num_instants, config)
    assert decoded.num_backward == tracks.num_backward
    assert rows_of(decoded.forward) == rows_of(tracks.forward)
    assert rows_of(decoded.backward) == rows_of(tracks.backward)
    for starts in (decoded.forward[:, 0], decoded.backward[:, -1]):
        assert np.array_equal(starts, starts[column_scan(starts)])


@pytest.mark.parametrize("seed", range(3))
def test_time_can_be_reversed(seed: int) -> None:
    config = config_of(64, 48, 20, 1)
    tracks = drawn_tracks(seed, config, 20, 6, 0.5)
    there = decode_tracks(encode(tracks, config), 6, config)
    back = decode_tracks(encode(PointTracks(tracks.positions[:, ::-1], 20), config), 6, config)
    assert np.array_equal(back.positions[:, ::-1], there.positions, equal_nan=True)


def test_tracks_tell_the_motion_of_births() -> None:
    """Points that appear are cheap where tracks share their motion, however irregular it is."""
    config = config_of(num_points=64)
    rng = np.random.default_rng(3)
    start = np.stack(np.meshgrid(np.arange(40, 300, 32), np.arange(40, 220, 32)), -1).reshape(-1, 1, 2)
    moved = rng.integers(-9, 10, (30, 2))
    forward, backward = (start + moved).astype(np.float64), (start + 16 + moved).astype(np.float64)
    sizes = [
        len(encode(PointTracks(positions, count), config))
        for positions, count in (
            (forward, 0),
            (backward, len(backward)),
            (np.concatenate([forward, backward]), len(backward)),
        )
    ]
    assert sizes[2] < sizes[0] + 0.85 * sizes[1]


def test_no_tracks_cost_nothing() -> None:
    config = config_of()
    assert encode(PointTracks.none(5), config) == b""
    assert decode_tracks(b"", 5, config).positions.shape == (0, 5, 2)
    empty = FeaturePoints((np.empty((0, 2)), np.empty((0, 2))))
    assert encode_points(empty, config) == b""
    assert [frame.shape for frame in decode_points(b"", 2, config).frames] == [(0, 2), (0, 2)]


@pytest.mark.parametrize("full", [True, False])
def test_most_tracks_come_back(full: bool) -> None:
    config = config_of(num_points=1024 if full else 1)
    most = config.tracks.num_points
    tracks = drawn_tracks(5, config, most, 8, 1.0)
    decoded = decode_tracks(encode(tracks, config), 8, config)
    assert np.array_equal(decoded.positions, in_order(tracks), equal_nan=True)
    both = with_births(5, config, (most, most), 3, 1.0)
    decoded = decode_tracks(encode(both, config), 3, config)
    assert rows_of(decoded.positions) == rows_of(both.positions)


def test_smooth_tracks_are_cheap() -> None:
    """A common motion is paid for once: less than a bit a point and frame, and start positions."""
    config = config_of()
    rng = np.random.default_rng(3)
    start = rng.permutation(
        np.stack(np.meshgrid(np.arange(40, 300, 20), np.arange(40, 220, 20)), -1).reshape(-1, 2)
    )
    steps = np.cumsum(rng.integers(-3, 4, (1, 9, 2)), axis=1)
    positions = np.concatenate([start[:, None], start[:, None] + steps], axis=1).astype(np.float64)
    assert 8 * len(encode(PointTracks(positions), config)) < len(start) * (9 + 6)


@pytest.mark.parametrize(
    ("positions", "num_backward", "message"),
    [
        ([[[0, 0], [1, 1]], [[0, 9], [1, 1]], [[8, 0], [1, 1]]], 0, "at most 2"),
        ([[[0, 0], [1, 1]], [[0, 9], [1, 1]], [[8, 0], [1, 1]]], 3, "at most 2"),
        ([[[0, 0], [352, 1]]], 0, "inside the frame"),
        ([[[0, 0], [352, 1]]], 1, "inside the frame"),
        ([[[-1, 0], [1, 1]]], 0, "inside the frame"),
        ([[[1e300, 0], [1, 1]]], 0, "inside the frame"),
        ([[[np.nan, 0], [1, 1]]], 0, "known in the first key frame"),
        ([[[0, 0], [1, 1]], [[0, 0], [np.nan, 1]]], 1, "known in the last key frame"),
        ([[[0, 0], [np.nan, 0], [1, 1]]], 0, "come back"),
        ([[[1, 1], [np.nan, 0], [0, 0]]], 1, "come back"),
        ([[[0, 0], [1, 1]]], -1, "num_backward"),
        ([[[0, 0], [1, 1]]], 2, "num_backward"),
    ],
)
def test_tracks_that_make_no_sense_are_refused(
    positions: list[object], num_backward: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        encode(PointTracks(np.array(positions, np.float64), num_backward), config_of(num_points=2))


@given(
    st.lists(st.lists(st.tuples(st.integers(0, 63), st.integers(0, 47)), max_size=30), max_size=5),
    st.integers(0, 3),
)
def test_points_come_back(frames: list[list[tuple[int, int]]], bits: int) -> None:
    """Points of each frame are the same after decoding, in column scan, twins included."""
    config = config_of(64, 48, 30, bits, "decoder")
    sets = [np.array(frame, np.float64).reshape(-1, 2) / 2.0**bits for frame in frames]
    decoded = decode_points(encode_points(FeaturePoints(tuple(sets)), config), len(sets), config)
    for before, after in zip(sets, decoded.frames, strict=True):
        assert np.array_equal(before[column_scan(before)], after)


def test_points_cost_what_the_thesis_says() -> None:
    """A column of DPCM and a row of fixed length: below 0.02 bits a pixel for 176 points of a CIF frame."""
    config = config_of(num_points=176, kind="decoder")
    rng = np.random.default_rng(1)
    frames = tuple(rng.integers(0, [352, 288], (176, 2)).astype(np.float64) for _ in range(9))
    assert 8 * len(encode_points(FeaturePoints(frames), config)) < 9 * 0.02 * 352 * 288


def test_points_that_make_no_sense_are_refused() -> None:
    config = config_of(num_points=2, kind="decoder")
    for points in ([[0, 0], [1, 1], [2, 2]], [[np.nan, 0]], [[0, 288]]):
        with pytest.raises(ValueError, match="points"):
            encode_points(FeaturePoints((np.array(points, np.float64),)), config)


@pytest.mark.parametrize("kind", ["encoder", "decoder"])
@given(st.binary(min_size=1, max_size=60), st.integers(2, 20), st.sampled_from([1, 7, 128, 1024]))
@settings(max_examples=150)
def test_any_bytes_are_a_payload_or_refused(kind: str, data: bytes, count: int, num_points: int) -> None:
    """Arbitrary bytes decode to tracks, or points, that code to the same bytes, or are damaged."""
    config = config_of(num_points=num_points, kind=kind)
    try:
        if kind == "encoder":
            assert encode(decode_tracks(data, count, config), config) == data
        else:
            assert encode_points(decode_points(data, count, config), config) == data
    except BitstreamError:
        return


@given(st.integers(0, 2**16), st.integers(1, 255), st.booleans())
@settings(max_examples=100)
def test_damaged_payloads_never_pass_for_the_original(place: int, change: int, cut: bool) -> None:
    """A changed or cut payload is refused, or makes tracks inside the frame that code to just these bytes."""
    config = config_of(64, 48, 20)
    payload = encode(with_births(1, config, (20, 12), 6, 0.5), config)
    place %= len(payload)
    damaged = payload[:place] if cut else bytes(c ^ change * (i == place) for i, c in enumerate(payload))
    try:
        tracks = decode_tracks(damaged, 6, config)
    except BitstreamError:
        return
    assert encode(tracks, config) == damaged
    known = tracks.positions[np.isfinite(tracks.positions[..., 0])]
    assert (known >= 0).all()
    assert (known <= (63, 47)).all()


@pytest.mark.parametrize("trailer", [b"\0", b"\1", b"trailing"])
def test_trailing_bytes_are_refused(trailer: bytes) -> None:
    config = config_of(64, 48, 20)
    for counts in ((20, 0), (20, 12), (0, 12)):
        payload = encode(with_births(1, config, counts, 6, 0.5), config)
        with pytest.raises(BitstreamError):
            decode_tracks(payload + trailer, 6, config)
    with pytest.raises(BitstreamError, match="damaged"):
        decode_tracks(b"\0", 3, config)  # no tracks have one form, the empty one
    payload = encode_points(FeaturePoints((np.array([[3.0, 4.0], [9.0, 1.0]]),)), config)
    with pytest.raises(BitstreamError):
        decode_points(payload + trailer, 1, config)


@pytest.mark.nojit
def test_payload_is_frozen() -> None:
    positions = [
        [[8, 4], [9, 5], [11, 5]],
        [[20, 12], [21, 13], [np.nan, np.nan]],
        [[4, 16], [5, 16], [6, 17]],
        [[np.nan, np.nan], [26, 4], [28, 4]],
        [[13, 19], [14, 20], [16, 20]],
    ]
    payload = encode(PointTracks(np.array(positions, np.float64), 2), config_of(32, 24, 8))
    assert payload.hex() == FROZEN


FROZEN = "5c72f65b81a564b5cfd3f14375f9ba"


@pytest.mark.parametrize(
    ("size", "bits", "counts", "num_instants", "spread", "frozen"),
    [
        ((352, 288), 1, (128, 48), 11, 0.3, "8fffd3a32690929d985dd04a0f8f66ac"),
        ((352, 288), 0, (60, 0), 4, 3.0, "1974e5ef923960d60dc3cd77ea4ffca0"),
        ((33, 7), 3, (0, 40), 9, 0.5, "be11bb35df5bba71808aa1894a95ae2f"),
        ((16384, 1024), 2, (40, 40), 5, 90.0, "8dec0922b2df6b73281d6d950dc02472"),
    ],
)
def test_payloads_are_frozen(
    size: tuple[int, int],
    bits: int,
    counts: tuple[int, int],
    num_instants: int,
    spread: float,
    frozen: str,
) -> None:
    config = config_of(*size, subpixel_bits=bits)
    tracks = with_births(7, config, counts, num_instants, spread)
    frames = (tracks.forward[:, 0], tracks.backward[:, -1])
    payloads = encode(tracks, config), encode_points(FeaturePoints(frames), config)
    assert hashlib.sha256(b"".join(payloads)).hexdigest()[:32] == frozen


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 12)), max_size=6), st.integers(0, 20))
def test_free_rows_agree_with_the_twin(points: list[tuple[int, int]], column: int) -> None:
    scanned = sorted(points)
    distance = reference.min_distance(scanned, 255)
    array = np.array(scanned, np.int64).reshape(-1, 2)
    assert _kernels.min_distance(array, 255) == distance
    column = max(column, scanned[-1][0]) if scanned else column
    free = np.empty(13, np.bool_)
    with_next = np.concatenate([array, [[column, 0]]])
    count = _kernels.free_rows(with_next, len(scanned), distance, free)
    assert np.flatnonzero(free).tolist() == reference.free_rows(scanned, column, distance, 13)
    assert count == free.sum()


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_positions_are_rounded_to_units(scale: float, choose: Choose) -> None:
    """Halves go to even numbers, unknown positions are lost, and one outside is noticed in any coordinate."""
    set_units = choose(_kernels.set_units)
    positions = np.random.default_rng(1).uniform(0.0, 20.0, (50, 2)).round(1)
    positions[::7] = np.nan
    units, sides = np.empty((50, 2), np.int64), np.array([81, 90])
    assert set_units(positions, scale, sides, units)
    expected = np.where(np.isnan(positions), _kernels.LOST, np.rint(positions * scale))
    assert np.array_equal(units, expected)
    for x, y in ((-0.6, 3.0), (3.0, -1e9), (81.0, 3.0), (3.0, 1e300)):
        positions[3] = x, y
        assert not set_units(positions, scale, sides, units)


def test_tracks_that_come_back_are_noticed(choose: Choose) -> None:
    is_lost_for_good = choose(_kernels.is_lost_for_good)
    units = np.ones((3, 5, 2), np.int64)
    for t in range(4, -1, -1):
        units[1, t] = _kernels.LOST
        assert is_lost_for_good(units)
    units[1, 3] = 7
    assert not is_lost_for_good(units)


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
    payload = encode(tracks, config_of(subpixel_bits=1))
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
    for seed in range(250):
        config = config_of(*size, 24, seed % 4)
        tracks = wild_tracks(seed, config)
        decoded = decode_tracks(encode(tracks, config), tracks.num_instants, config)
        assert rows_of(decoded.forward) == rows_of(tracks.forward)
        assert rows_of(decoded.backward) == rows_of(tracks.backward)


@pytest.mark.parametrize("seed", range(3))
def test_motion_is_that_of_least_squares(seed: int, choose: Choose) -> None:
    """Drawn to one position after the other, coefficients become those of all at once."""
    rng = np.random.default_rng(seed)
    features, errors = rng.normal(size=(30, 10)), rng.normal(0.0, 0.3, (30, 2))
    prior, noise = rng.uniform(0.5, 2.0, 10), 5.0
    instant = motion_kernels.new_instant(30)
    covariance = instant.covariance.reshape(10, motion_kernels.STRIDE)
    instant.features[:] = features
    covariance[:, :10] = np.diag(prior)
    for i, (row, wanted) in enumerate(zip(features, errors, strict=True)):
        variance = choose(motion_kernels.set_gain)(instant, i)
        np.testing.assert_allclose(instant.gain[:10], covariance[:, :10] @ row, atol=1e-12)
        rest = wanted - row @ instant.coefficients
        choose(motion_kernels.learn_motion)(instant, *rest, variance, noise)
    expected, spread = motion_reference.regularised_least_squares(features, errors, prior, noise)
    np.testing.assert_allclose(instant.coefficients, expected, atol=1e-10)
    np.testing.assert_allclose(covariance[:, :10], spread, atol=1e-10)
    assert np.array_equal(covariance[:, :10], covariance[:, :10].T)
    assert not covariance[:, 10:].any()


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_are_the_nearest(seed: int, choose: Choose) -> None:
    nearest_before = choose(motion_kernels.nearest_before)
    first = np.random.default_rng(seed).integers(0, 12, (40, 2)).astype(np.float64)
    neighbours, weights = np.empty((40, 8), np.int64), np.zeros((40, 8))
    nearest_before(first, 30.0, neighbours, weights)
    for i in range(40):
        expected = motion_reference.nearest_before(first, i, 30.0)
        count = len(expected)
        assert neighbours[i, :count].tolist() == [j for j, _ in expected]
        assert (neighbours[i, count:] == -1).all()
        np.testing.assert_allclose(weights[i, :count], [weight for _, weight in expected])


@pytest.mark.parametrize("count", [1, 2, 3, 8, 77])
def test_first_tracks_are_far_apart(count: int, choose: Choose) -> None:
    spread_order = choose(_kernels.spread_order)
    assert spread_order(count).tolist() == motion_reference.spread_order(count)


@pytest.mark.parametrize("seed", range(4))
def test_cells_near_given_tracks_are_not_free(seed: int, choose: Choose) -> None:
    """Cells are taken whose corner is nearer than so many cells to a given position, and no others."""
    rng = np.random.default_rng(seed)
    exponent, guard = int(rng.integers(0, 4)), int(rng.integers(0, 7))
    shape = (21, 17)
    taken = rng.integers(0, [shape[0] << exponent, shape[1] << exponent], (5, 2))
    points = rng.integers(0, 100, (6, 2))
    free = np.ones(shape, np.bool_)
    choose(_kernels.take_guarded)(free, taken, guard, exponent)
    assert np.array_equal(
        free, motion_reference.unguarded_cells(shape, taken, guard << exponent, 1 << exponent)
    )
    square = ((points[:, None] - taken) ** 2).sum(axis=-1).min()
    assert choose(_kernels.min_square)(points, taken) == square
    assert choose(_kernels.min_square)(points, taken[:0]) == 0


@pytest.mark.parametrize("reach", [0, 2, 7])
def test_points_are_counted_in_cells_around_them(reach: int, choose: Choose) -> None:
    """Cells after a point in the scan know how many points are within reach, up to three."""
    count_near = choose(_kernels.count_near)
    rng = np.random.default_rng(reach)
    points = sorted((int(x), int(y)) for x, y in rng.integers(0, [20, 15], (12, 2)))
    near = np.zeros((20, 15), np.uint8)
    for k, (x, y) in enumerate(points):
        count_near(near, x, y, reach, 3)
        for later in range(15 * x + y + 1, 300):
            cell = divmod(later, 15)
            assert near[cell] == min(motion_reference.num_within(points[: k + 1], cell, reach), 3)


def test_motion_of_lost_tracks_is_not_followed() -> None:
    config = config_of()
    tracks = drawn_tracks(5, config, 60, 9, 0.3)
    positions = tracks.positions.copy()
    positions[5:, 4:] = np.nan
    decoded = decode_tracks(encode(PointTracks(positions), config), 9, config)
    assert rows_of(decoded.positions) == rows_of(positions)
