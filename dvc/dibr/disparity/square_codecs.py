"""Quadtree of disparities: squares of one label each, split where that is worth the bits.

The tree begins with one square around the whole map and may go down to single pixels. Leaves have labels that
are independent of each other, as in the thesis: adaptive contexts learn how frequent each label is, and how
often squares of each size are split, and the tree is pruned with the costs that follow from a first tree.

References
----------
[Sullivan1994] G. J. Sullivan, R. L. Baker, "Efficient quadtree coding of images and video", IEEE Trans. Image
Process. 3(3), 1994.
[Maitre2008] Section 3.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.disparity_codec import Candidates, Known, RangeCodedDisparities, climb
from dvc.dibr.disparity.distortion import CREDITS, Distortion
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import Labels, level_shapes, spread
from dvc.entropy import RangeCoder, context_counts

Floats = NDArray[np.float64]

NUM_ITERATIONS = 4
_SPLIT_PRIOR, _PRIOR_WEIGHT = 0.3, 4.0


@dataclass(frozen=True, eq=False)
class Quadtree:
    """A map of labels, constant in squares."""

    labels: Labels  # the map
    # which squares of side 2^j are split, for j = 1, 2, ...; False below one that is not
    splits: tuple[NDArray[np.bool_], ...]
    num_labels: int  # how many labels there are

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.labels.shape[0], self.labels.shape[1]

    def disparity(self, level: int = 0) -> Labels:
        """Return the map of labels, every 2^level-th pixel."""
        return self.labels[:: 1 << level, :: 1 << level]


@dataclass(frozen=True)
class QuadtreeCodec(RangeCodedDisparities):
    """Quadtrees of least error and bits (exactly, for the costs of labels and splits); no significance."""

    has_credits: bool = False  # whether labels that would cover holes are tried, as with wavelets
    name = "quadtree"

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> Quadtree:
        """Prune the tree, by the costs of another one, a few times."""
        tried: Candidates[Quadtree] = Candidates(tensor, multiplier, distortion)
        latest: Quadtree | None = None

        def _refine(start: Quadtree | None, sums: Sequence[Tensor], credit: float) -> bool:
            nonlocal latest
            label_bits, split_bits = _first_bits(sums) if start is None else _measured_bits(start)
            latest = prune(sums, multiplier * label_bits, multiplier * split_bits)
            return tried.offer(latest, latest.labels, len(self._write(latest, known)), credit)

        sums = square_sums(tensor)
        for _ in range(NUM_ITERATIONS):
            _refine(latest, sums, 0.0)
        if self.has_credits and distortion is not None:
            climb(CREDITS, lambda credit: _refine(tried.best, square_sums(tried.tensor(credit)), credit))
        assert tried.best is not None
        return tried.best

    def _empty(self, shape: tuple[int, int], num_labels: int, known: Known) -> Quadtree:
        splits = tuple(np.zeros(size, np.bool_) for size in level_shapes(shape)[1:])
        return Quadtree(np.zeros(shape, np.int32), splits, num_labels)

    def _code(self, coder: RangeCoder, representation: Quadtree, known: Known) -> Quadtree:
        return _code(coder, representation)


def prune(sums: Sequence[Tensor], label_costs: Floats, split_costs: Floats) -> Quadtree:
    """Find the tree of least errors and costs."""
    costs: list[Floats] = []
    leaves: list[Labels] = []
    splits: list[NDArray[np.bool_]] = []
    for level, errors in enumerate(sums):
        total = errors + label_costs.astype(np.float32)
        leaf = total.argmin(axis=2).astype(np.int32)
        cost: Floats = np.take_along_axis(total, leaf[:, :, None], 2)[:, :, 0].astype(np.float64)
        if level > 0:
            cost += split_costs[level, 0]
            below = _sum_of_squares(costs[-1][:, :, None])[:, :, 0] + split_costs[level, 1]
            splits.append(below < cost)
            cost = np.minimum(cost, below)
        costs.append(cost)
        leaves.append(leaf)
    labels: NDArray[Any] = leaves[-1]
    alive: NDArray[Any] = np.ones(leaves[-1].shape, np.bool_)
    for level in reversed(range(len(splits))):
        splits[level] &= alive
        alive = spread(splits[level], leaves[level].shape)
        labels = np.where(alive, leaves[level], spread(labels, leaves[level].shape))
    return Quadtree(labels.astype(np.int32), tuple(splits), sums[0].shape[2])


def square_sums(tensor: Tensor) -> list[Tensor]:
    """Return the errors of each label in squares of side 1, 2, 4, and so on."""
    sums = [tensor]
    while max(sums[-1].shape[:2]) > 1:
        sums.append(_sum_of_squares(sums[-1]))
    return sums


def _sum_of_squares(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Add values of 2 x 2 children; those beyond the border do not exist."""
    rows = values[0::2].copy()
    rows[: values.shape[0] // 2] += values[1::2]
    columns = rows[:, 0::2].copy()
    columns[:, : values.shape[1] // 2] += rows[:, 1::2]
    return columns


def _first_bits(sums: Sequence[Tensor]) -> tuple[Floats, Floats]:
    """Return bits as `_measured_bits` does, of which nothing is known yet."""
    num_labels = sums[0].shape[2]
    split_bits = np.tile(-np.log2([1.0 - _SPLIT_PRIOR, _SPLIT_PRIOR]), (len(sums), 1))
    return np.full(num_labels, np.log2(num_labels)), split_bits


def _measured_bits(tree: Quadtree) -> tuple[Floats, Floats]:
    """Return the bits of labels (labels,) and of leaves and splits (levels, 2), as frequent as in a tree."""
    split_bits = np.zeros((len(tree.splits) + 1, 2))
    counts = np.zeros(tree.num_labels)
    alive: NDArray[Any] = np.ones(tree.splits[-1].shape if tree.splits else tree.labels.shape, np.bool_)
    for level in reversed(range(len(tree.splits))):
        split = tree.splits[level]
        share = (split.sum() + _SPLIT_PRIOR * _PRIOR_WEIGHT) / (alive.sum() + _PRIOR_WEIGHT)
        split_bits[level + 1] = -np.log2([1.0 - share, share])
        side = 2 << level
        counts += np.bincount(tree.labels[::side, ::side][alive & ~split], minlength=tree.num_labels)
        alive = spread(split, tree.splits[level - 1].shape if level else tree.labels.shape)
    counts += np.bincount(tree.labels[alive], minlength=tree.num_labels)
    return -np.log2((counts + 0.5) / (counts.sum() + 0.5 * tree.num_labels)), split_bits


def _code(coder: RangeCoder, tree: Quadtree) -> Quadtree:
    """Code a tree, squares of one size after the other, and return that which was written or read."""
    num_digits = (tree.num_labels - 1).bit_length()
    counts = context_counts(np.full(len(tree.splits) + 1 + (1 << num_digits), 50))
    counts[: len(tree.splits) + 1] = context_counts(30)
    shapes = level_shapes(tree.shape)
    alphabet = _kernels.Alphabet(len(shapes), num_digits, tree.num_labels)
    alive: NDArray[Any] = np.ones(shapes[-1], np.bool_)
    splits: list[NDArray[np.bool_]] = []
    labels = np.zeros(shapes[-1], np.int32)
    for level in reversed(range(len(shapes))):
        split = tree.splits[level - 1].copy() if level else np.zeros(alive.shape, np.bool_)
        step = 1 << level
        given = tree.labels[::step, ::step]
        for m in range(len(alive)):
            state = coder.room_for(alive.shape[1] * (num_digits + 1))
            _kernels.code_squares(state, counts, level, alphabet, alive[m], split[m], given[m], labels[m])
        if level:
            splits.append(split)
            alive = spread(split, shapes[level - 1])
            labels = np.ascontiguousarray(spread(labels, shapes[level - 1]))
    return Quadtree(labels, tuple(splits[::-1]), tree.num_labels)
