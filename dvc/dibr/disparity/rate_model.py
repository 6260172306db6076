"""Models of what coefficients cost: Laplacian, and as the code has them cost.

Costs are in units of the errors: bits times lambda, a squared error per pixel for each bit.

References
----------
[Maitre2008] Eqs. (3.17) to (3.20), (3.33) and (3.34).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import (
    L_TRANSFORM,
    IntegerTransform,
    WaveletTree,
    level_shapes,
    spread,
)
from dvc.dibr.disparity.tree_coding import Classes, Statistics, open_nodes, split_nodes
from dvc.dibr.disparity.tree_optimisation import LevelCosts, optimise_tree

Floats = NDArray[np.float64]

MIN_SCALE = 0.05
"""Least parameter b of the Laplacian distribution, for coefficients that are all 0."""
LAMBDA_TOLERANCE = 1e-2
"""Relative error of lambda at which the search for b ends."""


class Laplacian(NamedTuple):
    """Discrete and truncated Laplacian distribution of significant coefficients (3.17)."""

    scale: float  # b
    num_labels: int  # magnitudes are up to this

    @property
    def log2_partition(self) -> float:
        """Bits of a coefficient that is 0: the logarithm of Z."""
        q = math.exp(-1.0 / self.scale)
        return math.log2((1.0 + q - 2.0 * q ** (self.num_labels + 1)) / (1.0 - q))

    def bits(self, magnitude: Floats) -> Floats:
        """Return the bits of coefficients."""
        return self.log2_partition + magnitude / (self.scale * math.log(2.0))

    @classmethod
    def fitted(cls, magnitudes: NDArray[np.integer], num_labels: int) -> "Laplacian":
        """Return the most probable distribution of magnitudes."""
        mean = float(magnitudes.mean()) if magnitudes.size else 0.0
        if mean == 0.0:
            return cls(MIN_SCALE, num_labels)
        q = (math.sqrt(1.0 + mean * mean) - 1.0) / mean
        return cls(max(-1.0 / math.log(q), MIN_SCALE), num_labels)


def laplacian_costs(shape: tuple[int, int], significance: Sequence[Classes], mu: float) -> list[LevelCosts]:
    """Return costs of (3.19): mu times the magnitude of each coefficient, none for flags."""
    coefficients = np.array([[0.0, np.inf, np.inf, np.inf, 0.0], [0.0, 0.0, mu, np.inf, 0.0]], np.float32)
    flags = np.array([[np.inf, 0.0]], np.float32)
    costs = []
    for size, classes in zip(level_shapes(shape, len(significance)), significance, strict=False):
        kind = spread(np.minimum(classes, 1), size)
        none = np.full((*size, 2), _kernels.NONE, np.int32)
        costs.append(
            LevelCosts(
                coefficients,
                np.full((2, 2), np.inf, np.float32),
                flags,
                np.ascontiguousarray(kind),
                np.zeros_like(classes),
                none,
            )
        )
    return costs


def search_laplacian(
    transform: IntegerTransform,
    tensor: Tensor,
    multiplier: float,
    significance: Sequence[Classes],
    previous: WaveletTree | None = None,
    max_iterations: int = 12,
) -> tuple[WaveletTree, Laplacian]:
    """Find the best tree under a Laplacian distribution that fits its own coefficients (3.33), (3.34)."""
    shape, num_labels = (tensor.shape[0], tensor.shape[1]), tensor.shape[2]
    mu = multiplier / math.log(2.0)  # b = 1
    for _ in range(max_iterations):
        tree, _ = optimise_tree(transform, tensor, laplacian_costs(shape, significance, mu), previous)
        model = Laplacian.fitted(significant_magnitudes(tree, significance, previous), num_labels)
        current = mu * model.scale * math.log(2.0)
        if abs(current - multiplier) <= LAMBDA_TOLERANCE * multiplier:
            break
        mu *= multiplier / current
    return tree, model


def significant_magnitudes(
    tree: WaveletTree, significance: Sequence[Classes], previous: WaveletTree | None = None
) -> NDArray[np.int32]:
    """Return the magnitudes of coefficients that are significant, less what they are predicted to be."""
    magnitudes = []
    for level, (high, used) in enumerate(
        zip(tree.highs, significant_places(tree, significance), strict=True)
    ):
        difference = high if previous is None else high - previous.highs[level]
        magnitudes.append(np.abs(difference)[used])
    return np.concatenate(magnitudes) if magnitudes else np.empty(0, np.int32)


def significant_places(tree: WaveletTree, significance: Sequence[Classes]) -> list[NDArray[np.bool_]]:
    """Tell by level which coefficients are significant, of those that the transform has."""
    places = []
    for high, classes in zip(tree.highs, significance, strict=True):
        used = spread(classes, high.shape) > 0
        if tree.transform is not L_TRANSFORM:
            used[0::2, 0::2] = False
        places.append(used)
    return places


# ---- costs of the code itself ----

_FLAG_PRIOR = 0.3
_ZERO_PRIOR = 0.3
_MERGE_PRIOR = 0.6
_MAGNITUDE_PRIOR = 3.0
_PRIOR_WEIGHT = 4.0


def code_costs(
    multiplier: float,
    num_labels: int,
    statistics: Statistics,
    kinds: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32]]],
    tear: float = 0.0,
) -> list[LevelCosts]:
    """Return what the code of `encode_tree` costs, from how often it had what to code."""
    coefficients, merges = _coefficient_bits(statistics.coefficients.astype(np.float64), num_labels)
    flags = _flag_bits(statistics.flags.astype(np.float64))
    tables = [np.float32(multiplier) * bits.astype(np.float32) for bits in (coefficients, merges, flags)]
    for level, table in enumerate(tables[0]):
        table[:, _kernels.TEAR] = tear * 2.0**level
    return [
        LevelCosts(tables[0][level], tables[1][level], tables[2][level], *of_level)
        for level, of_level in enumerate(kinds)
    ]


def _flag_bits(counts: Floats) -> Floats:
    """Return the bits of flags of shape (levels, node kinds, 2)."""
    share = _shares(counts[..., 1], counts.sum(axis=-1), _FLAG_PRIOR)
    bits = -np.log2(np.stack([1.0 - share, share], axis=-1))
    bits[:, 0] = 0.0, np.inf
    return bits


def _coefficient_bits(counts: Floats, num_labels: int) -> tuple[Floats, Floats]:
    """Return the bits of coefficients (levels, kinds, 5), and of labels of neighbours (levels, kinds, 2)."""
    same, other, merged, unmerged = (
        counts[..., _kernels.SAME],
        counts[..., _kernels.OTHER],
        counts[..., _kernels.MERGED : _kernels.MERGED + 2],
        counts[..., _kernels.UNMERGED : _kernels.UNMERGED + 2],
    )
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
    insignificant = slice(0, _kernels.NUM_PLACES)
    bits[:, insignificant] = 0.0, np.inf, np.inf, np.inf, 0.0
    merges[:, insignificant] = np.inf
    return bits, merges


def _shares(counts: Floats, totals: Floats, prior: float) -> Floats:
    """Return shares by level and kind, drawn to those of all levels, and these to a prior one."""
    pooled = (counts.sum(axis=0) + prior * _PRIOR_WEIGHT) / (totals.sum(axis=0) + _PRIOR_WEIGHT)
    shares: Floats = (counts + pooled * _PRIOR_WEIGHT) / (totals + _PRIOR_WEIGHT)
    return shares


def kinds_of(
    tree: WaveletTree, significance: Sequence[Classes], previous: WaveletTree | None = None
) -> list[tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32]]]:
    """Return the kinds that coefficients and nodes have in a tree, and the labels beside them."""
    predictions = previous.highs if previous is not None else [np.zeros_like(high) for high in tree.highs]
    levels, opened = tree.levels(), open_nodes(significance)
    splits = split_nodes(tree, predictions)
    kinds = []
    for level, classes in enumerate(significance):
        labels, parents = levels[level], levels[level + 1]
        of_samples, of_nodes = np.zeros(labels.shape, np.uint8), np.zeros(parents.shape, np.uint8)
        candidates = np.full((*labels.shape, 2), _kernels.NONE, np.int32)
        if tree.transform is L_TRANSFORM:
            _kernels.kinds_l(parents, labels, predictions[level], classes, of_samples, candidates)
        else:
            _kernels.kinds_s(parents, labels, classes, of_samples)
        split = splits[level].astype(np.uint8)
        _kernels.kinds_of_nodes(parents, split, classes, opened[level], of_nodes)
        kinds.append((of_samples, of_nodes, candidates))
    return kinds
