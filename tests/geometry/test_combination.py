"""Combination of costs: the smaller one, the mean, and a constant for what is not known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.geometry import aggregation
from dvc.geometry.aggregation import defined_costs, mean_costs, smaller_costs
from dvc.geometry.matching_costs import WeightedCosts

SHAPE = (3, 4, 5)


@pytest.fixture(params=["compiled", "python"])
def _kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the functions on compiled kernels, and on their Python."""
    if request.param == "python":
        for name in ("_keep_smaller", "_keep_mean", "_fill_undefined"):
            function: Callable[..., Any] = python_twin(getattr(aggregation, name))
            monkeypatch.setattr(aggregation, name, function)


pytestmark = [pytest.mark.nojit, pytest.mark.usefixtures("_kind")]


def costs(seed: int, weight: Any = None) -> WeightedCosts:
    rng = np.random.default_rng(seed)
    known = rng.integers(0, 2, SHAPE) if weight is None else np.broadcast_to(weight, SHAPE)
    return WeightedCosts(rng.random(SHAPE).astype(np.float32), known.astype(np.float32).copy())


def copied(one: WeightedCosts) -> WeightedCosts:
    return WeightedCosts(one.cost.copy(), one.weight.copy())


def test_smaller_cost_of_two_that_are_known() -> None:
    """Both known: the smaller one; one known: that; none: no weight."""
    first, second = costs(1), costs(2)
    found = smaller_costs(copied(first), second)
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
    """Costs are compared if each is known half as well as the other at least; else the better known."""
    first, second = costs(1, mine), costs(2, theirs)
    found = smaller_costs(copied(first), second)
    better = first if mine > theirs else second
    expected = np.minimum(first.cost, second.cost) if is_compared else better.cost
    np.testing.assert_array_equal(found.cost, expected)
    assert set(np.unique(found.weight)) <= {np.float32(mine), np.float32(theirs)}


def test_mean_is_weighted() -> None:
    """The mean of what is known (2.20), with the larger weight."""
    first, second = costs(3), costs(4, np.linspace(0.0, 1.0, SHAPE[2]))
    found = mean_costs(copied(first), second)
    total = first.weight + second.weight
    known = total > 0
    expected = (first.cost * first.weight + second.cost * second.weight)[known] / total[known]
    np.testing.assert_allclose(found.cost[known], expected, rtol=1e-6)
    np.testing.assert_array_equal(found.weight, np.maximum(first.weight, second.weight))
    assert np.isfinite(found.cost).all()


def test_what_is_not_known_becomes_a_constant() -> None:
    """It takes part everywhere by its share, and is all there is where nothing is known."""
    first = costs(5)
    found = defined_costs(copied(first), 0.5, 0.1)
    assert found[first.weight == 0] == pytest.approx(0.5)
    known = first.weight == 1
    np.testing.assert_allclose(found[known], (first.cost[known] + 0.05) / 1.1, rtol=1e-6)
