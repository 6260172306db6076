"""Choice of the quality of each group of pictures, so that a stream has a bitrate.

What groups have taken beyond their share of time is owed. As long as no more than half of `TOLERANCE` is, of
what `WINDOW_S` takes, to either side, all groups of so long a time take their bitrate within it, wherever it
begins. So a group has the quality of the one before where this keeps what is owed within the bound.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple, Self

from dvc.config import DEFAULT_QP, MAX_QP, WynerZivConfig
from dvc.config.fields import check_range

WINDOW_S = 2.0
TOLERANCE = 0.05
START_S = 0.5
"""What the first key frame takes beyond its share: nothing comes sooner if less of it does."""
STEPS = 4
"""Of quality from one QP to the next: frames that predict the fewest others are the first to be coarser."""
OCTAVES_PER_STEP = 0.04, 0.015, 0.1
"""By which a group takes less at the next coarser quality, before that is known; and the bounds of it."""
MAX_RISE = 24
"""Steps from one group to the next: a new scene is owed, and paid for by those that follow."""
MAX_TRIES = 5
PAID_SHARE = 0.5
"""Of what is owed, what the next group makes up for, where some of what others take is not known yet."""
MAX_BITS = 10**12
KEPT_SHARE = 0.8
"""Of what groups before have taken over what they were expected to, beside the latest: what those that follow
are expected to be off."""


@dataclass(frozen=True)
class RateLimits:
    """What a stream may take."""

    bits_per_s: int | None = None  # on the mean over `WINDOW_S`; None: quality is constant
    bits_per_frame: int | None = None  # most of a frame; of what a decoder asks for, by estimate

    @property
    def is_none(self) -> bool:
        """Whether nothing is limited."""
        return self.bits_per_s is None and self.bits_per_frame is None

    def __post_init__(self) -> None:
        """Refuse limits that make no sense."""
        for name in ("bits_per_s", "bits_per_frame"):
            if getattr(self, name) is not None:
                check_range(name, getattr(self, name), 1, MAX_BITS)


class QualityStep(NamedTuple):
    """A quality between two QPs or at one."""

    qp: int
    coarser_share: float = 0.0  # of the Wyner-Ziv frames, those that are one QP coarser

    @classmethod
    def of(cls, number: int) -> Self:
        """Return the quality of a number, `STEPS` times the QP."""
        return cls(number // STEPS, number % STEPS / STEPS)

    def qps(self, distances: Sequence[int]) -> list[int]:
        """Return the QPs of frames whose references are so far apart."""
        order = sorted(range(len(distances)), key=distances.__getitem__)
        coarser = set(order[: round(self.coarser_share * len(distances))])
        return [min(self.qp + (place in coarser), MAX_QP) for place in range(len(distances))]

    def steps(self, usual: WynerZivConfig, distances: Sequence[int]) -> list[float]:
        """Return their finest steps."""
        pairs = zip(self.qps(distances), distances, strict=True)
        return [replace(usual, qp=qp).step(distance) for qp, distance in pairs]


class BitrateController:
    """Chooses the quality of one group after the other."""

    def __init__(self, bits_per_s: float, frame_rate: Fraction) -> None:
        self.most_owed = 0.0  # in bits: what a link of that rate had to hold back
        self._bits_per_s, self._bits_per_frame = bits_per_s, bits_per_s / float(frame_rate)
        self._bound = 0.5 * TOLERANCE * WINDOW_S * bits_per_s
        self.owed = 0.0  # in bits: what groups took beyond their share
        # What decoders have asked for, and what was estimated, of late; at first as if that were right.
        self._asked = self._estimated = START_S * bits_per_s
        self._number: int | None = None  # of the quality of the group before
        self._slope = OCTAVES_PER_STEP[0]
        # Of groups whose bits are not known: what was assumed of what is estimated, and that.
        self._expected: dict[int, tuple[float, float]] = {}
        self._num_groups = self._num_frames = 0

    def choose(self, num_frames: int, expect: Callable[[QualityStep], tuple[int, float]]) -> QualityStep:
        """Choose the quality of the next group of so many frames.

        `expect` tells what it would take at one: bits that are certain, and bits that are estimated, which
        count as much as those of earlier groups have turned out to.
        """
        start = START_S * self._bits_per_s if self._number is None else 0.0
        paid = (PAID_SHARE if self._expected else 1.0) * self.owed
        wanted = max(num_frames * self._bits_per_frame + start - paid, 1.0)
        tried: dict[int, tuple[int, float]] = {}

        def bits(number: int) -> float:
            certain, estimated = tried[number] = expect(QualityStep.of(number))
            return certain + self._ratio * estimated

        number, most = self._number or STEPS * DEFAULT_QP, STEPS * MAX_QP
        if self._num_frames * self._bits_per_frame > WINDOW_S * self._bits_per_s:
            most = min(number + MAX_RISE, most)
        search = Search(wanted, self._bound, self._slope)
        number = search.run(bits, number, most)
        self._slope = search.slope
        self.owed += search.found[number] - num_frames * self._bits_per_frame - start
        self._note_owed(start)
        estimated = tried[number][1]
        if estimated:
            self._expected[self._num_groups] = self._ratio * estimated, estimated
        self._num_groups += 1
        self._num_frames += num_frames
        self._number = number
        return QualityStep.of(number)

    @property
    def _ratio(self) -> float:
        """What decoders ask for over what is estimated."""
        return min(max(self._asked / max(self._estimated, 1.0), 0.25), 4.0)

    def settle(self, group: int, num_bits: int) -> None:
        """Count what a group has really taken of what was estimated."""
        assumed, estimated = self._expected.pop(group, (0.0, 0.0))
        self.owed += num_bits - assumed
        self._note_owed()
        self._asked = KEPT_SHARE * self._asked + (num_bits if estimated else 0)
        self._estimated = KEPT_SHARE * self._estimated + estimated

    def _note_owed(self, start: float = 0.0) -> None:
        self.most_owed = max(self.most_owed, self.owed + start)


class Search:
    """Looks for the quality nearest to the usual one at which a group takes what is wanted."""

    def __init__(self, wanted: float, bound: float, slope: float) -> None:
        self.found: dict[int, float] = {}  # bits by numbers of qualities
        self.slope = slope  # octaves from one to the next
        self._wanted, self._bound = wanted, bound

    def run(self, bits: Callable[[int], float], number: int, most: int) -> int:
        """Try qualities until one is within the bound; return it, or the best that was tried."""
        for _ in range(MAX_TRIES):
            self.found[number] = max(bits(number), 1.0)
            if abs(self.found[number] - self._wanted) <= self._bound:
                return number
            self._learn_slope()
            number = min(max(self._next(), STEPS), most)
            if number in self.found:
                break
        return min(self.found, key=lambda number: abs(self.found[number] - self._wanted))

    def _learn_slope(self) -> None:
        if len(self.found) > 1:
            (before, more), (after, fewer) = list(self.found.items())[-2:]
            _, least, most = OCTAVES_PER_STEP
            self.slope = min(max(math.log2(more / fewer) / (after - before), least), most)

    def _next(self) -> int:
        """Return where to look, by what was found nearest to what is wanted on either side."""
        finer = [number for number, bits in self.found.items() if bits >= self._wanted]
        coarser = [number for number, bits in self.found.items() if bits < self._wanted]
        if not (finer and coarser):
            near = max(finer) if finer else min(coarser)
            steps = math.log2(self.found[near] / self._wanted) / self.slope
            return near + (math.ceil(steps) if finer else math.floor(steps))
        first, last = max(finer), min(coarser)
        if last - first < 2:
            return first
        whole, part = (math.log(self.found[first] / to) for to in (self.found[last], self._wanted))
        return min(max(first + round(part / max(whole, 1e-9) * (last - first)), first + 1), last - 1)


def keep_within(most: float, bits: Callable[[int], float]) -> bool:
    """Try coarser qualities until there are no more bits than that; tell whether there are not.

    `bits` tells how many there are at so many QPs above the usual one.
    """
    coarser = 0
    while (found := bits(coarser)) > most and coarser < MAX_QP:
        steps = math.log2(found / most) / OCTAVES_PER_STEP[0]
        coarser = min(coarser + math.ceil(steps / STEPS), MAX_QP)
    return found <= most
