"""Disparity maps of squares with one label each: quadtrees [Sullivan1994], and blocks of one size.

Labels of leaves are independent of each other, as in the thesis [Maitre2008]: adaptive contexts learn their
frequencies, and those of splits of squares of each size. The tree is pruned with the costs of a first tree.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats
from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.disparity_codec import (
    CREDITS,
    Candidates,
    DisparityCodec,
    Distortion,
    Known,
    RangeCodedDisparities,
    Tensor,
    climb,
)
from dvc.dibr.disparity.integer_transforms import Labels, level_shapes, spread
from dvc.entropy import RangeCoder, context_counts
from dvc.errors import BitstreamError

SIDE_PX = 8
"""Side of blocks."""
NUM_ITERATIONS = 4
"""Iterations of costs and tree."""
_SPLIT_PRIOR, _PRIOR_WEIGHT = 0.3, 4.0


@dataclass(frozen=True, eq=False)
class Quadtree:
    """A map of labels, constant in squares."""

    labels: Labels  # the map
    # splits of squares of side 2^j, for j = 1, 2, ...; False below a leaf; none for blocks of one size
    splits: tuple[NDArray[np.bool_], ...]
    num_labels: int  # number of labels

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.labels.shape[0], self.labels.shape[1]

    def disparity(self, level: int = 0) -> Labels:
        """Return the map of labels, every 2^level-th pixel."""
        return self.labels[:: 1 << level, :: 1 << level]


@dataclass(frozen=True)
class QuadtreeCodec(RangeCodedDisparities):
    """Codec of quadtrees of least error and bits, exactly for their costs; no significance."""

    has_credits: bool = False  # try labels that would cover holes, as wavelets do

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> Quadtree:
        tried: Candidates[Quadtree] = Candidates(tensor, multiplier, distortion)
        sums, num_labels = square_sums(tensor), tensor.shape[2]
        split_bits = np.tile(-np.log2([1.0 - _SPLIT_PRIOR, _SPLIT_PRIOR]), (len(sums), 1))
        bits = np.full(num_labels, np.log2(num_labels)), split_bits

        latest: Quadtree

        def _refine(bits: tuple[Floats, Floats], sums: Sequence[Tensor], credit: float = 0.0) -> bool:
            nonlocal latest
            latest = prune(sums, multiplier * bits[0], multiplier * bits[1])
            return tried.offer(latest, latest.labels, len(self._write(latest, known)), credit)

        for _ in range(NUM_ITERATIONS):
            _refine(bits, sums)
            bits = _measured_bits(latest)
        if self.has_credits and distortion is not None:
            climb(
                CREDITS,
                lambda credit: _refine(_measured_bits(tried.best), square_sums(tried.tensor(credit)), credit),
            )
        return tried.best

    def _empty(self, shape: tuple[int, int], num_labels: int, known: Known) -> Quadtree:
        splits = tuple(np.zeros(size, np.bool_) for size in level_shapes(shape)[1:])
        return Quadtree(np.zeros(shape, np.int32), splits, num_labels)

    def _code(self, coder: RangeCoder, representation: Quadtree, known: Known) -> Quadtree:
        num_digits = (representation.num_labels - 1).bit_length()
        counts = context_counts(np.full(len(representation.splits) + 1 + (1 << num_digits), 50))
        counts[: len(representation.splits) + 1] = context_counts(30)
        shapes = level_shapes(representation.shape)
        alphabet = len(shapes), num_digits, representation.num_labels
        alive: NDArray[Any] = np.ones(shapes[-1], np.bool_)
        splits: list[NDArray[np.bool_]] = []
        labels = np.zeros(shapes[-1], np.int32)
        for level in reversed(range(len(shapes))):
            split = representation.splits[level - 1].copy() if level else np.zeros(alive.shape, np.bool_)
            step = 1 << level
            given = np.ascontiguousarray(representation.labels[::step, ::step])
            for m in range(len(alive)):
                state = coder.room_for(alive.shape[1] * (num_digits + 1))
                row = alive[m], split[m], given[m], labels[m]
                _kernels.code_squares(state, counts, level, *alphabet, *row)
            if level:
                splits.append(split)
                alive = spread(split, shapes[level - 1])
                labels = np.ascontiguousarray(spread(labels, shapes[level - 1]))
        return Quadtree(labels, tuple(splits[::-1]), representation.num_labels)


def prune(sums: Sequence[Tensor], label_costs: Floats, split_costs: Floats) -> Quadtree:
    """Return the tree of least errors and costs."""
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
    """Add values of 2 x 2 children; children beyond the border do not exist."""
    rows = values[0::2].copy()
    rows[: values.shape[0] // 2] += values[1::2]
    columns = rows[:, 0::2].copy()
    columns[:, : values.shape[1] // 2] += rows[:, 1::2]
    return columns


def _measured_bits(tree: Quadtree) -> tuple[Floats, Floats]:
    """Return the bits of labels (labels,) and of leaves and splits (levels, 2) by frequency."""
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


class BlockCodec(DisparityCodec):
    """Codec of blocks of least squared error, without lambda and significance."""

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> Quadtree:
        sums = np.add.reduceat(tensor, np.arange(0, tensor.shape[0], SIDE_PX), axis=0)
        sums = np.add.reduceat(sums, np.arange(0, tensor.shape[1], SIDE_PX), axis=1)
        return _of_blocks(sums.argmin(axis=2), (tensor.shape[0], tensor.shape[1]), tensor.shape[2])

    def _write(self, representation: Quadtree, known: Known) -> bytes:
        width = (representation.num_labels - 1).bit_length()
        blocks = representation.labels[::SIDE_PX, ::SIDE_PX]
        digits = blocks.ravel()[:, None] >> np.arange(width)[::-1] & 1
        return np.packbits(digits.astype(np.uint8)).tobytes()

    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> Quadtree:
        width = (num_labels - 1).bit_length()
        blocks = -(-shape[0] // SIDE_PX), -(-shape[1] // SIDE_PX)
        count = blocks[0] * blocks[1] * width
        if len(payload) != -(-count // 8):
            raise BitstreamError(f"the labels of blocks are {len(payload)} bytes, not {-(-count // 8)}")
        digits = np.unpackbits(np.frombuffer(payload, np.uint8))[:count].reshape(*blocks, width)
        labels = digits @ (1 << np.arange(width)[::-1])
        if labels.size and labels.max() >= num_labels:
            raise BitstreamError(f"a block has label {labels.max()} of {num_labels}")
        return _of_blocks(labels, shape, num_labels)


def _of_blocks(labels: NDArray[np.integer], shape: tuple[int, int], num_labels: int) -> Quadtree:
    full = labels.astype(np.int32).repeat(SIDE_PX, axis=0).repeat(SIDE_PX, axis=1)
    return Quadtree(full[: shape[0], : shape[1]], (), num_labels)
