"""Disparity codecs as the thesis has them: Laplacian coefficients, and quadtrees in codes of fixed length.

Coefficients have a Laplacian distribution that fits their own (3.17), (3.33), (3.34). Low-pass coefficients
have codes of fixed length, signs and magnitudes of the rest arithmetic ones; insignificant ones have none.

References
----------
[Maitre2008] Sections 3.3.3 to 3.3.7, Eqs. (3.17) to (3.20), (3.33) and (3.34).
[Sullivan1994] G. J. Sullivan, R. L. Baker, "Efficient quadtree coding of images and video", IEEE Trans. Image
Process. 3(3), 1994.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.disparity_codec import Classes, DisparityCodec, Distortion, Known, Tensor
from dvc.dibr.disparity.integer_transforms import (
    L_TRANSFORM,
    IntegerTransform,
    WaveletTree,
    level_shapes,
    spread,
)
from dvc.dibr.disparity.square_codecs import Quadtree, prune, square_sums
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.dibr.disparity.tree_optimisation import LevelCosts, optimise_tree
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS
from dvc.errors import BitstreamError

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
        none = np.full((*size, 2), -1, np.int32)
        costs.append(
            LevelCosts(
                np.ascontiguousarray(kind),
                coefficients,
                np.zeros_like(classes),
                flags,
                np.full((2, 2), np.inf, np.float32),
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
    """Return by level which coefficients are significant, of those that the transform has."""
    places = []
    for high, classes in zip(tree.highs, significance, strict=True):
        used = spread(classes, high.shape) > 0
        if tree.transform is not L_TRANSFORM:
            used[0::2, 0::2] = False
        places.append(used)
    return places


@dataclass(frozen=True)
class LaplacianCodec(WaveletCodec):
    """Finds, writes and reads trees as the thesis does it."""

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> WaveletTree:
        """Find the best tree for its model of the rate."""
        return search_laplacian(self.transform, tensor, multiplier, *known)[0]

    def _code(self, coder: RangeCoder, representation: WaveletTree, known: Known) -> WaveletTree:
        tree, (classes, previous) = representation, known
        roots, highs = tree.roots.copy(), [high.copy() for high in tree.highs]
        if previous is None:
            for index, label in np.ndenumerate(roots):
                roots[index] = coder.uniform(tree.num_labels, int(label))
        counts = context_counts(np.full(2 + 2 * NUM_EXPONENTS, 50))
        places = significant_places(tree, classes)
        planes = [(roots, np.ones(roots.shape, np.bool_))] if previous is not None else []
        before = [] if previous is None else [previous.roots, *previous.highs]
        planes += zip(highs, places, strict=True)
        for number, (plane, used) in enumerate(planes):
            values = plane[used][None]
            predicted = before[number][used][None] if before else np.zeros_like(values)
            state = coder.room_for(values.size * MAX_DECISIONS)
            _kernels.code_differences(state, counts, values, predicted)
            plane[used] = values[0]
            plane[~used] = before[number][~used] if before else 0
        return WaveletTree(
            self.transform, tree.num_labels, np.clip(roots, 0, tree.num_labels - 1), tuple(highs)
        )


SPLIT_BITS = 1.0
"""Bits of the flag of a square; single pixels have none."""


class FixedQuadtreeCodec(DisparityCodec):
    """Quadtrees with a bit for each split and labels of fixed length."""

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> Quadtree:
        """Prune the tree, exactly for these codes."""
        sums = square_sums(tensor)
        split_bits = np.full((len(sums), 2), SPLIT_BITS)
        split_bits[0] = 0.0
        label_bits = np.full(tensor.shape[2], float((tensor.shape[2] - 1).bit_length()))
        return prune(sums, multiplier * label_bits, multiplier * split_bits)

    def _write(self, representation: Quadtree, known: Known) -> bytes:
        """Write squares of one size after the other: which are split, and the labels of the others."""
        tree, parts = representation, []
        digits = np.arange((tree.num_labels - 1).bit_length())[::-1]
        alive: NDArray[Any] = np.ones(tree.splits[-1].shape if tree.splits else tree.labels.shape, np.bool_)
        for level in reversed(range(len(tree.splits) + 1)):
            split = tree.splits[level - 1] if level else np.zeros(alive.shape, np.bool_)
            labels = tree.labels[:: 1 << level, :: 1 << level][alive & ~split]
            parts += [split[alive]] if level else []
            parts.append((labels[:, None] >> digits & 1).ravel())
            if level:
                alive = spread(split, _below(tree, level))
        return np.packbits(np.concatenate(parts).astype(np.uint8)).tobytes()

    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> Quadtree:
        bits, place = np.unpackbits(np.frombuffer(payload, np.uint8)), 0
        shapes = level_shapes(shape)
        width = (num_labels - 1).bit_length()
        weights = 1 << np.arange(width)[::-1]
        alive: NDArray[Any] = np.ones(shapes[-1], np.bool_)
        labels, splits = np.zeros(shapes[-1], np.int32), []
        for level in reversed(range(len(shapes))):
            split = np.zeros(shapes[level], np.bool_)
            num_flags = int(alive.sum()) if level else 0
            split[alive] = _taken(bits, place, num_flags) if level else False
            leaves = alive & ~split
            place += num_flags
            count = int(leaves.sum())
            digits = _taken(bits, place, count * width).reshape(count, width)
            place += digits.size
            labels[leaves] = np.minimum(digits @ weights, num_labels - 1)
            if level:
                splits.append(split)
                alive, labels = spread(split, shapes[level - 1]), spread(labels, shapes[level - 1])
        return Quadtree(np.ascontiguousarray(labels), tuple(splits[::-1]), num_labels)


def _below(tree: Quadtree, level: int) -> tuple[int, ...]:
    return tree.splits[level - 2].shape if level > 1 else tree.labels.shape


def _taken(bits: NDArray[np.uint8], place: int, count: int) -> NDArray[np.uint8]:
    if place + count > len(bits):
        raise BitstreamError("the quadtree ends too early")
    return bits[place : place + count]
