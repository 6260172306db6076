"""Which groups of pictures no key frame ends: those whose anchors are estimated to cost less.

A key frame costs the same whatever came before; an anchor costs a share of that which grows with how much
the blocks of tracked points have changed since its reference, and with how many are lost.
"""

from dvc.config import GopConfig
from encoder.groups import Group

_MIN_SHARE = 0.1
_CHANGE_WEIGHT = 0.01
_LOSS_WEIGHT = 0.5
MAX_SHARE = 0.8
"""Of the bits of a key frame, that the anchors of a group may be estimated to cost."""


def anchor_share(change: float, lost_share: float) -> float:
    """Estimate what an anchor costs.

    Parameters
    ----------
    change : float
        Mean difference of the tracked blocks from those of its reference, in grey levels a sample.
    lost_share : float
        Share of the points that are lost.

    Returns
    -------
    float
        As a share of the bits of a key frame.
    """
    return _MIN_SHARE + _CHANGE_WEIGHT * change**2 + _LOSS_WEIGHT * lost_share**2


class KeyFrameSpacing:
    """Decides which groups of a sequence end with a key frame.

    Parameters
    ----------
    gop : GopConfig
        Whether others are allowed, and how far apart key frames may be.
    """

    def __init__(self, gop: GopConfig) -> None:
        self._gop = gop
        self._num_frames = 0  # since the last key frame
        self._begun = False

    def needs_key(self, group: Group) -> bool:
        """Decide for the next group.

        Parameters
        ----------
        group : Group
            The group; all are asked for, one after the other.

        Returns
        -------
        bool
            Whether it ends with a key frame.
        """
        length = len(group.wyner_ziv) + 1
        spared = self._begun and self._num_frames + length <= self._gop.intra_period
        spared = spared and self._share(group) <= MAX_SHARE
        self._begun = True
        self._num_frames = self._num_frames + length if spared else 0
        return not spared

    def _share(self, group: Group) -> float:
        """Estimate what the anchors of a group cost."""
        length = len(group.changes)
        if not length or group.tracks is None:
            return float("inf")
        count = -(-length // self._gop.anchor_distance)
        change = group.changes[length // count - 1] if count > 1 else group.changes[-1]
        return count * anchor_share(change, group.lost_share / count)
