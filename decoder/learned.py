"""What frames of a group teach those that are decoded after them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.wynerziv.priors import LearnedPriors

Array = NDArray[np.float64]

CLASSES = (range(1), range(1, 3), range(3, 6), range(6, 16))
"""Bands that turn out alike, in zigzag order."""
MAX_WIDTH = 6
"""Powers of two of steps, as the width of bins, from which on all count as alike."""
STRENGTH_BITS = 60.0
"""Bits of a class from which on what has turned out counts more than the noise model; with 150 the rate is
.4 % higher, with 20 it is .1 % lower (see `decoder.asking.NEIGHBOURS`)."""


class Factors(NamedTuple):
    """What planes turn out to be over what the noise model says, on the average."""

    saved: float  # squared error that they take off
    bits: float  # that they cost


@dataclass
class LearnedWorth:
    """Expected and real cost and gain of planes, by classes of bands and widths of bins."""

    # expected, then seen: squared error, bits
    sums: Array = field(default_factory=lambda: np.zeros((len(CLASSES), MAX_WIDTH + 1, 2, 2)))

    def factors(self, band: int, width: int, multiplier: float) -> Factors:
        """Return what is to be made of what is expected of a band; `width`: of its bins, see `learn`."""
        (expected, expected_bits), (seen, bits) = self._of(band, width)
        strength = STRENGTH_BITS * multiplier
        return Factors(
            float((seen + strength) / (expected + strength)),
            float((bits + STRENGTH_BITS) / (expected_bits + STRENGTH_BITS)),
        )

    def learn(self, band: int, width: int, expected: tuple[float, float], seen: tuple[float, float]) -> None:
        """Note squared error and bits of a plane, whose bins were two to the power of `width` steps wide."""
        self._of(band, width)[:] += expected, seen

    def _of(self, band: int, width: int) -> Array:
        (number,) = (number for number, bands in enumerate(CLASSES) if band in bands)
        found: Array = self.sums[number, min(width, MAX_WIDTH)]
        return found


@dataclass
class Learned:
    """All of it."""

    priors: LearnedPriors
    worth: LearnedWorth = field(default_factory=LearnedWorth)

    def copy(self) -> "Learned":
        """Return the same, to be learned from by one frame."""
        return Learned(LearnedPriors.mean([self.priors]), LearnedWorth(self.worth.sums.copy()))

    def joined(self, several: Sequence["Learned"]) -> "Learned":
        """Return what was learned by copies of this, side by side."""
        sums = self.worth.sums.copy()
        for other in several:
            sums += other.worth.sums - self.worth.sums
        return Learned(LearnedPriors.mean([other.priors for other in several]), LearnedWorth(sums))
