"""Which groups of pictures no key frame ends: those whose P-type frames cost less.

A key frame costs the same whatever came before. A P-type frame costs what frames before it do not show: what
comes into view as the camera moves, and what has changed. How much that is, the points tell that are lost on
the way there.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from dvc.config import GopConfig
from dvc.tracks import PointTracks
from dvc.wynerziv.hierarchy import p_type_instants
from encoder.groups import Group

MAX_LOST_SHARE = 0.43
"""Of the points, that may be lost on the way to the P-type frames of a group, one after the other: chosen on
nine clips at QP 32, five of them at 26 or 38 as well; `benchmarks.searches.lost_points` searches for it."""
MAX_ESTIMATED_LOST_SHARE = 0.08
"""The same to any one P-type frame where rates are estimated: what is harder to predict is too often sent
less than it needs, and all until the next key frame rests on it. Chosen on box, desk, river and statue."""


def lost_shares(tracks: PointTracks, p_type_distance: int) -> list[float]:
    """Return which share of the points is lost on the way to each P-type frame from the one before."""
    instants = [0, *p_type_instants(0, tracks.num_instants - 1, p_type_distance)]
    seen = np.asarray(np.isfinite(tracks.positions).all(axis=-1))
    counts = [(seen[:, k].sum(), (seen[:, k] & ~seen[:, n]).sum()) for k, n in pairwise(instants)]
    return [float(num_lost / num_seen) if num_seen else 1.0 for num_seen, num_lost in counts]


class KeyFrameSpacing:
    """Decides which groups of a sequence end with a key frame."""

    def __init__(self, gop: GopConfig, max_p_type_lost_share: float = 1.0) -> None:
        self._gop = gop
        self._max_p_type_lost_share = max_p_type_lost_share
        self._num_frames = 0  # since the last key frame
        self._begun = False

    def needs_key(self, group: Group, find: Callable[[], float] = lambda: 0.0) -> bool:
        """Decide for the next group; `find` tells which share of its points a long-term reference has."""
        length = len(group.wyner_ziv) + 1
        spared = self._begun and self._num_frames + length <= self._gop.intra_period
        if spared and group.tracks:
            # Of points that the very next frame has lost there are no tracks.
            alone = not group.wyner_ziv
            shares = [group.lost_share] if alone else lost_shares(group.tracks, self._gop.p_type_distance)
            spared = self._is_cheap(shares) or self._is_cheap(shares, find())
        else:
            spared = False
        self._begun = True
        self._num_frames = self._num_frames + length if spared else 0
        return not spared

    def _is_cheap(self, shares: list[float], found_share: float = 0.0) -> bool:
        """Decide whether P-type frames are cheap, together and each; what is found elsewhere is not lost."""
        left = 1.0 - found_share
        return left * sum(shares) <= MAX_LOST_SHARE and left * max(shares) <= self._max_p_type_lost_share
