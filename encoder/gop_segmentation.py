"""Segmentation of frames into groups of pictures at the least estimated rate.

A Wyner-Ziv frame is taken to cost a share of a key frame that grows with how much the blocks of tracked
points have changed over its distance from its references, and with how many are lost. Nothing is decoded
for it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MIN_SHARE = 0.056
_CHANGE_WEIGHT = 0.0062
_LOSS_WEIGHT = 0.095
"""Least squares over Wyner-Ziv frames of box, desk, stone and tree at preset 4, in groups of 2 to 16 frames;
what they lose in quality against key frames is counted as rate, 14 % a decibel, which is an assumption. The
fit was made once; no command repeats it."""


def wyner_ziv_share(change: float, lost_share: float) -> float:
    """Estimate what a Wyner-Ziv frame costs, as a share of the bits of a key frame."""
    return _MIN_SHARE + _CHANGE_WEIGHT * change**2 + _LOSS_WEIGHT * lost_share**2


def group_costs(changes: Sequence[float], lost_shares: Sequence[float], hierarchical: bool) -> Floats:
    """Estimate the rate of groups that start at a key frame."""
    over = [0.0, *changes]
    costs = np.zeros(len(over))
    for length, lost_share in enumerate(lost_shares, 1):
        costs[length] = 1.0 + sum(
            wyner_ziv_share(0.5 * (over[before] + over[after]), lost_share)
            for before, after in _distances(length, hierarchical)
        )
    return costs


def _distances(length: int, hierarchical: bool) -> list[tuple[int, int]]:
    """Return the distances of each Wyner-Ziv frame of a group from its references."""
    if length < 2:
        return []
    if not hierarchical:
        return [(m, length - m) for m in range(1, length)]
    before, after = length // 2, length - length // 2
    return [(before, after), *_distances(before, True), *_distances(after, True)]


def first_length(costs: Floats, min_length: int) -> int:
    """Return the length of the first group of the cheapest segmentation of all frames."""
    total = len(costs) - 1
    min_costs = np.full(total + 1, np.inf)
    min_costs[0] = 0.0
    chosen = np.zeros(total + 1, np.int64)
    for num_frames in range(1, total + 1):
        for length in range(num_frames, 0, -1):
            if length < min(min_length, total):
                break
            cost = costs[length] + min_costs[num_frames - length]
            if cost < min_costs[num_frames]:
                min_costs[num_frames], chosen[num_frames] = cost, length
    return int(chosen[total])
