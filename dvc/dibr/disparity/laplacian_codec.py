"""Disparity maps as wavelet trees, found and written as the thesis does it.

Coefficients have a Laplacian distribution that fits their own (3.17), (3.33), (3.34). Low-pass coefficients
have codes of fixed length, signs and magnitudes of others arithmetic ones; insignificant ones have none.

References
----------
[Maitre2008] Sections 3.3.3 to 3.3.7.
"""

from dataclasses import dataclass

import numpy as np

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.disparity_codec import Known
from dvc.dibr.disparity.distortion import Distortion
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import WaveletTree
from dvc.dibr.disparity.rate_model import search_laplacian, significant_places
from dvc.dibr.disparity.tree_codec import TreeCodec
from dvc.entropy import RangeCoder, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS


@dataclass(frozen=True)
class LaplacianCodec(TreeCodec):
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
