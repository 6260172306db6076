"""Disparity maps as wavelet trees: the best one for its bits, and its bytes.

The costs of the dynamic programming and the statistics of the code follow from each other: from an optimum,
what coefficients cost where they are, and from these costs the next optimum, a few times. Where
it is known what maps cause when other views are rendered from them, differences of labels may cost more than
their bits, as those open holes, and labels that cover a hole less: by how much is tried.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvc.dibr.disparity.disparity_codec import Candidates, Known, RangeCodedDisparities, climb
from dvc.dibr.disparity.distortion import CREDITS, Distortion
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import IntegerTransform, WaveletTree
from dvc.dibr.disparity.rate_model import code_costs, kinds_of
from dvc.dibr.disparity.tree_coding import Statistics, code_tree, encode_tree, no_statistics
from dvc.dibr.disparity.tree_optimisation import optimise_tree
from dvc.entropy import RangeCoder

NUM_ITERATIONS = 2
"""How often costs and tree follow from each other before tears are tried."""
TEARS = 0.025, 0.05, 0.1, 0.2
"""Squared errors of pixels of holes, relative to the mean of the tensor, to choose from where it is known
what comes of them."""


@dataclass(frozen=True)
class TreeCodec(RangeCodedDisparities):
    """Trees of L or S coefficients."""

    transform: IntegerTransform  # L or S
    num_levels: int | None = None  # how often the map is halved; None: down to one pixel
    layered = True

    @property
    def name(self) -> str:  # type: ignore[override]
        """As options call it."""
        return self.transform.name

    def _empty(self, shape: tuple[int, int], num_labels: int, known: Known) -> WaveletTree:
        return WaveletTree.constant(self.transform, shape, num_labels, len(known.classes))


@dataclass(frozen=True)
class WaveletCodec(TreeCodec):
    """Trees whose code is adaptive."""

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> WaveletTree:
        """Find the best tree."""
        search = _Search(self.transform, tensor, multiplier, known, distortion)
        for step in range(NUM_ITERATIONS):
            search.refine(search.latest, is_candidate=distortion is None or step == NUM_ITERATIONS - 1)
        if distortion is not None:
            climb(TEARS, lambda tear: search.refine(search.best, tear))
            climb(CREDITS, lambda credit: search.refine(search.best, search.best.tear, credit))
        return search.best.tree

    def _code(self, coder: RangeCoder, representation: WaveletTree, known: Known) -> WaveletTree:
        return code_tree(coder, representation, *known)[0]


class _Found(NamedTuple):
    """A tree, what it is made of, and with which tears it was found."""

    tree: WaveletTree
    statistics: Statistics
    tear: float


class _Search:
    """Trees of one tensor, each by the costs that another one had, and the best of all."""

    def __init__(
        self,
        transform: IntegerTransform,
        tensor: Tensor,
        multiplier: float,
        known: Known,
        distortion: Distortion | None,
    ) -> None:
        self._transform, self._multiplier, self._known = transform, multiplier, known
        self._tried: Candidates[_Found] = Candidates(tensor, multiplier, distortion)
        parallax = 0.0 if distortion is None else distortion.parallax
        self._error_of_tears = float(tensor.mean(dtype=np.float64)) * parallax
        height, width, num_labels = tensor.shape
        nothing = WaveletTree.constant(transform, (height, width), num_labels, len(known.classes))
        self.latest = _Found(known.previous or nothing, no_statistics(len(known.classes)), 0.0)

    @property
    def best(self) -> _Found:
        """The tree of the least cost."""
        return self._tried.best or self.latest

    def refine(
        self, start: _Found, tear: float = 0.0, credit: float = 0.0, *, is_candidate: bool = True
    ) -> bool:
        """Find the best tree by the costs of another one, and keep it if it is the best so far."""
        classes, previous = self._known
        kinds = kinds_of(start.tree, classes, previous)
        costs = code_costs(
            self._multiplier, start.tree.num_labels, start.statistics, kinds, tear * self._error_of_tears
        )
        tree, _ = optimise_tree(self._transform, self._tried.tensor(credit), costs, previous)
        payload, statistics = encode_tree(tree, classes, previous)
        self.latest = _Found(tree, statistics, tear)
        return is_candidate and self._tried.offer(self.latest, tree.disparity(), len(payload), credit)
