"""Disparity maps as wavelet trees, found and written as the thesis does it.

Coefficients have a Laplacian distribution that fits their own (3.17), (3.33), (3.34). Low-pass coefficients
have codes of fixed length, signs and magnitudes of others arithmetic ones; insignificant ones have none.

References
----------
[Maitre2008] Sections 3.3.3 to 3.3.7.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvc.depthcodec.trees import _kernels
from dvc.depthcodec.trees.coding import Classes, classes_or_all
from dvc.depthcodec.trees.distortion import Distortion
from dvc.depthcodec.trees.error_tensor import Tensor
from dvc.depthcodec.trees.integer_transforms import IntegerTransform, WaveletTree, level_shapes
from dvc.depthcodec.trees.rate_model import search_laplacian, significant_places
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS


@dataclass(frozen=True)
class LaplacianCodec:
    """Finds, writes and reads trees; see `DisparityCodec`."""

    transform: IntegerTransform  # L or S
    num_levels: int | None = None  # how often the map is halved; None: down to one pixel
    layered = True

    @property
    def name(self) -> str:
        """As options call it."""
        return self.transform.name

    def optimise(
        self,
        tensor: Tensor,
        multiplier: float,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
        distortion: Distortion | None = None,
    ) -> WaveletTree:
        """Find the best tree for its model of the rate; see `DisparityCodec`."""
        classes = classes_or_all((tensor.shape[0], tensor.shape[1]), significance, self.num_levels)
        tree, _ = search_laplacian(self.transform, tensor, multiplier, classes, previous)
        return tree

    def encode(
        self,
        representation: WaveletTree,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> bytes:
        """Write a tree; see `DisparityCodec`."""
        shape = (representation.highs[0] if representation.highs else representation.roots).shape
        coder = RangeCoder.writer()
        self._code(
            coder,
            representation,
            classes_or_all((shape[0], shape[1]), significance, self.num_levels),
            previous,
        )
        return coder.to_bytes(shortest=True)

    def decode(
        self,
        payload: bytes,
        shape: tuple[int, int],
        num_labels: int,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> WaveletTree:
        """Read a tree; see `DisparityCodec`."""
        classes = classes_or_all(shape, significance, self.num_levels)
        sizes = level_shapes(shape, len(classes))
        highs = tuple(np.zeros(size, np.int32) for size in sizes[:-1])
        empty = WaveletTree(self.transform, num_labels, np.zeros(sizes[-1], np.int32), highs)
        coder = RangeCoder.reader(payload)
        tree = self._code(coder, empty, classes, previous)
        coder.check()
        return tree

    def _code(
        self, coder: RangeCoder, tree: WaveletTree, classes: Sequence[Classes], previous: WaveletTree | None
    ) -> WaveletTree:
        """Code a tree, and return that which was written or read."""
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
