"""Kernels of several views, compiled and as Python, against their plain twins."""

import numpy as np
import pytest

from dvc.geometry import (
    continuation,
    depth_maps,
    label_inference,
    plane_sweep,
    rendering,
    view_synthesis,
    warping,
)
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.plane_sweep import luma_features, packed_features
from dvc.geometry.warping import EMPTY, inverse_warp, warp_matrix
from tests.reference import multiview as reference
from tests.scenes_3d import camera_at
from tests.twins import Choose

pytestmark = pytest.mark.nojit
SHAPE = (7, 9)
FRAME = PixelFrame(SHAPE[1], SHAPE[0])
THERE = warp_matrix(camera_at(0.0), camera_at(1.0), FRAME)
BACK = inverse_warp(THERE)
TO_KEYS = [warp_matrix(camera_at(0.4), camera_at(position), FRAME) for position in (0.0, 1.0)]


def test_warp_grid(choose: Choose, rng: np.random.Generator) -> None:
    depth = rng.uniform(-40, 10, (4, 5))
    got = choose(warping.warp_grid)(BACK, depth, -3.0, 2.5)
    behind = 0
    for i, j in np.ndindex(depth.shape):
        x, y, w = reference.moved(BACK, -3.0 + 2.5 * j, -3.0 + 2.5 * i, depth[i, j])
        behind += w < 1e-6
        there = depth[i, j] / w if w >= 1e-6 else EMPTY
        np.testing.assert_allclose(got[i, j], [x, y, there], rtol=1e-12)
    assert 0 < behind < depth.size


def test_rasterise(choose: Choose, rng: np.random.Generator) -> None:
    rows, columns = np.indices((5, 5))
    positions = np.stack([columns * 2.6, rows * 2.1, 0.2 * rows], -1) + rng.normal(0, 0.9, (5, 5, 3))
    positions[4, 4, 2] = EMPTY
    skipped = rng.random((4, 4)) < 0.2
    nearest = np.full(SHAPE, EMPTY)
    choose(rendering._rasterise)(positions, skipped, nearest)
    np.testing.assert_allclose(nearest, reference.rasterise(positions, skipped, SHAPE), rtol=1e-9)
    assert (nearest == EMPTY).any()


def test_rasterise_discontinuities(choose: Choose) -> None:
    stay = np.eye(3, 4)
    depth = np.array([[1.0, 2.0], [3.0, 4.0]])
    fine = np.full((5, 5), EMPTY)
    enlarged = np.diag([4.0, 4.0, 1.0]) @ stay
    choose(rendering._rasterise_discontinuities)(enlarged, depth, np.ones((1, 1), bool), fine)
    expected = np.array([[1, 1, 2, 2, 2]] * 2 + [[3, 3, 4, 4, 4]] * 3, dtype=float)
    np.testing.assert_allclose(fine, expected)


def test_discontinuities(choose: Choose, rng: np.random.Generator) -> None:
    depth = np.where(rng.random(SHAPE) < 0.3, 0.9, 0.2)
    motion = warping.warp_grid(THERE, depth)[..., :2] - np.indices(SHAPE)[::-1].transpose(1, 2, 0)
    corners = np.stack([motion[:-1, :-1], motion[:-1, 1:], motion[1:, :-1], motion[1:, 1:]])
    spread = np.ptp(corners, axis=0).max(axis=-1)
    tolerance = float(np.median(spread)) + 1e-6
    found = choose(depth_maps.discontinuities)(depth, THERE, tolerance)
    np.testing.assert_array_equal(found, spread > tolerance)
    assert 0 < found.sum() < found.size


def test_sample_image(choose: Choose) -> None:
    x = np.arange(12.0)
    cubic = 0.05 * x**3 - 0.4 * x**2 + x
    image = cubic[:, None] + cubic[None, :]
    positions = np.array([[[4.3, 6.8], [5.0, 3.0], [-4.0, 2.0], [99.0, 99.0]]])
    samples = np.empty((1, 4))
    padded = np.pad(image, warping.PADDING, mode="edge").astype(np.float32)
    choose(warping._sample)(padded, positions, samples)
    at = 0.05 * positions[0, 0] ** 3 - 0.4 * positions[0, 0] ** 2 + positions[0, 0]
    np.testing.assert_allclose(samples[0], [at.sum(), image[3, 5], image[2, 0], image[11, 11]], atol=1e-4)


