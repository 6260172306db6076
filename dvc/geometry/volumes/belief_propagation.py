"""Min-sum belief propagation on the grid of pixels: hierarchical, with truncated linear smoothness.

References
----------
[Felzenszwalb2006] P. Felzenszwalb, D. Huttenlocher, "Efficient belief propagation for early vision",
Int. J. Comput. Vis. 70(1), 2006.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.volumes import _kernels
from dvc.geometry.volumes.inference import Inferred, chosen

Volume = NDArray[np.float32]
Labels = NDArray[np.int64]


@dataclass(frozen=True)
class BeliefPropagation:
    """Inference by messages between neighbours, from coarse grids to fine ones."""

    slope: float = 0.2  # cost of a change by one label, and the most a change costs: alpha and beta of (2.13)
    limit: float = 0.6
    max_jump: int = 2  # labels by which a base surface may change from pixel to pixel at no cost
    # smoothness falls with ``exp(-difference / edge_levels)`` of colours, down to `edge_strength`
    edge_levels: float = 5.0
    edge_strength: float = 0.05
    iterations: int = 3  # rounds of messages on each grid, and number of grids
    levels: int = 5

    def infer(self, cost: Volume, image: NDArray[np.uint8], base: Labels, origin: Labels) -> Inferred:
        """Choose labels; see `Inference`."""
        return chosen(self.beliefs(cost, image, base, origin), origin)

    def beliefs(self, cost: Volume, image: NDArray[np.uint8], base: Labels, origin: Labels) -> Volume:
        """Return the costs of all labels, with what the messages say."""
        grids = self._grids(cost, image, base, origin)
        messages = [np.zeros(grids[-1][0].shape, np.float32) for _ in range(4)]
        slope, limit = np.float32(self.slope), np.float32(self.limit)
        for level, (costs, across, down, rise_x, rise_y) in reversed(list(enumerate(grids))):
            if level < len(grids) - 1:
                messages = [_finer(message, costs.shape[:2]) for message in messages]
            for turn in range(self.iterations):
                strengths = across, down, rise_x, rise_y
                _kernels.exchange(costs, strengths, tuple(messages), slope, limit, (turn + level) % 2)
        total = cost.copy()
        for message in messages:
            total += message
        return total

    def _grids(
        self, cost: Volume, image: NDArray[np.uint8], base: Labels, origin: Labels
    ) -> list[tuple[Volume, NDArray[np.float32], NDArray[np.float32], Labels, Labels]]:
        """Costs, strengths and rises of the base surface to the right and downwards, from fine to coarse."""
        levels = image.astype(np.float32)
        across, down = (self._strength(np.diff(levels, axis=axis)) for axis in (1, 0))
        rise_x, rise_y = (
            self._small(np.diff(base, axis=axis)) - np.diff(origin, axis=axis) for axis in (1, 0)
        )
        grids = [(cost, across, down, rise_x, rise_y)]
        while len(grids) < self.levels and min(cost.shape[:2]) > 1:
            cost = _coarser(cost)
            rows, columns = cost.shape[:2]
            across = np.ascontiguousarray(across[::2, 1::2][:, : columns - 1])
            down = np.ascontiguousarray(down[1::2, ::2][: rows - 1])
            grids.append(
                (cost, across, down, np.zeros(across.shape, np.int64), np.zeros(down.shape, np.int64))
            )
        return grids

    def _small(self, rise: Labels) -> Labels:
        return np.ascontiguousarray(np.where(np.abs(rise) > self.max_jump, 0, rise))

    def _strength(self, difference: NDArray[np.float32]) -> NDArray[np.float32]:
        falling = np.exp(-np.abs(difference).max(axis=2) / np.float32(self.edge_levels))
        strength: NDArray[np.float32] = (self.edge_strength + (1.0 - self.edge_strength) * falling).astype(
            np.float32
        )
        return strength


def _coarser(cost: Volume) -> Volume:
    """Sum the costs of four pixels."""
    rows, columns = (cost.shape[0] + 1) // 2, (cost.shape[1] + 1) // 2
    coarse = np.zeros((rows, columns, cost.shape[2]), np.float32)
    for dy in (0, 1):
        for dx in (0, 1):
            part = cost[dy::2, dx::2]
            coarse[: part.shape[0], : part.shape[1]] += part
    return coarse


def _finer(message: Volume, shape: tuple[int, ...]) -> Volume:
    fine = np.empty((*shape, message.shape[2]), np.float32)
    for dy in (0, 1):
        for dx in (0, 1):
            part = fine[dy::2, dx::2]
            part[...] = message[: part.shape[0], : part.shape[1]]
    return fine
