"""Wavelet trees as bytes: scale by scale from the roots, with adaptive contexts.

The code has a flag for each node that has coefficients below it which are not as predicted, then the
coefficients of its children, if the reference is significant there. A coefficient is 0 or not; in L one that
is not may lead to the label of a decoded neighbour; the rest has a sign and a magnitude. Contexts are the
scale, the class of significance, and the distance of the decoded neighbours from the prediction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.integer_transforms import S_TRANSFORM, Labels, WaveletTree, level_shapes
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS
from dvc.entropy.mixing import Mixture, logistic_tables

Classes = NDArray[np.uint8]
"""Classes of nodes: 1 if the reference is significant, else 0."""
Bools = NDArray[np.bool_]

_FIRST_COUNT = 4.0
"""Weight of the initial probability of a context, in decisions."""
_FIRST_WEIGHT = 0.6
_FLAGS = 0.15, 0.45, 0.6, 0.45, 0.6
"""Initial probabilities of flags, by class of the surroundings."""
_ZEROS = 0.15, 0.4, 0.45, 0.35, 0.4
"""Initial probabilities of coefficients that are not as predicted."""
_MERGE, _DISTANCE = 0.6, 0.5


@dataclass(frozen=True, eq=False)
class Statistics:
    """Counts of coded symbols, by level and kind."""

    flags: NDArray[np.int64]  # nodes without and with coefficients below
    # coefficients that were as predicted, or not; labels of neighbours taken, and not taken; the rest, and
    # the sum of their magnitudes less one each
    coefficients: NDArray[np.int64]

    @classmethod
    def none(cls, num_levels: int) -> "Statistics":
        """Return counts of zero."""
        return cls(
            np.zeros((num_levels, _kernels.NUM_NODE_KINDS, 2), np.int64),
            np.zeros((num_levels, _kernels.NUM_COEFFICIENT_KINDS, _kernels.NUM_STATISTICS), np.int64),
        )


def all_significant(shape: tuple[int, int], num_levels: int | None = None) -> list[Classes]:
    """Return classes of significance that forbid nothing."""
    return [np.ones(size, np.uint8) for size in level_shapes(shape, num_levels)[1:]]


def open_nodes(significance: Sequence[Classes]) -> list[Bools]:
    """Return which nodes may have coefficients below them."""
    opened: list[Bools] = []
    for classes in significance:
        here = classes > 0
        opened.append(here | _any_child(opened[-1], here.shape) if opened else here)
    return opened


def _any_child(children: Bools, shape: tuple[int, ...]) -> Bools:
    """Return which nodes have a child that is marked."""
    below = np.zeros((2 * shape[0], 2 * shape[1]), np.bool_)
    below[: children.shape[0], : children.shape[1]] = children
    return np.asarray(below[0::2, 0::2] | below[0::2, 1::2] | below[1::2, 0::2] | below[1::2, 1::2])


def split_nodes(tree: WaveletTree, predictions: Sequence[Labels]) -> list[Bools]:
    """Return which nodes have coefficients below them that are not as predicted."""
    shapes = [*(high.shape for high in tree.highs), tree.roots.shape][1:]
    splits: list[Bools] = []
    for high, predicted, shape in zip(tree.highs, predictions, shapes, strict=True):
        changed = high != predicted
        splits.append(_any_child(changed | splits[-1] if splits else changed, shape))
    return splits


def predictions_of(tree: WaveletTree, previous: WaveletTree | None) -> Sequence[Labels]:
    """Return the predictions of the coefficients of a tree: those of the layer before, or 0."""
    return [np.zeros_like(high) for high in tree.highs] if previous is None else previous.highs


def encode_tree(
    tree: WaveletTree, significance: Sequence[Classes], previous: WaveletTree | None = None
) -> tuple[bytes, Statistics]:
    """Write a tree, and count its symbols."""
    coder = RangeCoder.writer()
    _, statistics = code_tree(coder, tree, significance, previous)
    return coder.to_bytes(shortest=True), statistics


def code_tree(
    coder: RangeCoder,
    tree: WaveletTree,
    significance: Sequence[Classes],
    previous: WaveletTree | None = None,
) -> tuple[WaveletTree, Statistics]:
    """Write a tree, or read one into its shape; return it and the counts of its symbols."""
    predictions = predictions_of(tree, previous)
    levels, splits, opened = tree.levels(), split_nodes(tree, predictions), open_nodes(significance)
    statistics = Statistics.none(len(tree.highs))
    mixture = _initial_mixture()
    is_s = tree.transform is S_TRANSFORM
    code_row: Any = _kernels.code_row_s if is_s else _kernels.code_row_l
    parents = roots = code_roots(coder, tree, previous)
    alive, highs = np.ones(parents.shape, np.uint8), list(tree.highs)
    for level in reversed(range(len(tree.highs))):
        labels, live = levels[level].copy(), np.zeros(levels[level].shape, np.uint8)
        high = highs[level].copy()
        model = _kernels.Model(mixture, min(level, _kernels.NUM_LEVELS - 1))
        known = _kernels.Level(
            parents, alive, significance[level], opened[level], predictions[level], tree.num_labels
        )
        coded = _kernels.Coded(splits[level].astype(np.uint8), high, labels, live)
        counts = _kernels.Counts(statistics.flags[level], statistics.coefficients[level])
        for m in range(len(parents)):
            state = coder.room_for(parents.shape[1] * _kernels.MAX_SYMBOLS)
            code_row(state, model, m, known, coded, counts)
        if not is_s:
            high = labels - tree.transform.synthesise(parents, np.zeros_like(labels))
        highs[level], parents, alive = high, labels, live
    return WaveletTree(tree.transform, tree.num_labels, roots, tuple(highs)), statistics


def code_roots(coder: RangeCoder, tree: WaveletTree, previous: WaveletTree | None) -> Labels:
    """Code the low-pass coefficients of the coarsest level, or their differences from the layer before."""
    roots = tree.roots.copy()
    if previous is not None:
        counts = context_counts(np.full(2 + 2 * NUM_EXPONENTS, 50))
        state = coder.room_for(roots.size * MAX_DECISIONS)
        _kernels.code_differences(state, counts, roots, previous.roots)
        return np.clip(roots, 0, tree.num_labels - 1)
    for index, label in np.ndenumerate(roots):
        roots[index] = coder.uniform(tree.num_labels, int(label))
    return roots


def _initial_mixture() -> Mixture:
    """Return the initial probabilities of all contexts."""
    share = np.full(_kernels.NUM_CONTEXTS, 0.5)
    flags = share[_kernels.FLAGS : _kernels.ZEROS].reshape(1 + _kernels.NUM_LEVELS, _kernels.NUM_NODE_KINDS)
    flags[:, 1:] = np.tile(np.repeat(_FLAGS, 3), _kernels.NUM_CLASSES)
    zeros = share[_kernels.ZEROS : _kernels.MERGES].reshape(-1, _kernels.NUM_SURROUNDINGS, 3)
    zeros[:] = np.array(_ZEROS)[:, None]
    share[_kernels.MERGES : _kernels.DISTANCES] = _MERGE
    share[_kernels.DISTANCES : _kernels.SIGNS] = _DISTANCE
    contexts = np.stack([share, np.full(share.shape, _FIRST_COUNT)], axis=1)
    return Mixture(contexts, np.full((_kernels.NUM_MIXTURES, 2), _FIRST_WEIGHT), logistic_tables())