def test_matching_cost(choose: Choose, rng: np.random.Generator) -> None:
    base, other = rng.integers(80, 121, (2, *SHAPE), dtype=np.uint8)
    rhos = np.array([0.0, 0.3, 0.6, 0.9])
    levels, gradients = plane_sweep.LEVEL_LIMIT, plane_sweep.GRADIENT_LIMIT
    limits = np.array([levels, gradients, gradients], np.float32)
    cost = np.empty((*SHAPE, 4), np.int16)
    packed = packed_features(base), packed_features(other)
    choose(plane_sweep._matching_cost)(*packed, THERE, 0.0, 0.3, cost)
    features = luma_features(base), luma_features(other)
    expected = reference.matching_cost(*features, THERE, rhos, limits, plane_sweep.OUTSIDE_COST)
    assert np.abs(cost - expected).max() <= 8  # positions are off by up to a sixty-fourth of a pixel
    assert np.abs(cost - expected).mean() < 1.0
    assert expected.max() > 80
    assert (cost == plane_sweep.OUTSIDE_COST).any()


def test_box_mean(choose: Choose, rng: np.random.Generator) -> None:
    cost = rng.integers(0, 200, (5, 7, 3)).astype(np.int16)
    mean = choose(plane_sweep._box_mean)(cost)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(cost, ((1, 1), (1, 1), (0, 0)), mode="edge"), (3, 3), axis=(0, 1)
    )
    np.testing.assert_array_equal(mean, around.sum(axis=(-1, -2)) // 9)


def test_census_cost(choose: Choose, rng: np.random.Generator) -> None:
    levels = rng.uniform(0, 60, (2, *SHAPE)).astype(np.float32)
    bits = rng.integers(0, 1 << 24, (2, *SHAPE)).astype(np.uint32)
    cost = np.empty((*SHAPE, 4), np.int16)
    base, other = zip(levels, bits, strict=True)
    with np.errstate(over="ignore"):  # the count of bits wraps around on purpose
        choose(plane_sweep._census_cost)(*base, *other, THERE, 0.0, 0.3, cost)
    limits = 20.0, plane_sweep.CENSUS_BIT_COST, plane_sweep.CENSUS_OUTSIDE_COST
    expected = reference.census_cost(base, other, THERE, np.array([0.0, 0.3, 0.6, 0.9]), *limits)
    assert np.abs(cost - expected).max() <= 1  # single precision may round down
    assert (cost == plane_sweep.CENSUS_OUTSIDE_COST).any()


def test_aggregation_and_choice(choose: Choose, rng: np.random.Generator) -> None:
    cost = rng.integers(0, 90, (*SHAPE, 6)).astype(np.int16)
    image = rng.uniform(0, 255, SHAPE).astype(np.float32)
    total = np.zeros(cost.shape, np.int16)
    for dy, dx in reference.DIRECTIONS:
        lines = np.full((2, SHAPE[1], 9), 20000, np.int16)
        choose(label_inference._aggregate_path)(cost, image, dy, dx, 8, 60, lines[0], lines[1], total)
    expected = reference.aggregate(cost, image, 8, 60)
    np.testing.assert_array_equal(total, expected)
    found = choose(label_inference._best_hypothesis)(total)
    np.testing.assert_allclose(found, reference.best_hypothesis(expected))


def test_check_consistency(choose: Choose, rng: np.random.Generator) -> None:
    depth, other = rng.uniform(0.2, 0.9, (2, *SHAPE))
    visibility = choose(depth_maps._check_consistency)(depth, other, THERE, BACK, 0.4)
    np.testing.assert_array_equal(visibility, reference.consistency(depth, other, THERE, BACK, 0.4))
    assert set(np.unique(visibility)) == {0, 1, 2}


def test_weighted_quantile(choose: Choose, rng: np.random.Generator) -> None:
    for quantile in (0.0, 0.3, 0.5, 1.0):
        values, weights = rng.uniform(size=(2, 6))
        expected = reference.weighted_quantile(values, weights, quantile)
        got = choose(continuation._weighted_quantile)(values.copy(), weights.copy(), 6, quantile)
        assert got == expected


def test_planes_are_continued_across_gaps(choose: Choose) -> None:
    rows, columns = np.indices((14, 14))
    plane = 0.3 + 0.01 * columns - 0.004 * rows
    visibility = np.zeros(plane.shape, np.int8)
    visibility[5:8, 6:14] = 1
    damaged = np.where(visibility == 0, plane, 9.0)
    slopes = choose(continuation._local_slopes)(damaged, visibility == 0, visibility == 0, 3, 1, 0.1)
    np.testing.assert_allclose(slopes[2, 3], [0.01, -0.004], rtol=1e-6)
    other = continuation.OtherView(THERE, BACK, plane, np.ones(plane.shape, np.int8), 1.0)
    luma = np.zeros(plane.shape)
    filled = choose(continuation.fill_depth)(damaged, visibility, luma, slopes, 30.0, 0.5, other)
    np.testing.assert_allclose(filled, plane, rtol=1e-4)


def test_depths_that_the_other_view_looks_through_are_refused(choose: Choose) -> None:
    near, far = 0.9, 0.1
    depth = np.full((1, 9), near)
    depth[0, :3] = far
    visibility = np.zeros((1, 9), np.int8)
    visibility[0, 3:6] = 2
    stay = np.eye(3, 4)
    stay[0, 3] = 2.0
    back = stay.copy()
    back[0, 3] = -2.0
    seen = np.full((1, 9), far)
    arguments = depth, visibility, np.zeros((1, 9)), np.zeros((1, 9, 2)), 30.0, 0.9
    for other_state, expected in ((0, far), (1, near)):
        others = np.full((1, 9), other_state, np.int8)
        other = continuation.OtherView(stay, back, seen, others, 0.5)
        assert choose(continuation.fill_depth)(*arguments, other)[0, 5] == expected


def test_guided_median(choose: Choose) -> None:
    image = np.zeros((15, 22), np.uint8)
    image[:, 11:] = 100
    depth = np.where(image > 0, 0.8, 0.2)
    ragged = depth.copy()
    ragged[6:8, 11] = 0.2
    ragged[9, 10] = 0.8
    chosen = np.ones(image.shape, bool)
    chosen[9, 10] = False
    nowhere = np.ones(image.shape, np.int8)
    other = continuation.OtherView(THERE, BACK, depth, nowhere, 1.0)
    trust, bins = np.ones(image.shape), (0.2, 0.6 / 255)
    median = choose(depth_maps._guided_median)(ragged, trust, image, chosen, *bins, other)
    expected = depth.copy()
    expected[9, 10] = 0.8
    np.testing.assert_allclose(median, expected, atol=1e-12)


def test_visibility_weights(choose: Choose, rng: np.random.Generator) -> None:
    depth = np.where(np.indices(SHAPE)[1] < 4, 0.8, 0.1)
    visibility = (rng.random(SHAPE) < 0.1).astype(np.int8)
    positions = np.stack(
        [rng.uniform(-2, 10, SHAPE), rng.uniform(-2, 8, SHAPE), rng.uniform(0, 0.9, SHAPE)], -1
    )
    weights = choose(rendering._visibility_weights)(positions, depth, visibility, BACK)
    values = {
        "outside": rendering.OUTSIDE_WEIGHT,
        "occluded": rendering.OCCLUDED_WEIGHT,
        "edge": rendering.EDGE_WEIGHT,
        "seen": 1.0,
    }
    expected = reference.visibility(positions, depth, visibility, BACK, 1, 1.0)
    np.testing.assert_array_equal(weights, np.vectorize(values.get)(expected))
    assert set(expected.ravel()) == set(values)


def test_block_cost_and_error(choose: Choose, rng: np.random.Generator) -> None:
    first, second = rng.uniform(0, 80, (2, 3, 14, 18)).astype(np.float32)
    limits = plane_sweep.LEVEL_LIMIT, plane_sweep.GRADIENT_LIMIT, plane_sweep.GRADIENT_LIMIT
    view = plane_sweep.VirtualView((first, second), (TO_KEYS[0], TO_KEYS[1]), 4)
    cost = choose(plane_sweep.block_costs)(view, plane_sweep.DepthHypotheses(0.0, 0.3, 3), 1.5)
    assert cost.shape == (4, 5, 3)
    offsets = 1.5 * (np.arange(4) - 1.5)
    for i, j, k in np.ndindex(3, 4, 3):
        total = 0.0
        for dy, dx in ((dy, dx) for dy in offsets for dx in offsets):
            places = [reference.moved(t, 4 * j + 1.5 + dx, 4 * i + 1.5 + dy, 0.3 * k)[:2] for t in TO_KEYS]
            if not all(0 <= x <= 17 and 0 <= y <= 13 for x, y in places):
                total += plane_sweep.OUTSIDE_COST
                continue
            for m in range(3):
                levels = [
                    reference.bilinear(key[m], *at) for key, at in zip((first, second), places, strict=True)
                ]
                total += min(abs(levels[0] - levels[1]), limits[m])
        assert abs(cost[i, j, k] - int(total / 16)) <= 1
    for x in (8.0, 1.0):
        got = choose(plane_sweep._block_error)(first[0], second[0], *TO_KEYS, x, 7.0, 0.4, 2)
        expected = reference.window_error(first[0], second[0], TO_KEYS, x, 7.0, 0.4, 2)
        assert got == pytest.approx(expected, rel=1e-5)


def test_golden_search(choose: Choose) -> None:
    columns = np.indices((12, 24))[1]
    first = (100 + 40 * np.sin(columns / 3.0)).astype(np.float32)
    to_first, to_second = np.eye(3, 4), np.eye(3, 4)
    to_second[0, 3] = 6.0
    second = (100 + 40 * np.sin((columns - 6.0 * 0.35) / 3.0)).astype(np.float32)
    depth = np.full((1, 1), 0.3)
    for warp, expected, tolerance in ((to_second, 0.35, 0.02), (to_first, 0.3, 0.0)):
        view = plane_sweep.VirtualView((first[None], second[None]), (to_first, warp), 12)
        refined = choose(plane_sweep.refine_blocks)(view, depth, 0.2, 3)
        assert refined[0, 0] == pytest.approx(expected, abs=tolerance)


def test_membranes(choose: Choose, rng: np.random.Generator) -> None:
    holes = rng.random(SHAPE) < 0.5
    count = int(holes.sum())
    number = np.full(SHAPE, -1, np.int32)
    number[holes] = np.arange(count)
    depth, limit = rng.uniform(0.0, 1.0, (2, *SHAPE))
    image, stiffness = rng.uniform(0.0, 255.0, (*SHAPE, 2)), view_synthesis.STIFFNESS
    neighbours, diagonal = np.empty((count, 4), np.int32), np.empty(count)
    guess = rng.uniform(0.0, 255.0, (2, count))
    right = stiffness * guess
    choose(view_synthesis._membrane_equations)(number, depth, limit, image, neighbours, diagonal, right)
    matrix, bounds = reference.membrane(number, depth, limit, image, stiffness)
    np.testing.assert_allclose(right, stiffness * guess + bounds)
    np.testing.assert_allclose(diagonal, np.diag(matrix))
    assert (np.abs(matrix).sum(axis=1) > 3.0).any()
    for levels, target in zip(guess, right, strict=True):
        product = np.empty(count)
        form = choose(view_synthesis._membrane_product)(neighbours, diagonal, levels, product)
        np.testing.assert_allclose(product, matrix @ levels, atol=1e-9)
        assert form == pytest.approx(levels @ matrix @ levels)
        choose(view_synthesis._solve_membrane)(neighbours, diagonal, target, levels)
        residual = matrix @ levels - target
        assert np.sqrt(np.mean(residual**2)) <= view_synthesis.TOLERANCE
