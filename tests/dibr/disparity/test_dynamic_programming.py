"""Dynamic programming on trees: the optimum of exhaustive search, for all costs."""

import itertools

import numpy as np
import pytest

from dvc.dibr.disparity.dynamic_programming import LevelCosts, optimise_tree
from dvc.dibr.disparity.integer_transforms import (
    L_TRANSFORM,
    S_TRANSFORM,
    IntegerTransform,
    WaveletTree,
    level_shapes,
)
from dvc.dibr.disparity.rate_model import laplacian_costs
from tests.reference import dibr_disparity as reference

SHAPES = [(1, 4), (1, 3), (4, 1), (2, 2), (3, 2), (2, 3)]
KINDS = 3
NUM_CASES = 250  # for each transform, with simple and with general costs: 1,000 in all


def random_costs(rng: np.random.Generator, shape: tuple[int, int], num_labels: int) -> list[LevelCosts]:
    """Return costs of several kinds; the first kind of coefficients is not significant, nor that of nodes."""
    costs = []
    shapes = level_shapes(shape)
    for size, above in itertools.pairwise(shapes):
        table = rng.uniform(0.0, 0.4, (KINDS, 5)).astype(np.float32)
        table[:, 4] *= rng.integers(0, 2)
        table[:, 0] *= 0.5
        table[:, 1] += table[:, 0]
        table[:, 3] += table[:, 1]
        table[0] = 0.0, np.inf, np.inf, np.inf, 0.0
        merges = rng.uniform(0.0, 0.4, (KINDS, 2)).astype(np.float32)
        merges[0] = np.inf
        flags = rng.uniform(0.0, 0.3, (KINDS, 2)).astype(np.float32)
        flags[0] = 0.0, np.inf
        costs.append(
            LevelCosts(
                table,
                merges,
                flags,
                rng.integers(0, KINDS, size).astype(np.uint8),
                rng.integers(0, KINDS, above).astype(np.uint8),
                rng.integers(-1, num_labels, (*size, 2)).astype(np.int32),
            )
        )
    return costs


def random_previous(
    rng: np.random.Generator, transform: IntegerTransform, shape: tuple[int, int], num_labels: int
) -> WaveletTree:
    labels = rng.integers(0, num_labels, shape).astype(np.int32)
    return WaveletTree.of_labels(transform, labels, num_labels)


class Search:
    """All trees of a size, made once."""

    def __init__(self) -> None:
        self._trees: dict[tuple[str, tuple[int, int], int], object] = {}

    def costs(
        self,
        transform: IntegerTransform,
        tensor: np.ndarray,
        costs: list[LevelCosts],
        previous: WaveletTree | None,
    ) -> np.ndarray:
        """Return those of all trees."""
        shape, num_labels = tensor.shape[:2], tensor.shape[2]
        predictions = (
            previous.highs if previous else [np.zeros(size, int) for size in level_shapes(shape)[:-1]]
        )
        key = transform.name, shape, num_labels
        if transform is L_TRANSFORM:
            levels = self._trees.setdefault(key, reference.all_trees_l(shape, num_labels))
            differences = reference.differences_l(levels, predictions)
            return reference.total_costs(tensor.astype(float), levels, differences, costs, False)
        if key not in self._trees:
            self._trees[key] = reference.all_trees_s(shape, num_labels)
        levels, highs = self._trees[key]
        differences = [high - predicted for high, predicted in zip(highs, predictions, strict=True)]
        return reference.total_costs(tensor.astype(float), levels, differences, costs, True)


def cost_of(
    tree: WaveletTree, tensor: np.ndarray, costs: list[LevelCosts], previous: WaveletTree | None
) -> float:
    levels = [level[None].astype(int) for level in tree.levels()]
    predictions = previous.highs if previous else [np.zeros_like(high) for high in tree.highs]
    differences = [(high - predicted)[None] for high, predicted in zip(tree.highs, predictions, strict=True)]
    redundant = tree.transform is L_TRANSFORM
    return float(reference.total_costs(tensor.astype(float), levels, differences, costs, not redundant)[0])


@pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)
def test_general_costs_give_the_optimum_of_exhaustive_search(transform: IntegerTransform) -> None:
    """Zero trees, jumps, labels of neighbours, tears, kinds, predictions: the least cost of all trees."""
    rng, search = np.random.default_rng(3), Search()
    for case in range(NUM_CASES):
        shape = SHAPES[case % len(SHAPES)]
        num_labels = 2 if max(shape) * min(shape) > 4 and transform is L_TRANSFORM else 3
        tensor = rng.uniform(0.0, 1.0, (*shape, num_labels)).astype(np.float32)
        costs = random_costs(rng, shape, num_labels)
        previous = random_previous(rng, transform, shape, num_labels) if case % 2 else None
        tree, total = optimise_tree(transform, tensor, costs, previous)
        least = search.costs(transform, tensor, costs, previous).min()
        assert total == pytest.approx(least, abs=1e-5)
        assert cost_of(tree, tensor, costs, previous) == pytest.approx(least, abs=1e-5)
        assert tree.levels()[0].min() >= 0
        assert tree.levels()[0].max() < num_labels


@pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)
def test_laplacian_costs_give_the_optimum_of_exhaustive_search(transform: IntegerTransform) -> None:
    """With mu times the magnitude and random significance (3.19), the least cost of all trees."""
    rng, search = np.random.default_rng(4), Search()
    for case in range(NUM_CASES):
        shape = SHAPES[case % len(SHAPES)]
        num_labels = 2 if max(shape) * min(shape) > 4 and transform is L_TRANSFORM else 3
        tensor = rng.uniform(0.0, 1.0, (*shape, num_labels)).astype(np.float32)
        significance = [rng.integers(0, 2, size).astype(np.uint8) for size in level_shapes(shape)[1:]]
        costs = laplacian_costs(shape, significance, float(rng.uniform(0.0, 0.5)))
        tree, total = optimise_tree(transform, tensor, costs)
        assert total == pytest.approx(search.costs(transform, tensor, costs, None).min(), abs=1e-5)
        assert cost_of(tree, tensor, costs, None) == pytest.approx(total, abs=1e-5)
        for high, classes in zip(tree.highs, significance, strict=True):
            rows, columns = np.indices(high.shape) // 2
            assert not high[classes[rows, columns] == 0].any()


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
    """Of equal trees that without coefficients is taken."""
    significance = [np.ones(size, np.uint8) for size in level_shapes((6, 5))[1:]]
    tensor = np.ones((6, 5, 4), np.float32)
    for transform in (L_TRANSFORM, S_TRANSFORM):
        tree, total = optimise_tree(transform, tensor, laplacian_costs((6, 5), significance, 0.0))
        assert not any(high.any() for high in tree.highs)
        assert total == pytest.approx(30.0)


def test_no_significance_makes_constant_maps() -> None:
    """Without significant nodes the map has one label, the best for all pixels; with roots, one for each."""
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
    """With the same costs for all coefficients, L has more ways."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        tensor = rng.uniform(size=(1, 16, 6)).astype(np.float32)
        significance = [np.ones(size, np.uint8) for size in level_shapes((1, 16))[1:]]
        costs = laplacian_costs((1, 16), significance, 0.2)
        l_total, s_total = (optimise_tree(one, tensor, costs)[1] for one in (L_TRANSFORM, S_TRANSFORM))
        assert l_total <= s_total + 1e-5
