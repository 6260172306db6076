"""Disparity maps as wavelet trees: the best one for its bits, and its bytes.

The code goes scale by scale from the roots, with adaptive contexts: a flag for each node with unpredicted
coefficients below it, then the coefficients of its children. The costs of the dynamic programming follow from
the statistics of the code of the optimum before. Costs are in units of the errors: bits times lambda.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats, Mask
from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.disparity_codec import (
    CREDITS,
    Candidates,
    Classes,
    Distortion,
    Known,
    RangeCodedDisparities,
    Tensor,
    climb,
)
from dvc.dibr.disparity.integer_transforms import (
    S_TRANSFORM,
    IntegerTransform,
    Labels,
    WaveletTree,
    level_shapes,
)
from dvc.dibr.disparity.tree_optimisation import TEAR, Kinds, LevelCosts, optimise_tree
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS
from dvc.entropy.mixing import Mixture, logistic_tables

_FIRST_COUNT = 4.0
"""Weight of the initial probability of a context, in decisions."""
_FIRST_WEIGHT = 0.6
_FLAGS = 0.15, 0.45, 0.6, 0.45, 0.6
"""Initial probabilities of flags, by class of the surroundings."""
_ZEROS = 0.15, 0.4, 0.45, 0.35, 0.4
"""Initial probabilities of coefficients that are not as predicted."""
_MERGE, _DISTANCE = 0.6, 0.5
NUM_ITERATIONS = 2
"""Iterations of costs and tree before tears are tried."""
TEARS = 0.025, 0.05, 0.1, 0.2
"""Squared errors of pixels of holes to try, relative to the mean of the tensor."""
_FLAG_PRIOR, _ZERO_PRIOR, _MERGE_PRIOR, _MAGNITUDE_PRIOR = 0.3, 0.3, 0.6, 3.0
"""Probabilities and mean magnitude without any counts."""
_PRIOR_WEIGHT = 4.0
"""Weight of priors, in counts."""


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


_Result = tuple[WaveletTree, Statistics, float]
"""A tree, its statistics, and its tear."""


def open_nodes(significance: Sequence[Classes]) -> list[Mask]:
    """Return which nodes may have coefficients below them."""
    opened: list[Mask] = []
    for classes in significance:
        here = classes > 0
        opened.append(here | _any_child(opened[-1], here.shape) if opened else here)
    return opened


def _any_child(children: Mask, shape: tuple[int, ...]) -> Mask:
    """Return which nodes have a child that is marked."""
    below = np.zeros((2 * shape[0], 2 * shape[1]), np.bool_)
    below[: children.shape[0], : children.shape[1]] = children
    return np.asarray(below[0::2, 0::2] | below[0::2, 1::2] | below[1::2, 0::2] | below[1::2, 1::2])


def split_nodes(tree: WaveletTree, predictions: Sequence[Labels]) -> list[Mask]:
    """Return which nodes have coefficients below them that are not as predicted."""
    shapes = [*(high.shape for high in tree.highs), tree.roots.shape][1:]
    splits: list[Mask] = []
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
    roots = tree.roots.copy()
    if previous is not None:
        differences = context_counts(np.full(2 + 2 * NUM_EXPONENTS, 50))
        state = coder.room_for(roots.size * MAX_DECISIONS)
        _kernels.code_differences(state, differences, roots, previous.roots)
        roots = np.clip(roots, 0, tree.num_labels - 1)
    else:
        for index, label in np.ndenumerate(roots):
            roots[index] = coder.uniform(tree.num_labels, int(label))
    parents = roots
    alive, highs = np.ones(parents.shape, np.uint8), list(tree.highs)
    for level in reversed(range(len(tree.highs))):
        labels, live = levels[level].copy(), np.zeros(levels[level].shape, np.uint8)
        high = highs[level].copy()
        known = _kernels.Level(
            parents, alive, significance[level], opened[level], predictions[level], tree.num_labels
        )
        coded = _kernels.Coded(splits[level].astype(np.uint8), high, labels, live)
        counts = statistics.flags[level], statistics.coefficients[level]
        for m in range(len(parents)):
            state = coder.room_for(parents.shape[1] * _kernels.MAX_SYMBOLS)
            code_row(state, mixture, min(level, _kernels.NUM_LEVELS - 1), m, known, coded, *counts)
        if not is_s:
            high = labels - tree.transform.synthesise(parents, np.zeros_like(labels))
        highs[level], parents, alive = high, labels, live
    return WaveletTree(tree.transform, tree.num_labels, roots, tuple(highs)), statistics


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


@dataclass(frozen=True)
class WaveletCodec(RangeCodedDisparities):
    """Codec of L or S trees with an adaptive code."""

    transform: IntegerTransform  # L or S
    num_levels: int | None = None  # number of times that the map is halved; None: down to one pixel
    layered = True

    def _empty(self, shape: tuple[int, int], num_labels: int, known: Known) -> WaveletTree:
        *sizes, coarsest = level_shapes(shape, len(known.classes))
        highs = tuple(np.zeros(size, np.int32) for size in sizes)
        return WaveletTree(self.transform, num_labels, np.zeros(coarsest, np.int32), highs)

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> WaveletTree:
        classes, previous = known
        tried: Candidates[_Result] = Candidates(tensor, multiplier, distortion)
        parallax = 0.0 if distortion is None else distortion.parallax
        error_of_tears = float(tensor.mean(dtype=np.float64)) * parallax
        start = previous or self._empty((tensor.shape[0], tensor.shape[1]), tensor.shape[2], known)
        latest: _Result = start, Statistics.none(len(classes)), 0.0

        def _refine(start: _Result, tear: float = 0.0, credit: float = 0.0, is_tried: bool = True) -> bool:
            nonlocal latest
            kinds = kinds_of(start[0], classes, previous)
            costs = code_costs(multiplier, start[0].num_labels, start[1], kinds, tear * error_of_tears)
            tree, _ = optimise_tree(self.transform, tried.tensor(credit), costs, previous)
            payload, statistics = encode_tree(tree, classes, previous)
            latest = tree, statistics, tear
            return is_tried and tried.offer(latest, tree.disparity(), len(payload), credit)

        for step in range(NUM_ITERATIONS):
            _refine(latest, is_tried=distortion is None or step == NUM_ITERATIONS - 1)
        if distortion is not None:
            climb(TEARS, lambda tear: _refine(tried.best, tear))
            climb(CREDITS, lambda credit: _refine(tried.best, tried.best[2], credit))
        return tried.best[0]

    def _code(self, coder: RangeCoder, representation: WaveletTree, known: Known) -> WaveletTree:
        return code_tree(coder, representation, *known)[0]


def kinds_of(
    tree: WaveletTree, significance: Sequence[Classes], previous: WaveletTree | None = None
) -> list[tuple[Kinds, Kinds, Labels]]:
    """Return by level the kinds of the coefficients and nodes of a tree, and labels of neighbours."""
    predictions = predictions_of(tree, previous)
    levels, opened, splits = tree.levels(), open_nodes(significance), split_nodes(tree, predictions)
    kinds = []
    for level, classes in enumerate(significance):
        labels, parents = levels[level], levels[level + 1]
        of_samples, of_nodes = np.zeros(labels.shape, np.uint8), np.zeros(parents.shape, np.uint8)
        candidates = np.full((*labels.shape, 2), _kernels.NONE, np.int32)
        given = parents, labels, predictions[level], classes, splits[level].astype(np.uint8), opened[level]
        is_s = tree.transform is S_TRANSFORM
        _kernels.set_kinds(is_s, *given, of_samples, of_nodes, candidates)
        kinds.append((of_samples, of_nodes, candidates))
    return kinds


def code_costs(
    multiplier: float,
    num_labels: int,
    statistics: Statistics,
    kinds: Sequence[tuple[Kinds, Kinds, Labels]],
    tear: float = 0.0,
) -> list[LevelCosts]:
    """Return the costs of the code of `encode_tree`, from counts of its symbols."""
    coefficients, merges = _coefficient_bits(statistics.coefficients.astype(np.float64), num_labels)
    counts = statistics.flags.astype(np.float64)
    share = _shares(counts[..., 1], counts.sum(axis=-1), _FLAG_PRIOR)
    flags = -np.log2(np.stack([1.0 - share, share], axis=-1))
    flags[:, 0] = 0.0, np.inf
    tables = [np.float32(multiplier) * bits.astype(np.float32) for bits in (coefficients, flags, merges)]
    for level, table in enumerate(tables[0]):
        table[:, TEAR] = tear * 2.0**level
    return [
        LevelCosts(of_samples, table, of_nodes, flag, merge, candidates)
        for (of_samples, of_nodes, candidates), table, flag, merge in zip(kinds, *tables, strict=True)
    ]


def _coefficient_bits(counts: Floats, num_labels: int) -> tuple[Floats, Floats]:
    """Return the bits of coefficients (levels, kinds, 5), and of labels of neighbours (levels, kinds, 2)."""
    same, other = counts[..., _kernels.SAME], counts[..., _kernels.OTHER]
    merged = counts[..., _kernels.MERGED : _kernels.MERGED + 2]
    unmerged = counts[..., _kernels.UNMERGED : _kernels.UNMERGED + 2]
    changed = _shares(other, same + other, _ZERO_PRIOR)
    taken = _shares(merged, merged + unmerged, _MERGE_PRIOR)
    nonzero = -np.log2(changed)
    merges = nonzero[..., None] - np.log2(taken)
    merges[..., 1] -= np.log2(1.0 - taken[..., 0])
    asked = (merged + unmerged + 0.5) / (other[..., None] + 1.0)
    refused = -(np.minimum(asked, 1.0) * np.log2(1.0 - taken)).sum(axis=-1)
    rests, total = counts[..., _kernels.RESTS].sum(axis=1), counts[..., _kernels.MAGNITUDES].sum(axis=1)
    pooled = (total.sum() + _MAGNITUDE_PRIOR * _PRIOR_WEIGHT) / (rests.sum() + _PRIOR_WEIGHT)
    mean = (total + pooled * _PRIOR_WEIGHT) / (rests + _PRIOR_WEIGHT)
    q = mean / (1.0 + mean)
    slope = np.broadcast_to(-np.log2(q)[:, None], nonzero.shape)
    constant = nonzero + refused + 1.0 - np.log2(1.0 - q)[:, None] - slope
    jump = nonzero + refused + 2.0 + math.log2(num_labels)
    zero = np.minimum(-np.log2(1.0 - changed), constant + slope)
    bits = np.stack([zero, constant, slope, jump, np.zeros_like(jump)], axis=-1)
    insignificant = slice(0, _kernels.NUM_SURROUNDINGS)
    bits[:, insignificant] = 0.0, np.inf, np.inf, np.inf, 0.0
    merges[:, insignificant] = np.inf
    return bits, merges


def _shares(counts: Floats, totals: Floats, prior: float) -> Floats:
    """Return shares by level and kind, drawn to those of all levels, and these to a prior."""
    pooled = (counts.sum(axis=0) + prior * _PRIOR_WEIGHT) / (totals.sum(axis=0) + _PRIOR_WEIGHT)
    return np.asarray((counts + pooled * _PRIOR_WEIGHT) / (totals + _PRIOR_WEIGHT))
