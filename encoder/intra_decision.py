"""Which groups of pictures no key frame ends: those whose P-type frames cost less.

A key frame costs the same whatever came before. A P-type frame costs what frames before it do not show: what
comes into view as the camera moves, and what has changed. How much that is, the points tell that are lost on
the way there.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dvc.config import GopConfig
from dvc.wynerziv.hierarchy import p_type_instants
from encoder.groups import Floats, Group

MAX_LOST_SHARE = 0.53
"""Of the points, that may be lost on the way to the P-type frames of a group, one after the other."""
LEAVING_WEIGHT = 0.18
"""What a point counts that has left the picture, in points that are lost inside it. Both were chosen on nine
clips at QP 32, five of them at 26 or 38 as well; `benchmarks.searches.lost_points` searches for them."""
BORDER_PX = 6.0
"""From the border of the frame, within which a point that is lost has left it."""
BORDER_FRAMES = 1.5
"""Frames in which a point that goes on as before comes as near to the border."""
MAX_P_TYPE_LOST_SHARE = 0.65
"""Of the points, that may be lost on the way to any one P-type frame, those that leave the picture included:
beyond what those clips have shown."""
MAX_ESTIMATED_LOST_SHARE = 0.08
"""The same where rates are estimated: what is harder to predict is too often sent less than it needs, and all
until the next key frame rests on it. Chosen on box, desk, river and statue."""


def lost_shares(
    path: Floats, size: tuple[int, int], p_type_distance: int, *leaving_weights: float
) -> list[list[float]]:
    """Return which share of the points is lost on the way to each P-type frame from the one before.

    `path` (N, T, 2) tells where points are in each frame, of `size` (width, height); nan once they are lost.
    There is a list for each weight of points that leave the frame.
    """
    instants = [0, *p_type_instants(0, path.shape[1] - 1, p_type_distance)]
    known = np.isfinite(path[:, :, 0])
    leave, counts = _leave(path, known, size), known.sum(axis=0).tolist()
    ways = [(counts[k], known[:, k] & ~known[:, n]) for k, n in pairwise(instants)]
    return [
        [float(weights @ lost / count) if count else 1.0 for count, lost in ways]
        for weights in (np.where(leave, weight, 1.0) for weight in leaving_weights)
    ]


def _leave(path: Floats, known: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Tell which points are last seen where their motion takes them out of the frame."""
    number, last = np.arange(len(path)), known.sum(axis=1) - 1
    place, before = path[number, last], path[number, np.maximum(last - 1, 0)]
    margin = BORDER_PX + BORDER_FRAMES * np.abs(place - before)
    leave: NDArray[np.bool_] = ((place < margin) | (place > np.array(size) - 1 - margin)).any(axis=1)
    return leave


class KeyFrameSpacing:
    """Decides which groups of a sequence end with a key frame."""

    def __init__(self, gop: GopConfig, max_p_type_lost_share: float = MAX_P_TYPE_LOST_SHARE) -> None:
        self._gop = gop
        self._max_p_type_lost_share = max_p_type_lost_share
        self._num_frames = 0  # since the last key frame
        self._begun = False

    def begin(self) -> None:
        """Let the next group end with a key frame."""
        self._begun = False

    def needs_key(self, group: Group, find: Callable[[], float] = lambda: 0.0) -> bool:
        """Decide for the next group; `find` tells which share of its points a long-term reference has."""
        length = len(group.wyner_ziv) + 1
        spared = self._begun and self._num_frames + length <= self._gop.intra_period
        if spared and group.tracks and group.path is not None:
            size, distance = (group.key.width, group.key.height), self._gop.p_type_distance
            shares, unweighted = lost_shares(group.path, size, distance, LEAVING_WEIGHT, 1.0)
            weighted, most = sum(shares), max(unweighted)
            spared = self._is_cheap(weighted, most) or self._is_cheap(weighted, most, find())
        else:
            spared = False
        self._begun = True
        self._num_frames = self._num_frames + length if spared else 0
        return not spared

    def _is_cheap(self, weighted: float, most: float, found_share: float = 0.0) -> bool:
        """Decide whether P-type frames are cheap, together and each; what is found elsewhere is not lost."""
        left = 1.0 - found_share
        return left * weighted <= MAX_LOST_SHARE and left * most <= self._max_p_type_lost_share
