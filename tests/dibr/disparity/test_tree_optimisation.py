"""Dynamic programming on trees: the optimum of exhaustive search, for all costs."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from benchmarks.baselines.thesis_disparities import laplacian_costs
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM, IntegerTransform, level_shapes
from dvc.dibr.disparity.tree_optimisation import optimise_tree
from tests.reference.dibr_trees import Case, ExhaustiveSearch, cost_of, general_cases, laplacian_cases

NUM_CASES = 250  # for each transform, with simple and with general costs: 1,000 in all


@pytest.mark.parametrize("cases", [general_cases, laplacian_cases], ids=lambda one: one.__name__)
@pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)
def test_trees_are_those_of_exhaustive_search(
    transform: IntegerTransform, cases: Callable[[IntegerTransform, int], Iterator[Case]]
) -> None:
    search = ExhaustiveSearch()
    for tensor, costs, previous in cases(transform, NUM_CASES):
        tree, total = optimise_tree(transform, tensor, costs, previous)
        assert total == search.costs(transform, tensor, costs, previous).min()
        assert cost_of(tree, tensor, costs, previous) == total
        assert tree.levels()[0].min() >= 0
        assert tree.levels()[0].max() < tensor.shape[2]
        if cases is laplacian_cases:
            for high, cost in zip(tree.highs, costs, strict=True):
                assert not high[cost.coefficient_kind == 0].any()


def test_worked_numbers() -> None:
    """The example of (3.24) to (3.26): least 0.75 at label 3, seen from label 2."""
    tensor = np.full((1, 2, 6), 10.0, np.float32)
    tensor[0, 0] = 2, 5, 3, 0.25, 4, 2
    tensor[0, 1, 2] = 0.0
    costs = laplacian_costs((1, 2), [np.ones((1, 1), np.uint8)], 0.5)
    tree, total = optimise_tree(L_TRANSFORM, tensor, costs)
    assert total == pytest.approx(0.75)
    assert tree.disparity().tolist() == [[3, 2]]


def test_what_makes_no_difference_stays_as_predicted() -> None:
    significance = [np.ones(size, np.uint8) for size in level_shapes((6, 5))[1:]]
    tensor = np.ones((6, 5, 4), np.float32)
    for transform in (L_TRANSFORM, S_TRANSFORM):
        tree, total = optimise_tree(transform, tensor, laplacian_costs((6, 5), significance, 0.0))
        assert not any(high.any() for high in tree.highs)
        assert total == pytest.approx(30.0)


def test_no_significance_makes_constant_maps() -> None:
    rng = np.random.default_rng(5)
    tensor = rng.uniform(size=(8, 12, 5)).astype(np.float32)
    for transform in (L_TRANSFORM, S_TRANSFORM):
        significance = [np.zeros(size, np.uint8) for size in level_shapes((8, 12))[1:]]
        tree, _ = optimise_tree(transform, tensor, laplacian_costs((8, 12), significance, 0.1))
        assert np.unique(tree.disparity()).tolist() == [tensor.sum(axis=(0, 1)).argmin()]
        tree, _ = optimise_tree(transform, tensor, laplacian_costs((8, 12), significance[:2], 0.1))
        best = tensor.reshape(2, 4, 3, 4, 5).sum(axis=(1, 3)).argmin(axis=2)
        np.testing.assert_array_equal(tree.roots, best)


def test_l_is_never_above_s() -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        tensor = rng.uniform(size=(1, 16, 6)).astype(np.float32)
        significance = [np.ones(size, np.uint8) for size in level_shapes((1, 16))[1:]]
        costs = laplacian_costs((1, 16), significance, 0.2)
        l_total, s_total = (optimise_tree(one, tensor, costs)[1] for one in (L_TRANSFORM, S_TRANSFORM))
        assert l_total <= s_total + 1e-5
