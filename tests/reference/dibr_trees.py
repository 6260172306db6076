"""Small disparity trees with random costs, and exhaustive search among them."""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.thesis_disparities import laplacian_costs
from dvc.dibr.disparity.integer_transforms import (
    L_TRANSFORM,
    IntegerTransform,
    Labels,
    WaveletTree,
    level_shapes,
    spread,
)
from dvc.dibr.disparity.tree_optimisation import LevelCosts
from tests.reference import dibr_disparity as reference

SHAPES = [(1, 4), (1, 3), (4, 1), (2, 2), (3, 2), (2, 3)]
KINDS = 3
UNIT = 2.0**-10
"""Errors and costs are multiples of it, so that sums in single precision are exact."""


def multiples(rng: np.random.Generator, most: float, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return random multiples of `UNIT` from 0 to below `most`."""
    return (UNIT * rng.integers(0, round(most / UNIT), shape)).astype(np.float32)


def analyse_s(samples: Labels, axis: int) -> tuple[Labels, Labels]:
    """Return means and differences of pairs along an axis (3.15)."""
    moved = np.moveaxis(samples, axis, 0)
    first, second = moved[0::2], moved[1::2]
    low = first.copy()
    low[: len(second)] = (first[: len(second)] + second) >> 1
    return np.moveaxis(low, 0, axis), np.moveaxis(first[: len(second)] - second, 0, axis)


def analysed(
    transform: IntegerTransform, labels: Labels, num_labels: int, num_levels: int | None = None
) -> WaveletTree:
    """Return the tree of a map."""
    low, highs = labels.astype(np.int32), []
    for height, width in level_shapes((labels.shape[0], labels.shape[1]), num_levels)[1:]:
        high = np.zeros(low.shape, np.int32)
        if transform is L_TRANSFORM:
            total = np.add.reduceat(np.add.reduceat(low, range(0, 2 * height, 2)), range(0, 2 * width, 2), 1)
            ones = np.ones_like(low)
            count = np.add.reduceat(np.add.reduceat(ones, range(0, 2 * height, 2)), range(0, 2 * width, 2), 1)
            samples, low = low, (total // count).astype(np.int32)
            high = samples - spread(low, samples.shape)
        else:
            vertical, high[1::2] = analyse_s(low, 0)
            low, high[0::2, 1::2] = analyse_s(vertical, 1)
        highs.append(high)
    return WaveletTree(transform, num_labels, low, tuple(highs))


def random_costs(rng: np.random.Generator, shape: tuple[int, int], num_labels: int) -> list[LevelCosts]:
    """Return costs of several kinds; the first kind of coefficients is not significant, nor that of nodes."""
    costs = []
    shapes = level_shapes(shape)
    for size, above in itertools.pairwise(shapes):
        table = multiples(rng, 0.4, (KINDS, 5))
        table[:, 4] *= rng.integers(0, 2)
        table[:, 0] *= 0.5
        table[:, 1] += table[:, 0]
        table[:, 3] += table[:, 1]
        table[0] = 0.0, np.inf, np.inf, np.inf, 0.0
        merges = multiples(rng, 0.4, (KINDS, 2))
        merges[0] = np.inf
        flags = multiples(rng, 0.3, (KINDS, 2))
        flags[0] = 0.0, np.inf
        costs.append(
            LevelCosts(
                coefficients=table,
                merges=merges,
                flags=flags,
                coefficient_kind=rng.integers(0, KINDS, size).astype(np.uint8),
                node_kind=rng.integers(0, KINDS, above).astype(np.uint8),
                candidates=rng.integers(-1, num_labels, (*size, 2)).astype(np.int32),
            )
        )
    return costs


def random_significance(rng: np.random.Generator, shape: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Return where coefficients may differ from 0."""
    return [rng.integers(0, 2, size).astype(np.uint8) for size in level_shapes(shape)[1:]]


def random_previous(
    rng: np.random.Generator, transform: IntegerTransform, shape: tuple[int, int], num_labels: int
) -> WaveletTree:
    """Return a tree to predict coefficients from."""
    labels = rng.integers(0, num_labels, shape).astype(np.int32)
    return analysed(transform, labels, num_labels)


Integers = NDArray[np.int64]
Case = tuple[NDArray[np.float32], list[LevelCosts], WaveletTree | None]


def general_cases(transform: IntegerTransform, count: int) -> Iterator[Case]:
    """Yield errors, costs of several kinds, and every other time a tree to predict from."""
    rng = np.random.default_rng(3)
    for case in range(count):
        tensor = _random_tensor(rng, transform, case)
        shape, num_labels = (tensor.shape[0], tensor.shape[1]), tensor.shape[2]
        costs = random_costs(rng, shape, num_labels)
        yield tensor, costs, random_previous(rng, transform, shape, num_labels) if case % 2 else None


def laplacian_cases(transform: IntegerTransform, count: int) -> Iterator[Case]:
    """Yield errors, and costs of mu times the magnitude where coefficients are significant (3.19)."""
    rng = np.random.default_rng(4)
    for case in range(count):
        tensor = _random_tensor(rng, transform, case)
        shape = tensor.shape[0], tensor.shape[1]
        significance = random_significance(rng, shape)
        yield tensor, laplacian_costs(shape, significance, float(multiples(rng, 0.5, ()))), None


def _random_tensor(rng: np.random.Generator, transform: IntegerTransform, case: int) -> NDArray[np.float32]:
    """Return errors of as many labels as all trees can be searched with."""
    shape = SHAPES[case % len(SHAPES)]
    num_labels = 2 if shape[0] * shape[1] > 4 and transform is L_TRANSFORM else 3
    return multiples(rng, 1.0, (*shape, num_labels))


class ExhaustiveSearch:
    """All trees of a size, made once."""

    def __init__(self) -> None:
        self._trees: dict[tuple[str, tuple[int, int], int], tuple[list[Integers], list[Integers]]] = {}

    def costs(
        self,
        transform: IntegerTransform,
        tensor: NDArray[np.float32],
        costs: list[LevelCosts],
        previous: WaveletTree | None,
    ) -> NDArray[np.float64]:
        """Return those of all trees."""
        shape, num_labels = tensor.shape[:2], tensor.shape[2]
        predictions = (
            previous.highs if previous else [np.zeros(size, int) for size in level_shapes(shape)[:-1]]
        )
        key = transform.name, shape, num_labels
        if transform is L_TRANSFORM:
            if key not in self._trees:
                self._trees[key] = reference.all_trees_l(shape, num_labels), []
            levels, _ = self._trees[key]
            differences = reference.differences_l(levels, predictions)
            return reference.total_costs(tensor.astype(float), levels, differences, costs, False)
        if key not in self._trees:
            self._trees[key] = reference.all_trees_s(shape, num_labels)
        levels, highs = self._trees[key]
        differences = [high - predicted for high, predicted in zip(highs, predictions, strict=True)]
        return reference.total_costs(tensor.astype(float), levels, differences, costs, True)


def cost_of(
    tree: WaveletTree, tensor: NDArray[np.float32], costs: list[LevelCosts], previous: WaveletTree | None
) -> float:
    """Return the cost of one tree."""
    levels = [level[None].astype(int) for level in tree.levels()]
    predictions = previous.highs if previous else [np.zeros_like(high) for high in tree.highs]
    differences = [(high - predicted)[None] for high, predicted in zip(tree.highs, predictions, strict=True)]
    redundant = tree.transform is L_TRANSFORM
    return float(reference.total_costs(tensor.astype(float), levels, differences, costs, not redundant)[0])
