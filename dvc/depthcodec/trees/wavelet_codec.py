"""Disparity maps as wavelet trees: the best one for its bits, and its bytes.

The costs of the dynamic programming and the statistics of the code follow from each other: from an optimum,
what coefficients cost where they are, and from these costs the next optimum, a few times. Where
it is known what maps cause when other views are rendered from them, differences of labels may cost more than
their bits, as those open holes, and labels that cover a hole less: by how much is tried.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvc.depthcodec.trees.coding import (
    Classes,
    Statistics,
    classes_or_all,
    decode_tree,
    encode_tree,
    no_statistics,
)
from dvc.depthcodec.trees.distortion import (
    CREDITS,
    MAX_FAILURES,
    Distortion,
    Holes,
    backward_error,
    still_worth_covering,
)
from dvc.depthcodec.trees.dynamic_programming import optimise_tree
from dvc.depthcodec.trees.error_tensor import Tensor
from dvc.depthcodec.trees.integer_transforms import (
    IntegerTransform,
    Labels,
    WaveletTree,
    level_shapes,
)
from dvc.depthcodec.trees.rate_model import code_costs, kinds_of

NUM_ITERATIONS = 2
"""How often costs and tree follow from each other before tears are tried."""
TEARS = 0.025, 0.05, 0.1, 0.2
"""Squared errors of pixels of holes, relative to the mean of the tensor, to choose from where it is known
what comes of them."""


@dataclass(frozen=True)
class WaveletCodec:
    """Trees of L or S coefficients."""

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
        """Find the best tree; see `DisparityCodec`."""
        search = _Search(self, tensor, multiplier, significance, previous, distortion)
        for step in range(NUM_ITERATIONS):
            search.refine(search.latest, is_candidate=distortion is None or step == NUM_ITERATIONS - 1)
        if distortion is not None:
            search.climb((tear, 0.0) for tear in TEARS)
            search.climb((search.best.tear, credit) for credit in CREDITS)
        return search.best.tree

    def encode(
        self,
        representation: WaveletTree,
        significance: Sequence[Classes] | None = None,
        previous: WaveletTree | None = None,
    ) -> bytes:
        """Write a tree; see `DisparityCodec`."""
        shape = (representation.highs[0] if representation.highs else representation.roots).shape
        classes = classes_or_all((shape[0], shape[1]), significance, self.num_levels)
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
        classes = classes_or_all(shape, significance, self.num_levels)
        return decode_tree(payload, self.transform, shape, num_labels, classes, previous)


class _Found(NamedTuple):
    """A tree: what it costs and is made of, with which tears it was found, and what is worth covering."""

    tree: WaveletTree
    cost: float
    statistics: Statistics
    tear: float
    holes: list[Holes]


class _Search:
    """Trees of one tensor, each by the costs that the last one had, and the best of all."""

    def __init__(
        self,
        codec: WaveletCodec,
        tensor: Tensor,
        multiplier: float,
        significance: Sequence[Classes] | None,
        previous: WaveletTree | None,
        distortion: Distortion | None,
    ) -> None:
        shape = tensor.shape[0], tensor.shape[1]
        self._transform, self._tensor, self._multiplier = codec.transform, tensor, multiplier
        self._classes = classes_or_all(shape, significance, codec.num_levels)
        self._previous = previous
        self._distortion = distortion
        self._error_of_tears = (
            float(tensor.mean(dtype=np.float64)) * distortion.parallax if distortion is not None else 0.0
        )
        if previous is None:
            previous = _constant(codec.transform, shape, tensor.shape[2], len(self._classes))
        nothing = no_statistics(len(self._classes))
        self.latest = self.best = _Found(previous, np.inf, nothing, 0.0, [])

    def climb(self, steps: Iterable[tuple[float, float]]) -> None:
        """Refine the best tree with tears and credits, until several in a row do no good."""
        num_failures = 0
        for tear, credit in steps:
            num_failures = 0 if self.refine(self.best, tear, credit) else num_failures + 1
            if num_failures == MAX_FAILURES:
                break

    def refine(
        self, start: _Found, tear: float = 0.0, credit: float = 0.0, *, is_candidate: bool = True
    ) -> bool:
        """Find the best tree by the costs of another one, and keep it if it is the best so far."""
        tensor = self._tensor
        if credit > 0.0 and self._distortion is not None:
            tensor = self._distortion.claimed(tensor, self.best.holes, credit)
        kinds = kinds_of(start.tree, self._classes, self._previous)
        costs = code_costs(
            self._multiplier, start.tree.num_labels, start.statistics, kinds, tear * self._error_of_tears
        )
        tree, _ = optimise_tree(self._transform, tensor, costs, self._previous)
        payload, statistics = encode_tree(tree, self._classes, self._previous)
        error, holes = self._measured(tree.disparity()) if is_candidate else (np.inf, [])
        if credit > 0.0:
            holes = still_worth_covering(holes, self.best.holes)
        cost = error + self._multiplier * 8 * len(payload)
        self.latest = _Found(tree, cost, statistics, tear, holes)
        is_better = cost < self.best.cost
        if is_better:
            self.best = self.latest
        return is_better

    def _measured(self, labels: Labels) -> tuple[float, list[Holes]]:
        if self._distortion is None:
            return backward_error(self._tensor, labels), []
        return self._distortion.measure(labels)


def _constant(
    transform: IntegerTransform, shape: tuple[int, int], num_labels: int, num_levels: int
) -> WaveletTree:
    sizes = level_shapes(shape, num_levels)
    highs = tuple(np.zeros(size, np.int32) for size in sizes[:-1])
    return WaveletTree(transform, num_labels, np.zeros(sizes[-1], np.int32), highs)
