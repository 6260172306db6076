"""Disparity maps as wavelet trees: the best one for its bits, and its bytes.

The costs of the dynamic programming and the statistics of the code follow from each other: from an optimum,
what coefficients cost in the places where they are, and from these costs the next optimum, a few times. Where
it is known what maps cause when other views are rendered from them, differences of labels may cost more than
their bits, as those open holes: by how much is tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dvc.dibr.disparity.coding import (
    Classes,
    all_significant,
    decode_tree,
    encode_tree,
    no_statistics,
)
from dvc.dibr.disparity.distortion import Distortion, backward_error
from dvc.dibr.disparity.dynamic_programming import optimise_tree
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import IntegerTransform, WaveletTree, level_shapes
from dvc.dibr.disparity.rate_model import code_costs, kinds_of

NUM_ITERATIONS = 3
"""How often costs and tree follow from each other before smoothness is tried."""
SMOOTHNESS = 1e-3, 3e-3, 1e-2, 3e-2, 1e-1
"""Squared errors by holes, per label, to choose from where it is known what comes of them."""
MAX_FAILURES = 2
"""How many of them, one after the other, may be worse than a smaller one."""


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
        distortion: Distortion | None = None,
    ) -> WaveletTree:
        """Find the best tree; see `DisparityCodec`."""
        search = _Search(self, tensor, slope, significance, previous, distortion)
        for _ in range(NUM_ITERATIONS):
            search.refine(search.tree, 0.0)
        failures = 0
        for smoothness in SMOOTHNESS if distortion else ():
            failures = 0 if search.refine(search.best, smoothness) else failures + 1
            if failures == MAX_FAILURES:
                break
        return search.best

    def encode(
        self,
        representation: WaveletTree,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> bytes:
        """Write a tree; see `DisparityCodec`."""
        shape = (representation.highs[0] if representation.highs else representation.roots).shape
        classes = self.classes((shape[0], shape[1]), significance)
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
        classes = self.classes(shape, significance)
        return decode_tree(payload, self.transform, shape, num_labels, classes, previous)

    def classes(self, shape: tuple[int, int], significance: Sequence[Classes] | None) -> Sequence[Classes]:
        """Return classes of significance by level, where none are given those that forbid nothing.

        Parameters
        ----------
        shape : tuple of int
            Rows and columns of the map.
        significance : sequence of ndarray, uint8, or None
            What is given.

        Returns
        -------
        sequence of ndarray of shape (H_j+1, W_j+1), uint8
            Classes by level.
        """
        if significance is None:
            return all_significant(shape, self.num_levels)
        return significance[: self.num_levels]


class _Search:
    """Trees of one tensor, each by the costs that the last one had, and the best of all."""

    def __init__(
        self,
        codec: WaveletCodec,
        tensor: Tensor,
        slope: float,
        significance: Sequence[Classes] | None,
        previous: WaveletTree | None,
        distortion: Distortion | None,
    ) -> None:
        shape = tensor.shape[0], tensor.shape[1]
        self._transform, self._tensor, self._slope = codec.transform, tensor, slope
        self._classes, self._previous = codec.classes(shape, significance), previous
        self._distortion = distortion or partial(backward_error, tensor)
        self._statistics = no_statistics(len(self._classes))
        self._least = np.inf
        if previous is None:
            previous = _constant(codec.transform, shape, tensor.shape[2], len(self._classes))
        self.tree = self.best = previous

    def refine(self, tree: WaveletTree, smoothness: float) -> bool:
        """Find the best tree by the costs of another one, and tell whether it is the best so far."""
        kinds = kinds_of(tree, self._classes, self._previous)
        costs = code_costs(self._slope, tree.num_labels, self._statistics, kinds, smoothness)
        self.tree, _ = optimise_tree(self._transform, self._tensor, costs, self._previous)
        payload, self._statistics = encode_tree(self.tree, self._classes, self._previous)
        cost = self._distortion(self.tree.disparity()) + self._slope * 8 * len(payload)
        if cost >= self._least:
            return False
        self.best, self._least = self.tree, cost
        return True


def _constant(
    transform: IntegerTransform, shape: tuple[int, int], num_labels: int, num_levels: int
) -> WaveletTree:
    sizes = level_shapes(shape, num_levels)
    highs = tuple(np.zeros(size, np.int32) for size in sizes[:-1])
    return WaveletTree(transform, num_labels, np.zeros(sizes[-1], np.int32), highs)
