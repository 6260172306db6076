"""Choice of the next requests of bands that are decoded in parallel: bands and areas."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from decoder.frame_state import Band
from dvc.arrays import Floats, Integers, Mask
from dvc.slepian_wolf import CRC_BITS, MAX_RUN_BITS, PlaneCost
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.priors import LearnedPriors

CLASSES = (range(1), range(1, 3), range(3, 6), range(6, 16))
"""Bands that turn out alike, in zigzag order."""
MAX_WIDTH = 6
"""Largest width class of bins, in powers of two of steps; wider bins share it."""
STRENGTH_BITS = 60.0
"""Bits of a class from which on experience counts more than the noise model; with 150 the rate is
.4 % higher, with 20 it is .1 % lower (see `decoder.plane_choice.NEIGHBOURS`)."""


class Factors(NamedTuple):
    """Ratio of real to expected costs and savings of planes, on average."""

    saved: float  # squared error that they take off
    bits: float  # that they cost


@dataclass
class LearnedWorth:
    """Expected and real cost and gain of planes, by classes of bands and widths of bins."""

    # expected, then seen: squared error, bits
    sums: Floats = field(default_factory=lambda: np.zeros((len(CLASSES), MAX_WIDTH + 1, 2, 2)))

    def factors(self, band: int, width: int, multiplier: float) -> Factors:
        """Return the factors on the expectations of a band; `width` of its bins: see `learn`."""
        (expected, expected_bits), (seen, bits) = self._of(band, width)
        strength = STRENGTH_BITS * multiplier
        return Factors(
            float((seen + strength) / (expected + strength)),
            float((bits + STRENGTH_BITS) / (expected_bits + STRENGTH_BITS)),
        )

    def learn(self, band: int, width: int, expected: tuple[float, float], seen: tuple[float, float]) -> None:
        """Learn from a plane with bins of two to the power of `width` steps."""
        self._of(band, width)[:] += expected, seen

    def _of(self, band: int, width: int) -> Floats:
        (number,) = (number for number, bands in enumerate(CLASSES) if band in bands)
        found: Floats = self.sums[number, min(width, MAX_WIDTH)]
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
        """Return the state after all copies of this have learned in parallel."""
        sums = self.worth.sums.copy()
        for other in several:
            sums += other.worth.sums - self.worth.sums
        return Learned(LearnedPriors.mean([other.priors for other in several]), LearnedWorth(sums))


HEADROOM = 1.25
"""Factor on the share of the remaining bits that a level may request if further levels follow."""
CHECK_BITS = 2.0 * CRC_BITS
"""Bits reserved for the check of a frame."""


@dataclass
class Allowance:
    """Bits that one frame may request; planes that were started are finished."""

    bits: float = float("inf")

    def __post_init__(self) -> None:
        """Keep the check back."""
        self._left = self.bits - CHECK_BITS

    def begin(self, expected_bits: float) -> bool:
        """Reserve the expected cost of a plane if enough bits remain."""
        has_room = expected_bits <= self._left
        if has_room:
            self._left -= expected_bits
        return has_room

    def end(self, expected_bits: float, num_bits: float) -> None:
        """Replace the expected cost of a plane by the real one."""
        self._left += expected_bits - num_bits


class GroupAllowance:
    """Bits that the frames of a group may still request."""

    def __init__(self, stated_bits: Mapping[int, int] | None) -> None:
        # Limits of frames that are not decoded yet, as the encoder states them; None without limits.
        self._stated = None if stated_bits is None else dict(stated_bits)
        self._left = 0.0 if stated_bits is None else float(sum(stated_bits.values()))

    def begin_level(self, frames: Sequence[int]) -> list[Allowance]:
        """Return what frames that are decoded side by side may ask for."""
        if self._stated is None:
            return [Allowance() for _ in frames]
        whole = sum(self._stated.values())
        stated = [self._stated.pop(frame) for frame in frames]
        headroom = min(HEADROOM * sum(stated), whole) / max(sum(stated), 1)
        per_bit = headroom * max(self._left, 0.0) / max(whole, 1)
        return [Allowance(per_bit * bits) for bits in stated]

    def end_level(self, num_bits: int) -> None:
        """Subtract the bits that a level requested."""
        self._left -= num_bits


LOOK_AHEAD = 2
"""Number of planes of a band that are judged together before the next is skipped."""
LEAST_RUN_BITS, LEAST_PART_BITS = 8.0, 2.0
"""Least savings of a run, and of each plane in it, beyond the expected cost."""
NEIGHBOURS = 0.5
"""Weight of the 3x3 areas around one in its smoothed gain; 0 takes .2 % more rate. By
`benchmarks.searches.settings decoder.plane_choice.NEIGHBOURS=0 --qp 28 36 --frames 33 --clips box desk river
stone street tree`, as were `decoder.plane_choice.STRENGTH_BITS` and
`dvc.wynerziv.noise.REFINEMENT_OUTLIER_PROBABILITY`."""


class Wanted(NamedTuple):
    """A plane with requested bits."""

    band: Band
    blocks: Integers
    expected: tuple[float, float]  # squared error that it takes off by the noise model, and bits


class Choice(NamedTuple):
    """Planes that are requested together, in the same areas."""

    wanted: list[Wanted]
    planes: tuple[int, ...]  # their numbers in the frame
    areas: bytes
    bits: float  # that it is expected to cost


class Asking:
    """Chooses planes that are worth their rate, by the learned factors."""

    def __init__(self, areas: Areas, worth: LearnedWorth, cost: PlaneCost, multiplier: float) -> None:
        self._areas, self._worth, self._cost, self._multiplier = areas, worth, cost, multiplier

    def whole_planes(self, bands: Sequence[Band], missing: int) -> list[Choice]:
        """Choose planes of all blocks, each in a run of its own."""
        return [choice for band in bands if (choice := self._whole(band, missing)) is not None]

    def _whole(self, band: Band, missing: int) -> Choice | None:
        """Choose the next plane of a band if that, or the next few together, save enough for every bit."""
        worth = band.worth(missing, min(missing + 1, LOOK_AHEAD))
        saved, bits = worth.saved.sum(axis=1), worth.bits.sum(axis=1)
        costs = [self._cost.bits(own, planes) for planes, own in enumerate(bits, 1)]
        if self._multiplier > 0 and not np.any(saved > self._multiplier * np.array(costs)):
            return None
        wanted = [Wanted(band, band.open, (float(saved[0]), costs[0]))]
        return _run(wanted, missing, b"", 0.0)

    def by_areas(self, bands: Sequence[Band], missing: int) -> list[Choice]:
        """Choose planes in the areas with enough savings, all in one run."""
        if self._multiplier == 0:
            return _runs([Wanted(band, band.open, (0.0, 0.0)) for band in bands], missing, b"")
        worths = [band.worth(missing, min(missing + 1, LOOK_AHEAD)) for band in bands]
        gains = []
        for band, worth in zip(bands, worths, strict=True):
            factors = self._worth.factors(band.number, missing, self._multiplier)
            bit = self._multiplier * self._cost.per_ideal_bit * factors.bits
            net = (factors.saved * worth.saved - bit * worth.bits).max(axis=0)
            gains.append(self._smoothed(self._areas.sums(band.open, net)))
        chosen, areas = self._worthwhile(gains)
        if not chosen:
            return []
        wanted = []
        for number in chosen:
            band, worth = bands[number], worths[number]
            inside = areas[self._areas.of_blocks[band.open]]
            bits = self._cost.per_ideal_bit * float(worth.bits[0, inside].sum())
            wanted.append(Wanted(band, band.open[inside], (float(worth.saved[0, inside].sum()), bits)))
        return _runs(wanted, missing, self._areas.coded(areas), self._cost.per_plane)

    def _smoothed(self, gains: Floats) -> Floats:
        """Smooth the gain of each area by its neighbours: errors are never isolated."""
        around = uniform_filter(gains.reshape(self._areas.shape), 3, mode="nearest").ravel()
        mixed: Floats = (1.0 - NEIGHBOURS) * gains + NEIGHBOURS * around
        return mixed

    def _worthwhile(self, gains: list[Floats]) -> tuple[list[int], Mask]:
        """Choose bands and areas such that each band gains in these areas, and each area by these bands."""
        least = LEAST_PART_BITS * self._multiplier
        chosen = [number for number, own in enumerate(gains) if np.maximum(own, 0.0).sum() > least]
        while chosen:
            areas = np.sum([gains[number] for number in chosen], axis=0) > 0.0
            found = [float(gains[number][areas].sum()) for number in chosen]
            if min(found) > least:
                enough = sum(found) > LEAST_RUN_BITS * self._multiplier
                return (chosen, areas) if enough else ([], areas)
            del chosen[int(np.argmin(found))]
        return [], np.zeros(self._areas.count, np.bool_)


def _runs(wanted: Sequence[Wanted], missing: int, areas: bytes, per_run: float = 0.0) -> list[Choice]:
    """Divide planes into as few runs as possible."""
    runs: list[list[Wanted]] = [[]]
    for own in wanted:
        if runs[-1] and sum(other.blocks.size for other in (*runs[-1], own)) > MAX_RUN_BITS:
            runs.append([])
        runs[-1].append(own)
    return [_run(run, missing, areas, per_run) for run in runs]


def _run(wanted: list[Wanted], missing: int, areas: bytes, per_run: float) -> Choice:
    planes = tuple(own.band.first_plane + own.band.place(missing)[1] for own in wanted)
    return Choice(wanted, planes, areas, per_run + sum(own.expected[1] for own in wanted))
