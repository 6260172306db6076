"""Choice of the quality of each group of pictures, so that a stream has a bitrate.

What groups have taken beyond their share of time is owed. As long as no more than half of `TOLERANCE` is, of
what `WINDOW_S` takes, to either side, all groups of so long a time take their bitrate within it, wherever it
begins. So a group has the quality of the one before where this keeps what is owed within the bound.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dvc.config import DEFAULT_QP, MAX_QP, WynerZivConfig
from encoder.rate_limits import TOLERANCE, WINDOW_S

Floats = NDArray[np.float64]

START_S = 0.5
"""What the first key frame takes beyond its share: nothing comes sooner if less of it does."""
STEPS = 4
"""Of quality from one QP to the next: frames that predict the fewest others are the first to be coarser."""
OCTAVES_PER_STEP = 0.04, 0.015, 0.1
"""By which a group takes less at the next coarser quality, before that is known; and the bounds of it."""
MAX_RISE = 24
"""Steps from one group to the next: a new scene is owed, and paid for by those that follow."""
MAX_TRIES = 5
RATIOS = 0.25, 4.0
"""Bounds of what decoders are taken to ask for over what is estimated."""
LEAST_ALLOWED = 0.5
"""Of what is expected, what a decoder may ask for, however much key frame and tracks take."""
AIM = 1.15
"""What decoders would ask for over what they take on the mean: most groups take all that is allowed then, and
what saves the least is left out."""
FULL_SHARE = 0.9
"""Of what is allowed, from which on a decoder would have asked for more: `MORE` times what was assumed."""
MORE = 1.03
KEPT_SHARE = 0.8
"""Of what groups before have taken over what they were expected to, beside the latest: what those that follow
are expected to be off."""
ASKED_BPP, ASKED_OCTAVES_PER_QP = (0.008, 0.016, 0.027), 0.32
"""Bits a pixel that decoders ask for at QP 30 of frames whose references are 2, 4, and 8 or more frames
apart, and how they fall with the QP, until more is known: the mean over the nine clips of the results, 49
frames at QP 24 to 36, of ``parity`` and ``crc`` of ``per_frame`` in what `dvc-rd run` writes."""


class ExpectedBits(NamedTuple):
    """What a group is expected to take."""

    certain: float
    asked: Floats = np.zeros(0)  # that a decoder would ask for beside that, by frames in order of display


class QualityStep(NamedTuple):
    """A quality between two QPs or at one."""

    qp: int
    coarser_share: float = 0.0  # of the Wyner-Ziv frames, those that are one QP coarser

    @classmethod
    def of(cls, number: int) -> Self:
        """Return the quality of a number, `STEPS` times the QP."""
        return cls(number // STEPS, number % STEPS / STEPS)

    @property
    def number(self) -> int:
        """Number of the quality; inverse of `of`."""
        return round(STEPS * (self.qp + self.coarser_share))

    def qps(self, distances: Sequence[int]) -> list[int]:
        """Return the QPs of frames whose references are so far apart."""
        order = sorted(range(len(distances)), key=distances.__getitem__)
        coarser = set(order[: round(self.coarser_share * len(distances))])
        return [min(self.qp + (place in coarser), MAX_QP) for place in range(len(distances))]

    def steps(self, usual: WynerZivConfig, distances: Sequence[int]) -> list[float]:
        """Return their finest steps."""
        pairs = zip(self.qps(distances), distances, strict=True)
        return [replace(usual, qp=qp).step(distance) for qp, distance in pairs]


def forecast(quality: QualityStep, distances: Sequence[int], num_px: int) -> Floats:
    """Return what decoders usually ask for of frames whose references are so far apart."""
    levels = [min((distance - 1).bit_length(), len(ASKED_BPP)) - 1 for distance in distances]
    octaves = ASKED_OCTAVES_PER_QP * (30.0 - np.array(quality.qps(distances), np.float64))
    asked: Floats = num_px * np.array(ASKED_BPP)[levels] * 2.0**octaves
    return asked


class _OpenGroup(NamedTuple):
    """A group of which it is not known what a decoder asks for."""

    estimate: ExpectedBits
    certain: float  # bits beyond its share of time
    assumed: float  # bits that a decoder asks for
    allowed: float


class _Found(NamedTuple):
    """The quality of a group."""

    number: int
    estimate: ExpectedBits
    share: float  # bits of its time
    most_bits: float  # that it may take
    slope: float  # octaves from one quality to the next


class BitrateController:
    """Chooses the quality of one group after the other, and what decoders may ask for."""

    def __init__(self, bits_per_s: float, frame_rate: Fraction) -> None:
        self.most_owed = 0.0  # in bits: what a link of that rate had to hold back
        self.allowed = np.zeros(0)  # bits that a decoder may ask for of each frame of the latest group
        self._bits_per_s, self._bits_per_frame = bits_per_s, bits_per_s / float(frame_rate)
        self._bound = 0.5 * TOLERANCE * WINDOW_S * bits_per_s
        self._settled = 0.0  # in bits: what groups of which all is known took beyond their share
        self._open: dict[int, _OpenGroup] = {}
        self._asked = self._estimated = 0.0  # what decoders have asked for of late, and what was expected
        self._number: int | None = None  # of the quality of the group before
        self._slope = OCTAVES_PER_STEP[0]
        self._num_groups = self._num_frames = 0

    @property
    def owed(self) -> float:
        """What groups take beyond their share, as far as it is known and assumed, in bits."""
        return self._settled + sum(group.certain + group.assumed for group in self._open.values())

    @property
    def _start_bits(self) -> float:
        """What the first group may take beyond its time."""
        return START_S * self._bits_per_s if self._number is None else 0.0

    def choose(
        self,
        num_frames: int,
        expect: Callable[[QualityStep], ExpectedBits],
        outlook: QualityStep | None = None,
    ) -> QualityStep:
        """Choose the quality of the next group of so many frames, near an outlook; enter what it takes."""
        found = self._search(num_frames, expect, outlook)
        if outlook is None:
            self._slope = found.slope
        self._enter(found.estimate, found.share, found.most_bits)
        self.most_owed = max(self.most_owed, self.owed + self._start_bits)
        self._num_groups += 1
        self._num_frames += num_frames
        self._number = found.number
        return QualityStep.of(found.number)

    def outlook(self, num_frames: int, expect: Callable[[QualityStep], ExpectedBits]) -> QualityStep:
        """Return the quality that suits a group of which something is still to be coded at it."""
        found = self._search(num_frames, expect)
        self._slope = found.slope
        return QualityStep.of(found.number)

    def _search(
        self,
        num_frames: int,
        expect: Callable[[QualityStep], ExpectedBits],
        outlook: QualityStep | None = None,
    ) -> _Found:
        """Find the quality of the next group.

        `expect` returns what it takes at one; bits that are estimated count as much as those of earlier
        groups have turned out to.
        """
        share = num_frames * self._bits_per_frame + self._start_bits
        most_owed = self._settled + sum(group.certain + group.allowed for group in self._open.values())
        most_bits = share + self._bound - most_owed
        tried: dict[int, ExpectedBits] = {}

        def bits(number: int) -> float:
            tried[number] = expect(QualityStep.of(number))
            return tried[number].certain + float(self._wished(tried[number]).sum()) / AIM

        number, most = self._number or STEPS * DEFAULT_QP, STEPS * MAX_QP
        if self._num_frames * self._bits_per_frame > WINDOW_S * self._bits_per_s:
            most = min(number + MAX_RISE, most)
        if outlook is not None:
            number = outlook.number
        search = Search(max(min(share - self.owed, most_bits), 1.0), self._bound, self._slope)
        number = search.run(bits, number, most)
        return _Found(number, tried[number], share, most_bits, search.slope)

    def _wished(self, estimate: ExpectedBits) -> Floats:
        """Return what a decoder would ask for of each frame if it were allowed to."""
        least, most = RATIOS
        ratio = self._asked / self._estimated if self._estimated else 1.0
        wished: Floats = min(max(ratio, least), most) * estimate.asked
        return wished

    def _enter(self, estimate: ExpectedBits, share: float, most_bits: float) -> None:
        """Note what a group takes, and what a decoder may ask for of it."""
        self.allowed = self._wished(estimate)
        wished = float(self.allowed.sum())
        if not wished:
            self._settled += estimate.certain - share
            return
        allowed = max(most_bits - estimate.certain, LEAST_ALLOWED * wished)
        self.allowed *= allowed / wished
        certain = estimate.certain - share
        self._open[self._num_groups] = _OpenGroup(estimate, certain, wished / AIM, allowed)

    def leave_out(self, last: int) -> None:
        """Expect nothing more of the groups up to a number: no decoder gets their frames any more."""
        for number in [number for number in self._open if number <= last]:
            self._settled += self._open.pop(number).certain

    def settle(self, number: int, asked: NDArray[np.int64]) -> None:
        """Count what a decoder has really asked for of the frames of a group."""
        if number not in self._open:
            return
        group, num_bits = self._open.pop(number), int(asked.sum())
        # What was not taken does not come later.
        self._settled = max(self._settled + group.certain + num_bits, -self._bound)
        self.most_owed = max(self.most_owed, self.owed)
        estimate = group.estimate
        is_full = num_bits > FULL_SHARE * group.allowed
        more = MORE * max(AIM * group.assumed / num_bits, 1.0) if is_full else 1.0
        self._asked = KEPT_SHARE * self._asked + more * num_bits
        self._estimated = KEPT_SHARE * self._estimated + float(estimate.asked.sum())


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


def keep_within(most: float, coarsest: int, bits: Callable[[int], float]) -> bool:
    """Try coarser qualities until there are no more bits than that; tell whether there are not.

    `bits` tells how many there are at so many QPs above the usual one, up to `coarsest`.
    """
    coarser = 0
    while (found := bits(coarser)) > most and coarser < coarsest:
        steps = math.log2(found / most) / OCTAVES_PER_STEP[0]
        coarser = min(coarser + math.ceil(steps / STEPS), coarsest)
    return found <= most
