"""Aggregation of costs over regions of one colour along a base surface, and combination of costs."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry import matching_costs as aggregation
from dvc.geometry.matching_costs import (
    DARK_LEVEL,
    WeightedCosts,
    Window,
    aggregate,
    cross_arms,
    defined_costs,
    evened_levels,
)
from tests.reference import cost_volumes as reference
from tests.twins import compiled_and_python

SHAPE = (7, 9)
JUMP = 20
"""A step of the base surface that is a discontinuity."""
WINDOW = Window(reach_px=5, near_reach_px=2, iterations=1)
KERNELS = "_even_steps", "_shorten_arms", "_sum_rows", "_sum_columns", "_normalise"
_kind = compiled_and_python(aggregation, *KERNELS, "smaller_costs", "mean_costs")
pytestmark = [pytest.mark.nojit, pytest.mark.usefixtures("_kind")]


def patches(rng: np.random.Generator, shape: tuple[int, int] = SHAPE) -> NDArray[np.uint8]:
    """Return a picture of flat places, slow changes and edges."""
    steps = rng.choice([0, 0, 3, 8, 25], (*shape, 3)) * rng.choice([-1, 1], (*shape, 3))
    levels: NDArray[np.uint8] = (120 + np.cumsum(steps, axis=1) % 100).astype(np.uint8)
    return levels


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


@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_weighted_means_along_a_base_surface(rng: np.random.Generator, iterations: int) -> None:
    """Labels are counted from the base, arms end at its jumps and at the first and last row."""
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


def test_region_of_one_colour_is_a_window() -> None:
    rng = np.random.default_rng(3)
    cost = rng.random((13, 15, 3))
    costs = WeightedCosts(cost.astype(np.float32), np.ones(cost.shape, np.float32))
    window = Window(4, 4, 1)
    arms, nothing = cross_arms(np.zeros((13, 15, 3), np.uint8), window), np.zeros((13, 15), np.int64)
    aggregate(costs, arms, nothing, nothing, 2, 1)
    for y, x in np.ndindex(13, 15):
        square = cost[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]
        np.testing.assert_allclose(costs.cost[y, x], square.mean(axis=(0, 1)), rtol=1e-4)
    np.testing.assert_allclose(costs.weight, 1.0, rtol=1e-6)


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


def test_smaller_cost_of_two_that_are_known() -> None:
    first, second = costs(1), costs(2)
    found = aggregation.smaller_costs(copied(first), second)
    both = (first.weight > 0) & (second.weight > 0)
    np.testing.assert_array_equal(found.cost[both], np.minimum(first.cost, second.cost)[both])
    for one, other in ((first, second), (second, first)):
        alone = (one.weight > 0) & (other.weight == 0)
        np.testing.assert_array_equal(found.cost[alone], one.cost[alone])
    np.testing.assert_array_equal(found.weight, np.maximum(first.weight, second.weight))


@pytest.mark.parametrize(
    ("mine", "theirs", "is_compared"),
    [(1.0, 0.6, True), (0.5, 0.9, True), (1.0, 0.4, False), (0.2, 0.5, False)],
)
def test_cost_of_which_little_is_known_does_not_count(mine: float, theirs: float, is_compared: bool) -> None:
    first, second = costs(1, mine), costs(2, theirs)
    found = aggregation.smaller_costs(copied(first), second)
    better = first if mine > theirs else second
    expected = np.minimum(first.cost, second.cost) if is_compared else better.cost
    np.testing.assert_array_equal(found.cost, expected)
    assert set(np.unique(found.weight)) <= {np.float32(mine), np.float32(theirs)}


def test_mean_is_weighted() -> None:
    """The mean of defined costs (2.20) has the larger weight."""
    first, second = costs(3), costs(4, np.linspace(0.0, 1.0, COST_SHAPE[2]))
    found = aggregation.mean_costs(copied(first), second)
    total = first.weight + second.weight
    known = total > 0
    expected = (first.cost * first.weight + second.cost * second.weight)[known] / total[known]
    np.testing.assert_allclose(found.cost[known], expected, rtol=1e-6)
    np.testing.assert_array_equal(found.weight, np.maximum(first.weight, second.weight))
    assert np.isfinite(found.cost).all()


def test_what_is_not_known_becomes_a_constant() -> None:
    first = costs(5)
    found = defined_costs(copied(first), 0.5, 0.1)
    assert found[first.weight == 0] == pytest.approx(0.5)
    known = first.weight == 1
    np.testing.assert_allclose(found[known], (first.cost[known] + 0.05) / 1.1, rtol=1e-6)
