"""Matching costs at every disparity, their aggregation over regions along a base surface, and combination."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry import matching_costs
from dvc.geometry.camera_array import ArrayView, DisparityLabels, LatticePosition
from dvc.geometry.matching_costs import (
    COSTS,
    DARK_LEVEL,
    DEAD_ZONE,
    Band,
    WeightedCosts,
    Window,
    aggregate,
    census,
    cross_arms,
    defined_costs,
    evened_levels,
    offsets,
    phases,
)
from tests.reference import cost_volumes as reference
from tests.reference.stereo_volumes import banded
from tests.twins import Choose, compiled_and_python

SHAPE = (7, 9)


def smooth_view(
    name: str, m: float, n: float, disparity: float, shape: tuple[int, int] = (24, 40)
) -> ArrayView:
    """Return the view of camera (m, n) of a smooth picture at one disparity."""
    y, x = np.indices(shape, np.float64)
    x, y = x + m * disparity, y + n * disparity
    levels = [128 + 50 * np.sin(0.5 * x + k) + 40 * np.cos(0.43 * y - 0.2 * k * x) for k in range(3)]
    return ArrayView(name, np.rint(np.stack(levels, -1)).astype(np.uint8), LatticePosition(m, n))


def random_view(rng: np.random.Generator, m: float, n: float, *, holes: bool = False) -> ArrayView:
    image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    return ArrayView(f"{m},{n}", image, LatticePosition(m, n), rng.random(SHAPE) < 0.8 if holes else None)


def every_label(labels: DisparityLabels, shape: tuple[int, int]) -> Band:
    return Band(np.zeros(shape, np.int64), labels.num_labels)


@pytest.mark.nojit
@pytest.mark.parametrize("limit", [0.0, 150.0], ids=["census", "squared"])
def test_costs_of_pixels(choose: Choose, rng: np.random.Generator, limit: float) -> None:
    """Census bits and levels by tables, or the mean over the channels, truncated (2.18), over the limit."""
    image, *others = pictures = rng.integers(0, 40 if limit else 256, (3, *SHAPE, 3)).astype(np.float32)
    texts = [reference.census(picture.mean(axis=2), 2, 0.0) for picture in pictures]
    words = np.array([[[int(text, 2) for text in row] for row in rows] for rows in texts], np.uint32)
    seen = rng.random(SHAPE) < 0.8
    shifts = np.array([[0, 0, 0], [1, -2, 0], [0, -1, 1], [1, 3, -2]])
    bit_table, level_table = rng.random(25).astype(np.float32), rng.random(766).astype(np.float32)
    top, origin = 2, rng.integers(-2, 3, SHAPE)
    cost, weight = np.full((2, 4, SHAPE[1], 3), 9.0, np.float32)
    rows, tables = slice(top, top + 4), (bit_table, level_table, np.float32(limit))
    compared = image[rows], words[0][rows], pictures[1:], words[1:], seen, np.add(shifts, (0, 0, top))
    with np.errstate(over="ignore"):
        choose(matching_costs._compare)(*compared, origin[rows], *tables, cost, weight)
    for i, x, k in np.ndindex(cost.shape):
        label = origin[top + i, x] + k
        phase, u, v = (shifts[label] if 0 <= label < 4 else (0, -99, 0)) + np.array([0, x, top + i])
        known = 0 <= u < SHAPE[1] and 0 <= v < SHAPE[0] and seen[v, u]
        assert weight[i, x, k] == known
        expected = 0.0
        if known:
            difference = np.abs(image[top + i, x] - others[phase][v, u])
            bits = reference.hamming(texts[0][top + i, x], texts[1 + phase][v, u])
            expected = bit_table[bits] + level_table[int(difference.sum())]
            expected = min(float((difference**2).mean()), limit) / limit if limit else expected
        assert cost[i, x, k] == pytest.approx(expected, rel=1e-5)
    assert 0 < weight.sum() < weight.size
    assert not limit or (cost == 1.0).any()


def test_offsets_follow_the_array() -> None:
    """A point of camera (0, 0) is seen farther to the left by a camera to its right (2.5)."""
    labels = DisparityLabels(1.0, 0.5, 3)
    moved = offsets(labels, LatticePosition(0.0, 0.0), LatticePosition(1.0, -2.0))
    np.testing.assert_allclose(moved, [[-1.0, 2.0], [-1.5, 3.0], [-2.0, 4.0]])
    back = offsets(labels, LatticePosition(1.0, -2.0), LatticePosition(0.0, 0.0))
    np.testing.assert_allclose(back, -moved)


def test_phases_are_the_view_between_its_pixels() -> None:
    labels = DisparityLabels(0.0, 0.25, 9)
    view = smooth_view("a", 1.0, 0.0, 0.0)
    pictures, shifts, _ = phases(view, LatticePosition(0.0, 0.5), labels, slice(0, 24))
    assert len(pictures) == 8, "quarters across, with their halves down"
    y, x = np.indices(view.shape, np.float64)
    inner = slice(6, -6), slice(6, -6)
    for k, (phase, dx, dy) in enumerate(shifts):
        u, v = x - 0.25 * k, y + 0.125 * k
        levels = [128 + 50 * np.sin(0.5 * u + c) + 40 * np.cos(0.43 * v - 0.2 * c * u) for c in range(3)]
        found = np.roll(pictures[phase], (-dy, -dx), axis=(0, 1))
        assert np.abs(found - np.stack(levels, -1))[inner].max() < 2.0
    assert (pictures[shifts[0, 0]] == view.image).all(), "whole pixels are not interpolated"
    assert pictures.min() >= 0.0
    assert pictures.max() <= 255.0


@pytest.mark.parametrize("name", sorted(COSTS))
@pytest.mark.parametrize(("m", "n"), [(1.0, 0.0), (0.37, 1.13), (0.0, -2.0), (0.0, 30.0)])
def test_rows_need_no_others(name: str, m: float, n: float, rng: np.random.Generator) -> None:
    shape, labels = (64, 20), DisparityLabels(-1.0, 0.3, 12)
    images = rng.integers(0, 256, (2, *shape, 3)).astype(np.uint8)
    view = ArrayView("a", images[0], LatticePosition(0.0, 0.0))
    other = ArrayView("b", images[1], LatticePosition(m, n), rng.random(shape) < 0.8)
    band = every_label(labels, shape)
    whole = COSTS[name](view, other, labels, band, slice(0, 64))
    for rows in (slice(0, 5), slice(20, 33), slice(60, 64)):
        found = COSTS[name](view, other, labels, band, rows)
        for one, expected in zip(found, whole, strict=True):
            np.testing.assert_array_equal(one, expected[rows])
    needed = phases(other, view.position, labels, slice(20, 30))[0].shape[1]
    assert needed <= 10 + 4 * abs(n) + 10


@pytest.mark.parametrize("name", sorted(COSTS))
@pytest.mark.parametrize(("m", "n"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.6, -0.9)])
def test_true_disparity_between_pixels_costs_least(name: str, m: float, n: float) -> None:
    labels = DisparityLabels(0.0, 0.25, 17)
    true = 9
    views = [smooth_view("a", 0.0, 0.0, 2.25), smooth_view("b", m, n, 2.25)]
    cost, weight = COSTS[name](*views, labels, every_label(labels, views[0].shape), slice(6, 18))
    total = (cost * weight)[:, 8:-8].sum(axis=(0, 1))
    assert (weight[:, 8:-8] == 1.0).all()
    assert int(total.argmin()) == true
    assert cost.min() >= 0.0
    assert cost.max() <= COSTS[name].highest


@pytest.mark.parametrize("name", sorted(COSTS))
def test_band_has_the_costs_of_its_labels(name: str, rng: np.random.Generator) -> None:
    labels = DisparityLabels(0.0, 0.5, 6)
    view, other = random_view(rng, 0.0, 0.0), random_view(rng, -1.0, 0.5, holes=True)
    origin = rng.integers(-2, 6, SHAPE)
    whole = COSTS[name](view, other, labels, every_label(labels, SHAPE), slice(0, SHAPE[0]))
    part = COSTS[name](view, other, labels, Band(origin, 3), slice(0, SHAPE[0]))
    for a, b in zip(whole, part, strict=True):
        np.testing.assert_array_equal(b, banded(a, origin, 3, 0.0))


@pytest.mark.parametrize("name", sorted(COSTS))
def test_what_the_other_view_does_not_have_has_no_weight(name: str, rng: np.random.Generator) -> None:
    labels = DisparityLabels(0.0, 1.0, 4)
    band = every_label(labels, SHAPE)
    view, other = random_view(rng, 0.0, 0.0), random_view(rng, 1.0, 0.0, holes=True)
    cost, weight = COSTS[name](view, other, labels, band, slice(0, SHAPE[0]))
    assert other.valid is not None
    for k in range(4):
        seen = np.zeros(SHAPE, bool)
        seen[:, k:] = other.valid[:, : SHAPE[1] - k]
        np.testing.assert_array_equal(weight[:, :, k], seen)
        assert not cost[:, :, k][~seen].any()
    assert set(np.unique(weight)) == {0.0, 1.0}


def test_census_is_blind_to_exposure(rng: np.random.Generator) -> None:
    image = rng.integers(0, 200, (*SHAPE, 3)).astype(np.float32)
    np.testing.assert_array_equal(census(image), census(image + np.float32(40.0)))
    noise = rng.uniform(0, 0.9 * DEAD_ZONE, SHAPE)
    flat = np.float32(100.0) + np.repeat(noise[:, :, None], 3, axis=2).astype(np.float32)
    assert not census(flat).any()


@pytest.mark.nojit
@pytest.mark.parametrize("radius", [1, 2])
def test_census_bits(choose: Choose, rng: np.random.Generator, radius: int) -> None:
    grey = rng.integers(0, 12, SHAPE).astype(np.float32)
    bits = np.empty(SHAPE, np.uint32)
    choose(matching_costs._census)(np.pad(grey, radius, mode="edge"), radius, np.float32(2.0), bits)
    expected = reference.census(grey.astype(np.float64), radius, 2.0)
    length = (2 * radius + 1) ** 2 - 1
    np.testing.assert_array_equal(np.vectorize(lambda word: f"{word:0{length}b}")(bits), expected)


@pytest.mark.nojit
def test_bits_are_counted(choose: Choose, rng: np.random.Generator) -> None:
    words = [0, 1, 1 << 63, (1 << 64) - 1, *rng.integers(0, 1 << 64, 50, np.uint64).tolist()]
    with np.errstate(over="ignore"):  # the product wraps around on purpose
        found = [int(choose(matching_costs.count_bits)(np.uint64(word))) for word in words]
    assert found == [word.bit_count() for word in words]


JUMP = 20
"""A step of the base surface that is a discontinuity."""
WINDOW = Window(reach_px=5, near_reach_px=2, iterations=1)
KERNELS = "_even_steps", "_shorten_arms", "_sum_rows", "_sum_columns", "_normalise"
_kind = compiled_and_python(matching_costs, *KERNELS, "smaller_costs", "mean_costs")


def twins(test: Any) -> Any:
    """Run a test with compiled kernels, and with those of Python."""
    return pytest.mark.nojit(pytest.mark.usefixtures("_kind")(test))


def patches(rng: np.random.Generator, shape: tuple[int, int] = SHAPE) -> NDArray[np.uint8]:
    """Return a picture of flat places, slow changes and edges."""
    steps = rng.choice([0, 0, 3, 8, 25], (*shape, 3)) * rng.choice([-1, 1], (*shape, 3))
    levels: NDArray[np.uint8] = (120 + np.cumsum(steps, axis=1) % 100).astype(np.uint8)
    return levels


@twins
@pytest.mark.parametrize("window", [WINDOW, Window(9, 3, 1, limit=12, far_limit=4)])
def test_arms(rng: np.random.Generator, window: Window) -> None:
    image = np.repeat(patches(rng), 2, axis=1)
    arms = cross_arms(image, window)
    limits = window.reach_px, window.near_reach_px, window.limit, window.far_limit
    np.testing.assert_array_equal(arms, reference.arms(image, *limits))
    assert len(np.unique(arms)) > 3
    flat = cross_arms(np.full((9, 9, 3), 70, np.uint8), window)
    assert flat[4, 4].tolist() == [min(window.reach_px - 1, 4)] * 4
    assert flat[0, 0].tolist() == [0, min(window.reach_px - 1, 8)] * 2


@twins
def test_small_steps_count_more_in_the_dark() -> None:
    levels = evened_levels().astype(np.int64)
    np.testing.assert_array_equal(np.diff(levels[DARK_LEVEL:]), 1)
    assert (np.diff(levels) >= 1).all()
    assert levels[10] - levels[0] == pytest.approx(sum((DARK_LEVEL / k) ** 0.5 for k in range(1, 11)), abs=1)
    window = Window(9, 9, 1, limit=12)
    picture = np.where(np.indices(SHAPE)[1] < 4, 0, 9).astype(np.uint8)
    reach = [
        cross_arms(np.repeat((picture + dark)[:, :, None], 3, axis=2), window)[0, 0, 3] for dark in (5, 60)
    ]
    assert reach == [3, 8]


@twins
@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_weighted_means_along_a_base_surface(rng: np.random.Generator, iterations: int) -> None:
    count = 5
    base = rng.choice([0, 1, 1, 2, 4], SHAPE) + JUMP * (np.indices(SHAPE)[1] > 5)
    origin = rng.integers(-1, 3, SHAPE) + JUMP * (np.indices(SHAPE)[0] > 4)
    arms = cross_arms(np.full((SHAPE[0] + 4, SHAPE[1], 3), 90, np.uint8), WINDOW)[2:-2]
    cost, weight = rng.random((*SHAPE, count)), rng.integers(0, 2, (*SHAPE, count)).astype(np.float64)
    costs = WeightedCosts(cost.astype(np.float32), weight.astype(np.float32))
    aggregate(costs, arms, base, origin, 2, iterations)
    lengths = reference.cut(arms.astype(np.int64), base, 2)
    expected = reference.aggregate(cost, weight, lengths, base - origin, iterations)
    np.testing.assert_allclose(costs.weight, expected[1], atol=1e-5)
    np.testing.assert_allclose(costs.cost, expected[0], atol=2e-5)
    assert (lengths < arms).any()


@twins
def test_what_is_not_known_takes_what_its_region_says() -> None:
    cost = np.full((9, 9, 2), 0.25, np.float32)
    weight = np.ones_like(cost)
    cost[2:7, 2:7, 0], weight[2:7, 2:7, 0] = 77.0, 0.0
    cost[:, :, 1], weight[:, :, 1] = 5.0, 0.0
    costs = WeightedCosts(cost, weight)
    arms = cross_arms(np.zeros((9, 9, 3), np.uint8), Window(4, 4, 1))
    aggregate(costs, arms, *2 * (np.zeros((9, 9), np.int64),), 2, 1)
    np.testing.assert_allclose(costs.cost[:, :, 0], 0.25, rtol=1e-5)
    assert costs.weight[4, 4, 0] == pytest.approx(24 / 49)
    assert not costs.cost[:, :, 1].any()
    assert not costs.weight[:, :, 1].any()


@twins
def test_windows_follow_a_slanted_surface() -> None:
    rng = np.random.default_rng(8)
    shape, count = (25, 40), 24
    base = (np.indices(shape)[1] // 2 + 2).astype(np.int64)
    distance = np.abs(np.arange(count) - base[:, :, None])
    cost = (np.minimum(0.2 * distance, 1.0) + rng.normal(0.0, 0.5, distance.shape)).astype(np.float32)
    arms = cross_arms(np.zeros((*shape, 3), np.uint8), Window(12, 12, 1))
    wrong = []
    for surface in (base, np.zeros_like(base)):
        costs = WeightedCosts(cost.copy(), np.ones_like(cost))
        aggregate(costs, arms, surface, np.zeros_like(base), 2, 1)
        wrong.append(int(np.count_nonzero(costs.cost.argmin(axis=2) != base)))
    assert wrong[0] == 0
    assert wrong[1] > 300
    assert np.count_nonzero(cost.argmin(axis=2) != base) > 300


COST_SHAPE = (3, 4, 5)


def costs(seed: int, weight: Any = None) -> WeightedCosts:
    rng = np.random.default_rng(seed)
    known = rng.integers(0, 2, COST_SHAPE) if weight is None else np.broadcast_to(weight, COST_SHAPE)
    return WeightedCosts(rng.random(COST_SHAPE).astype(np.float32), known.astype(np.float32).copy())


def copied(one: WeightedCosts) -> WeightedCosts:
    return WeightedCosts(one.cost.copy(), one.weight.copy())


@twins
def test_smaller_cost_of_two_that_are_known() -> None:
    first, second = costs(1), costs(2)
    found = matching_costs.smaller_costs(copied(first), second)
    both = (first.weight > 0) & (second.weight > 0)
    np.testing.assert_array_equal(found.cost[both], np.minimum(first.cost, second.cost)[both])
    for one, other in ((first, second), (second, first)):
        alone = (one.weight > 0) & (other.weight == 0)
        np.testing.assert_array_equal(found.cost[alone], one.cost[alone])
    np.testing.assert_array_equal(found.weight, np.maximum(first.weight, second.weight))


@twins
@pytest.mark.parametrize(
    ("mine", "theirs", "is_compared"),
    [(1.0, 0.6, True), (0.5, 0.9, True), (1.0, 0.4, False), (0.2, 0.5, False)],
)
def test_cost_of_which_little_is_known_does_not_count(mine: float, theirs: float, is_compared: bool) -> None:
    first, second = costs(1, mine), costs(2, theirs)
    found = matching_costs.smaller_costs(copied(first), second)
    better = first if mine > theirs else second
    expected = np.minimum(first.cost, second.cost) if is_compared else better.cost
    np.testing.assert_array_equal(found.cost, expected)
    assert set(np.unique(found.weight)) <= {np.float32(mine), np.float32(theirs)}


@twins
def test_mean_is_weighted() -> None:
    """The mean of defined costs (2.20) has the larger weight."""
    first, second = costs(3), costs(4, np.linspace(0.0, 1.0, COST_SHAPE[2]))
    found = matching_costs.mean_costs(copied(first), second)
    total = first.weight + second.weight
    known = total > 0
    expected = (first.cost * first.weight + second.cost * second.weight)[known] / total[known]
    np.testing.assert_allclose(found.cost[known], expected, rtol=1e-6)
    np.testing.assert_array_equal(found.weight, np.maximum(first.weight, second.weight))
    assert np.isfinite(found.cost).all()


@twins
def test_what_is_not_known_becomes_a_constant() -> None:
    first = costs(5)
    found = defined_costs(copied(first), 0.5, 0.1)
    assert found[first.weight == 0] == pytest.approx(0.5)
    known = first.weight == 1
    np.testing.assert_allclose(found[known], (first.cost[known] + 0.05) / 1.1, rtol=1e-6)
