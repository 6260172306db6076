"""Wavelet trees as bytes: scale by scale from the roots, with adaptive contexts.

For each node whether anything below it differs from what is predicted, then the coefficients of its children
where the reference is significant. Coefficients are 0 or not; in L those that are not may lead to the label
of a neighbour that is known already; the rest has a sign and a magnitude. Contexts are the scale, the class
of significance, and how far the neighbours known so far are from the prediction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.integer_transforms import S_TRANSFORM, Labels, WaveletTree, level_shapes
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS
from dvc.entropy.binarisation import NUM_EXPONENTS as _EXPONENTS
from dvc.entropy.mixing import Mixture, logistic_tables

Classes = NDArray[np.uint8]
"""Of nodes: 1 where the reference is significant, else 0."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """How often what was coded, by level."""

    flags: NDArray[np.int64]  # nodes without and with coefficients below
    # coefficients that were as predicted, or not; labels of neighbours taken, and not taken; the rest, and
    # the sum of their magnitudes less one each
    coefficients: NDArray[np.int64]


def no_statistics(num_levels: int) -> Statistics:
    """Return the statistics of nothing."""
    return Statistics(
        np.zeros((num_levels, _kernels.NUM_NODE_KINDS, 2), np.int64),
        np.zeros((num_levels, _kernels.NUM_COEFFICIENT_KINDS, _kernels.NUM_STATISTICS), np.int64),
    )


def all_significant(shape: tuple[int, int], num_levels: int | None = None) -> list[Classes]:
    """Return the classes of significance that forbid nothing."""
    return [np.ones(size, np.uint8) for size in level_shapes(shape, num_levels)[1:]]


def classes_or_all(
    shape: tuple[int, int], significance: Sequence[Classes] | None, num_levels: int | None = None
) -> Sequence[Classes]:
    """Return classes of significance by level, where none are given those that forbid nothing."""
    return all_significant(shape, num_levels) if significance is None else significance[:num_levels]


def open_nodes(significance: Sequence[Classes]) -> list[NDArray[np.bool_]]:
    """Tell which nodes may have coefficients, or nodes below them that may."""
    opened: list[NDArray[np.bool_]] = []
    for classes in significance:
        here = classes > 0
        opened.append(here | _any_child(opened[-1], here.shape) if opened else here)
    return opened


def _any_child(children: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Tell which nodes have a child that is marked."""
    below = np.zeros((2 * shape[0], 2 * shape[1]), np.bool_)
    below[: children.shape[0], : children.shape[1]] = children
    found: NDArray[np.bool_] = below[0::2, 0::2] | below[0::2, 1::2] | below[1::2, 0::2] | below[1::2, 1::2]
    return found


def split_nodes(tree: WaveletTree, predictions: Sequence[Labels]) -> list[NDArray[np.bool_]]:
    """Tell which nodes have any coefficient below them that is not as predicted."""
    shapes = [*(high.shape for high in tree.highs), tree.roots.shape][1:]
    splits: list[NDArray[np.bool_]] = []
    for high, predicted, shape in zip(tree.highs, predictions, shapes, strict=True):
        changed = high != predicted
        splits.append(_any_child(changed | splits[-1] if splits else changed, shape))
    return splits


def encode_tree(
    tree: WaveletTree, significance: Sequence[Classes], previous: WaveletTree | None = None
) -> tuple[bytes, Statistics]:
    """Write a tree, and count what was coded."""
    coder = RangeCoder.writer()
    _, statistics = code_tree(coder, tree, significance, previous)
    return coder.to_bytes(shortest=True), statistics


def code_tree(
    coder: RangeCoder,
    tree: WaveletTree,
    significance: Sequence[Classes],
    previous: WaveletTree | None = None,
) -> tuple[WaveletTree, Statistics]:
    """Code a tree, and return that which was written or read."""
    num_levels = len(tree.highs)
    predictions = previous.highs if previous is not None else [np.zeros_like(high) for high in tree.highs]
    levels, splits, opened = tree.levels(), split_nodes(tree, predictions), open_nodes(significance)
    statistics = no_statistics(num_levels)
    mixture = _initial_mixture()
    parents = roots = _code_roots(coder, tree, previous)
    alive, highs = np.ones(parents.shape, np.uint8), list(tree.highs)
    for level in reversed(range(num_levels)):
        labels, live = levels[level].copy(), np.zeros(levels[level].shape, np.uint8)
        split, classes = splits[level].astype(np.uint8), significance[level]
        high = highs[level].copy()
        code_row: Any = _kernels.code_row_s if tree.transform is S_TRANSFORM else _kernels.code_row_l
        model = _kernels.Model(mixture, min(level, _kernels.NUM_LEVELS - 1))
        known = _kernels.Level(parents, alive, classes, opened[level], predictions[level], tree.num_labels)
        coded = _kernels.Coded(split, high, labels, live)
        seen = _kernels.Seen(statistics.flags[level], statistics.coefficients[level])
        for m in range(len(parents)):
            state = coder.room_for(parents.shape[1] * _kernels.MAX_SYMBOLS)
            code_row(state, model, m, known, coded, seen)
        if tree.transform is not S_TRANSFORM:
            high = labels - tree.transform.synthesise(parents, np.zeros_like(labels))
        highs[level], parents, alive = high, labels, live
    return WaveletTree(tree.transform, tree.num_labels, roots, tuple(highs)), statistics


def _code_roots(coder: RangeCoder, tree: WaveletTree, previous: WaveletTree | None) -> Labels:
    """Code the low-pass coefficients of the coarsest level, or how they differ from those before."""
    roots = tree.roots.copy()
    if previous is not None:
        counts = context_counts(np.full(2 + 2 * _EXPONENTS, 50))
        state = coder.room_for(roots.size * MAX_DECISIONS)
        _kernels.code_differences(state, counts, roots, previous.roots)
        return np.clip(roots, 0, tree.num_labels - 1)
    for index, label in np.ndenumerate(roots):
        roots[index] = coder.uniform(tree.num_labels, int(label))
    return roots


_FIRST_COUNT = 4.0  # as if each context had been met so often
_FIRST_WEIGHT = 0.6
_FLAGS = 0.15, 0.45, 0.6, 0.45, 0.6  # by kind
_ZEROS = 0.15, 0.4, 0.45, 0.35, 0.4
_MERGE, _DISTANCE = 0.6, 0.5


def _initial_mixture() -> Mixture:
    """Return probabilities from which contexts start."""
    share = np.full(_kernels.NUM_CONTEXTS, 0.5)
    flags = share[_kernels.FLAGS : _kernels.ZEROS].reshape(1 + _kernels.NUM_LEVELS, _kernels.NUM_NODE_KINDS)
    flags[:, 1:] = np.tile(np.repeat(_FLAGS, 3), _kernels.NUM_CLASSES)
    zeros = share[_kernels.ZEROS : _kernels.MERGES].reshape(-1, _kernels.NUM_PLACES, 3)
    zeros[:] = np.array(_ZEROS)[:, None]
    share[_kernels.MERGES : _kernels.DISTANCES] = _MERGE
    share[_kernels.DISTANCES : _kernels.SIGNS] = _DISTANCE
    contexts = np.stack([share, np.full(share.shape, _FIRST_COUNT)], axis=1)
    return Mixture(contexts, np.full((_kernels.NUM_MIXTURES, 2), _FIRST_WEIGHT), logistic_tables())
