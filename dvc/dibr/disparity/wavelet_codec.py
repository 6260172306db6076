"""Disparity maps as wavelet trees: the best one for its bits, and its bytes.

The costs of the dynamic programming and the statistics of the code follow from each other: from an optimum,
what coefficients cost in the places where they are, and from these costs the next optimum, a few times.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvc.dibr.disparity.coding import (
    Classes,
    all_significant,
    decode_tree,
    encode_tree,
    no_statistics,
)
from dvc.dibr.disparity.dynamic_programming import optimise_tree
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import IntegerTransform, WaveletTree, level_shapes
from dvc.dibr.disparity.rate_model import code_costs, kinds_of

NUM_ITERATIONS = 4


@dataclass(frozen=True)
class WaveletCodec:
    """Trees of L or S coefficients.

    Attributes
    ----------
    transform : IntegerTransform
        L or S.
    num_levels : int or None
        How often the map is halved; None: down to one pixel.
    """

    transform: IntegerTransform
    num_levels: int | None = None
    layered = True

    @property
    def name(self) -> str:
        """As options call it."""
        return self.transform.name

    def optimise(
        self,
        tensor: Tensor,
        slope: float,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> WaveletTree:
        """Find the best tree; see `DisparityCodec`."""
        shape, num_labels = (tensor.shape[0], tensor.shape[1]), tensor.shape[2]
        classes = self._classes(shape, significance)
        tree = (
            previous if previous is not None else _constant(self.transform, shape, num_labels, len(classes))
        )
        statistics = no_statistics(len(classes))
        best, least = tree, np.inf
        for _ in range(NUM_ITERATIONS):
            costs = code_costs(slope, num_labels, statistics, kinds_of(tree, classes, previous))
            tree, _ = optimise_tree(self.transform, tensor, costs, previous)
            payload, statistics = encode_tree(tree, classes, previous)
            errors = np.take_along_axis(tensor, tree.disparity()[:, :, None], 2).sum(dtype=np.float64)
            cost = errors + slope * 8 * len(payload)
            if cost < least:
                best, least = tree, cost
        return best

    def encode(
        self,
        representation: WaveletTree,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> bytes:
        """Write a tree; see `DisparityCodec`."""
        shape = (representation.highs[0] if representation.highs else representation.roots).shape
        classes = self._classes((shape[0], shape[1]), significance)
        return encode_tree(representation, classes, previous)[0]

    def decode(
        self,
        payload: bytes,
        shape: tuple[int, int],
        num_labels: int,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> WaveletTree:
        """Read a tree; see `DisparityCodec`."""
        classes = self._classes(shape, significance)
        return decode_tree(payload, self.transform, shape, num_labels, classes, previous)

    def _classes(self, shape: tuple[int, int], significance: Sequence[Classes] | None) -> Sequence[Classes]:
        return all_significant(shape, self.num_levels) if significance is None else significance


def _constant(
    transform: IntegerTransform, shape: tuple[int, int], num_labels: int, num_levels: int
) -> WaveletTree:
    sizes = level_shapes(shape, num_levels)
    highs = tuple(np.zeros(size, np.int32) for size in sizes[:-1])
    return WaveletTree(transform, num_labels, np.zeros(sizes[-1], np.int32), highs)
