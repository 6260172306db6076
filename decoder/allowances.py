"""How much frames may ask for, where an encoder keeps a bitrate: what is left goes to those that follow.

After the header of each Wyner-Ziv frame stands the code of a number of bits, and a group may ask for as many
as its frames together. What frames are given follows from what those before them have asked for, level by
level, so that the punctured stream is decoded as the live one was.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dvc.slepian_wolf import CRC_BITS

HEADROOM = 1.25
"""How much more than its part of what is left a level may ask for, where others follow it."""
CHECK_BITS = 2.0 * CRC_BITS
"""Kept back for the check of a frame."""


@dataclass
class Allowance:
    """What one frame may ask for; planes that were begun are finished."""

    bits: float = float("inf")

    def __post_init__(self) -> None:
        """Keep the check back."""
        self._left = self.bits - CHECK_BITS

    def begin(self, expected_bits: float) -> bool:
        """Take out what a plane is expected to cost, if so much is left."""
        has_room = expected_bits <= self._left
        if has_room:
            self._left -= expected_bits
        return has_room

    def end(self, expected_bits: float, num_bits: float) -> None:
        """Put in its place what the plane has cost."""
        self._left += expected_bits - num_bits


class GroupAllowance:
    """What the frames of a group may still ask for."""

    def __init__(self, told_bits: Mapping[int, int] | None) -> None:
        # Of frames that are not decoded yet, as the encoder has told them; None where it allows all.
        self._told = None if told_bits is None else dict(told_bits)
        self._left = 0.0 if told_bits is None else float(sum(told_bits.values()))

    def begin_level(self, frames: Sequence[int]) -> list[Allowance]:
        """Return what frames that are decoded side by side may ask for."""
        if self._told is None:
            return [Allowance() for _ in frames]
        whole = sum(self._told.values())
        told = [self._told.pop(frame) for frame in frames]
        headroom = min(HEADROOM * sum(told), whole) / max(sum(told), 1)
        per_bit = headroom * max(self._left, 0.0) / max(whole, 1)
        return [Allowance(per_bit * bits) for bits in told]

    def end_level(self, num_bits: int) -> None:
        """Take out what they have asked for."""
        self._left -= num_bits
