"""The model of operations is what kernels do, on numbers that count."""

from collections.abc import Callable, Sequence
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest

from dvc.config import VideoConfig, codec_config
from dvc.corners import SENSITIVITY
from dvc.tracks import PointTracks
from dvc.tracks.regression import _kernels as kernels
from dvc.tracks.regression._kernels import NUM_NEIGHBOURS
from dvc.wynerziv import _kernels as wyner_ziv_kernels
from dvc.wynerziv import transform
from encoder import _kernels
from encoder import encoder_report as work
from encoder.corner_detector import TRACKED_CORNERS, _response
from encoder.encoder_report import Operations
from tests.clips import moving_texture
from tests.counting import Data, Tally, counting

RNG = np.random.default_rng(11)
LUMA = RNG.integers(0, 256, (16, 32)).astype(np.uint8)
CORE, EXTREMES = transform.integer_core(LUMA)


def counted(kernel: Any, tally: Tally, *arguments: Any, scratch: bool = True) -> Operations:
    """Return what a call of a kernel adds to a tally."""
    before = tally.operations()
    counting(kernel, tally, scratch=scratch)(*arguments)
    return tally.operations() + before.times(-1)


def test_transform() -> None:
    """Samples to bands: all that is done to them, to the last byte, and the same coefficients."""
    tally, core, extremes = Tally(), np.zeros_like(CORE), np.zeros_like(EXTREMES)
    quads = LUMA.view("<u4")
    found = counted(
        transform._transform_samples,
        tally,
        Data(quads, tally),
        transform.ORDER,
        Data(core, tally),
        Data(extremes, tally),
    )
    assert found == work.transform(LUMA.size, 1)
    np.testing.assert_array_equal(core, CORE)
    np.testing.assert_array_equal(extremes, EXTREMES)


@pytest.mark.parametrize("planes", [[10, 4, 4, 3, 3, 2, 2, 1, 1, 1, 0, 0, 0, 0, 0, 0], [4] * 16])
def test_quantisation(planes: Sequence[int]) -> None:
    tally, words = Tally(), np.zeros((1, CORE.shape[1]), np.uint64)
    given = transform.BAND_SCALE, 16.0, np.zeros(16), np.array(planes)
    kernel = wyner_ziv_kernels.pack_uniform
    found = counted(kernel, tally, Data(CORE, tally), *given, Data(words, tally))
    places = CORE.shape[1]
    assert found == work.quantisation(places * int(np.count_nonzero(planes)))
    expected = np.zeros_like(words)
    kernel(CORE, *given, expected)
    np.testing.assert_array_equal(words, expected)


@pytest.mark.parametrize("half_side_px", [_kernels.HALF_BLOCK_PX, _kernels.QUARTER_HALF_BLOCK_PX])
def test_block_comparison(half_side_px: int) -> None:
    tally, side = Tally(), 2 * half_side_px + 1
    blocks = RNG.integers(0, 256, (2, side, side)).astype(np.uint8)
    counts = np.zeros(2, np.int64)
    image = np.ascontiguousarray(LUMA)
    matching = Data(image, tally), Data(blocks, tally), counts
    found = counted(_kernels.block_sad, tally, matching, 16, 8, half_side_px, 1, scratch=False)
    assert found == work.block_comparison(half_side_px)
    assert counts.tolist() == [1, side**2]


def test_spatial_candidates() -> None:
    tally, places = Tally(), RNG.integers(0, 200, (2, 9)).astype(np.int32)
    nearest_found = np.full(9, _kernels.UNKNOWN << 20)
    given = (*(Data(line, tally) for line in places), 2, 3, Data(nearest_found, tally))
    assert counted(_kernels.offer_motion, tally, *given, scratch=False) == work.SPATIAL_CANDIDATES.times(6)
    assert (nearest_found[3:] < _kernels.UNKNOWN << 20).all()


def harris(luma: Data, tally: Tally) -> Data:
    """Compute the response to corners at half the resolution, step by step, around the borders."""
    height, width = luma.shape[0] // 2, luma.shape[1] // 2

    def drawn(of: type, value: Callable[[int, int], Any]) -> Data:
        out = Data(np.zeros((height, width), of), tally)
        for y, x in np.ndindex(height, width):
            out[y, x] = value(y, x)
        return out

    def around(image: Data, y: int, x: int) -> Any:
        return image[y % height, x % width]

    def smooth(down: int, across: int) -> Data:
        """Weigh a sample twice between its neighbours along one direction."""

        def weighed(y: int, x: int) -> Any:
            before, after = (around(small, y + s * down, x + s * across) for s in (-1, 1))
            return before + (around(small, y, x) << 1) + after

        return drawn(np.int16, weighed)

    def summed(image: Data, down: int, across: int) -> Data:
        def three(y: int, x: int) -> Any:
            first, second, third = (around(image, y + s * down, x + s * across) for s in (-1, 0, 1))
            return first + second + third

        return drawn(np.float32, three)

    def shrunk(y: int, x: int) -> Any:
        (a, b), (c, d) = ((luma[2 * y + k, 2 * x], luma[2 * y + k, 2 * x + 1]) for k in range(2))
        return (a + b + c + d + 2) >> 2

    def response(y: int, x: int) -> Any:
        xx, xy, yy = (window[y, x] for window in windows)
        trace = xx + yy
        return xx * yy - xy * xy - SENSITIVITY * (trace * trace)

    small = drawn(np.uint8, shrunk)
    lines, columns = smooth(1, 0), smooth(0, 1)
    dx = drawn(np.float32, lambda y, x: around(lines, y, x + 1) - around(lines, y, x - 1))
    dy = drawn(np.float32, lambda y, x: around(columns, y + 1, x) - around(columns, y - 1, x))
    pairs = ((dx, dx), (dx, dy), (dy, dy))
    products = [drawn(np.float32, lambda y, x, p=p: p[0][y, x] * p[1][y, x]) for p in pairs]
    windows = [summed(summed(product, 1, 0), 0, 1) for product in products]
    return drawn(np.float32, response)


