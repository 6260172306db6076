"""Quadtree of disparities in codes of fixed length: the best one for its bits.

References
----------
[Sullivan1994] G. J. Sullivan, R. L. Baker, "Efficient quadtree coding of images and video", IEEE Trans. Image
Process. 3(3), 1994.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.blocks import bits_of_label
from dvc.dibr.disparity.disparity_codec import DisparityCodec, Known
from dvc.dibr.disparity.distortion import Distortion
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import level_shapes, spread
from dvc.dibr.disparity.square_codecs import Quadtree, prune, square_sums
from dvc.errors import BitstreamError

SPLIT_BITS = 1.0
"""Of telling whether a square is split; single pixels are not asked."""


class FixedQuadtreeCodec(DisparityCodec):
    """Quadtrees with a bit for each split and labels of fixed length."""

    name = "quadtree"

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> Quadtree:
        """Prune the tree, exactly for these codes."""
        sums = square_sums(tensor)
        split_bits = np.full((len(sums), 2), SPLIT_BITS)
        split_bits[0] = 0.0
        label_bits = np.full(tensor.shape[2], float(bits_of_label(tensor.shape[2])))
        return prune(sums, multiplier * label_bits, multiplier * split_bits)

    def _write(self, representation: Quadtree, known: Known) -> bytes:
        """Write squares of one size after the other: which are split, and the labels of the others."""
        tree, parts = representation, []
        digits = np.arange(bits_of_label(tree.num_labels))[::-1]
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
        width = bits_of_label(num_labels)
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
