"""Best wavelet coefficients of a disparity map for their bits, by dynamic programming on their tree.

From the leaves up, the least cost of all that is below a node is found for each of its labels; back from the
roots, the coefficients that reach it. The optimum is exact for the costs given. A node whose coefficients are
all as predicted may say so at once (a zero tree), which is one more way for it to have a label.

References
----------
[Maitre2008] Sections 3.3.4, 3.3.5 and 3.3.7, Eqs. (3.19) to (3.32), (3.36).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import (
    S_TRANSFORM,
    IntegerTransform,
    Labels,
    WaveletTree,
    level_shapes,
)

Kinds = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class LevelCosts:
    """What the coefficients of one level cost, and saying that there are any, in units of the errors."""

    # cost of a coefficient that is as predicted; constant and slope of a cost linear in how far it is from
    # that; a cost that is enough for any; and a slope that is added to all three and to `merges`. The first
    # is not above the sum of the next two
    coefficients: NDArray[np.float32]
    # cost of a coefficient that leads to one of the labels in `candidates` (L only)
    merges: NDArray[np.float32]
    flags: NDArray[np.float32]  # cost of a node of the next level, without coefficients below it and with
    coefficient_kind: Kinds  # kind of each coefficient
    node_kind: Kinds  # kind of each node of the next level
    candidates: Labels  # labels, or -1

    def given(self, predictions: Labels) -> _kernels.Costs:
        """Return what the kernels take, with the coefficients that are predicted."""
        of_nodes = self.node_kind, self.flags
        return _kernels.Costs(
            predictions, self.coefficient_kind, self.coefficients, *of_nodes, self.merges, self.candidates
        )


def optimise_tree(
    transform: IntegerTransform,
    tensor: Tensor,
    costs: Sequence[LevelCosts],
    previous: WaveletTree | None = None,
) -> tuple[WaveletTree, float]:
    """Find the tree of least errors and costs."""
    shapes = level_shapes((tensor.shape[0], tensor.shape[1]), len(costs))
    predictions = (
        previous.highs if previous is not None else tuple(np.zeros(shape, np.int32) for shape in shapes[:-1])
    )
    pyramid, total = _bottom_up(transform, tensor, costs, predictions, shapes)
    roots = pyramid[-1][0].argmin(axis=2).astype(np.int32)
    total += float(pyramid[-1][0].min(axis=2).sum(dtype=np.float64))
    highs = _top_down(transform, pyramid, costs, predictions, roots)
    return WaveletTree(transform, tensor.shape[2], roots, highs), total


def _bottom_up(
    transform: IntegerTransform,
    tensor: Tensor,
    costs: Sequence[LevelCosts],
    predictions: Sequence[Labels],
    shapes: Sequence[tuple[int, int]],
) -> tuple[list[tuple[Tensor, Tensor]], float]:
    """Return least errors of labels by level, in all and without coefficients, and what was subtracted."""
    pyramid, total = [(tensor, tensor)], 0.0
    for level, shape in enumerate(shapes[1:]):
        errors = [np.empty((*shape, tensor.shape[2]), np.float32) for _ in range(2)]
        cost = costs[level]
        pass_up: Any = _kernels.pass_up_s if transform is S_TRANSFORM else _kernels.pass_up_l
        total += pass_up(_kernels.Errors(*pyramid[-1]), cost.given(predictions[level]), *errors)
        pyramid.append((errors[0], errors[1]))
    return pyramid, total


def _top_down(
    transform: IntegerTransform,
    pyramid: Sequence[tuple[Tensor, Tensor]],
    costs: Sequence[LevelCosts],
    predictions: Sequence[Labels],
    roots: Labels,
) -> tuple[Labels, ...]:
    """Return the coefficients of all levels."""
    parents, alive, highs = roots, np.ones(roots.shape, np.bool_), []
    for level in reversed(range(len(costs))):
        shape, cost = pyramid[level][0].shape[:2], costs[level]
        labels, live = np.empty(shape, np.int32), np.empty(shape, np.bool_)
        below = _kernels.Errors(*pyramid[level]), cost.given(predictions[level])
        nodes, children = _kernels.Nodes(parents, alive), _kernels.Nodes(labels, live)
        if transform is S_TRANSFORM:
            high = np.zeros(shape, np.int32)
            _kernels.pass_down_s(*below, nodes, high, children)
        else:
            _kernels.pass_down_l(*below, nodes, children)
            high = labels - transform.synthesise(parents, np.zeros(shape, np.int32))
        highs.append(high)
        parents, alive = labels, live
    return tuple(highs[::-1])