def test_corners() -> None:
    """The response to corners by its definition, which gives what the encoder's detector looks at."""
    tally = Tally()
    luma = moving_texture(1, 32, 48)[0].luma
    found = harris(Data(luma, tally), tally)
    assert tally.operations() == work.corners(luma.size)
    response, shrink = _response(luma, TRACKED_CORNERS)
    assert shrink == 2
    inside = (slice(3, -3), slice(3, -3))
    expected = response[inside].astype(np.float64) * (4 * 255.0 * 3) ** 4
    np.testing.assert_allclose(found.array[inside], expected, rtol=1e-3, atol=1e-4 * expected.max())


def as_data(values: Any, tally: Tally, *plain: str) -> Any:
    """Let the arrays of a named tuple count, but for some that hold places."""
    parts = zip(values._fields, values, strict=True)
    return type(values)(*(part if name in plain else Data(part, tally) for name, part in parts))


def test_regression() -> None:
    count, sides, tally = 12, (100, 100), Tally()
    first = RNG.uniform(20, 80, (count, 2))
    neighbours, weights = np.empty((count, NUM_NEIGHBOURS), np.int64), np.zeros((count, NUM_NEIGHBOURS))
    kernels.nearest_before(first, 1000.0, neighbours, weights)
    moved, last = first + RNG.normal(0.0, 1.0, first.shape), RNG.normal(0.0, 1.0, first.shape)
    motion = kernels.Motion(first, moved, last, np.ones(count), neighbours, weights, np.ones(12))
    units = np.repeat(np.rint(moved).astype(np.int64)[:, None], 3, axis=1)
    state, instant = as_data(motion, tally, "neighbours"), as_data(kernels.new_instant(count), tally)
    places = Data(units, tally)
    counting(kernels.set_prior, tally)(state, places, 2, instant.covariance)
    predict, learn = counting(kernels.predict, tally), counting(kernels.learn, tally)
    for i in range(count):
        before = tally.operations()
        size, variance = predict(state, instant, places, i, 2, sides)
        learn(state, instant, places, i, 2, size, 1.0, variance)
    assert (neighbours[-1] >= 0).all()
    assert tally.operations() + before.times(-1) == work.regression(1)


def test_positions_that_are_predicted() -> None:
    """All but the first of each track; whole ones once more where tracks were followed back."""
    positions = np.full((3, 4, 2), np.nan)
    positions[0], positions[1, :2], positions[2, 2:] = 1.0, 2.0, 3.0
    assert work.predicted_positions(PointTracks(positions[:2])) == 3 + 1
    assert work.predicted_positions(PointTracks(positions, 1)) == 3 + 1 + 1 + 3
    assert work.predicted_positions(PointTracks.none(4)) == 0


def test_interpolation() -> None:
    """Samples of a block from two frames, moved as the points nearest to it; the nearest come first."""
    tally, num_points = Tally(), 128
    frames = [Data(RNG.integers(0, 256, (16, 16)).astype(np.uint8), tally) for _ in range(3)]
    positions = RNG.uniform(2, 14, (num_points, 3, 2))
    order = np.argsort(((positions[:, 0] - 4.0) ** 2).sum(axis=1))
    found = counted(_kernels.interpolation_error, tally, *frames, Data(positions[order], tally), 16)
    model = work.interpolation(1, num_points)
    assert astuple(found) == pytest.approx(astuple(model), rel=0.02)


def test_stages_add_up() -> None:
    config = codec_config(VideoConfig(12, 8, 25, 1))
    none, once, twice = (
        work.EncoderStatistics(
            num_key_frames=1,
            num_transformed=4 * n,
            num_coded_bands=8 * n,
            tracking=work.TrackingWork(9 * n, 5 * n, 500 * n, n, n, 7 * n, 6 * n, 3 * n, 2 * n),
        ).operations_per_pixel(config)
        for n in (0, 1, 2)
    )
    for name, stage in once.items():
        assert sum(none[name].values()) == 0.0 < sum(stage.values())
        assert twice[name] == {kind: pytest.approx(2 * number) for kind, number in stage.items()}
