"""Choice of the quality of each group of pictures, so that a stream keeps a bitrate.

Groups fill a leaky bucket that drains at the bitrate. While its level stays within half of `TOLERANCE` times
the bits of `WINDOW_S`, above or below zero, the groups of any window of that length keep the bitrate within
the tolerance. A group therefore has the quality of the one before if the level stays within that bound.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats
from dvc.config import DEFAULT_QP, MAX_QP, WynerZivConfig
from encoder.rate_limits import TOLERANCE, WINDOW_S

START_S = 0.5
"""Seconds of the bitrate that the first key frame may add to its share; a smaller one comes no sooner."""
STEPS = 4
"""Steps of quality per QP: frames that predict the fewest other frames become coarser first."""
OCTAVES_PER_STEP = 0.04, 0.015, 0.1
"""Octaves of bits per step of quality, before any are measured, and their bounds."""
MAX_RISE = 24
"""Largest rise in steps from one group to the next: the groups that follow pay for a new scene."""
MAX_TRIES = 5
DEMAND_BOUNDS = 0.25, 4.0
"""Bounds of the bits that decoders request over those forecast."""
MIN_ALLOWED_SHARE = 0.5
"""Share of the forecast that a decoder may request, however much the key frame and the tracks take."""
DEMAND_MARGIN = 1.15
"""Unlimited requests over those accounted for: most groups then use their allowance and drop the bits that
are least useful."""
SATURATED_SHARE, SATURATED_GAIN = 0.9, 1.03
"""Share of its allowance above which a decoder is taken to have wanted more; factor on the demand assumed."""
MEMORY = 0.8
"""Weight of all earlier groups relative to the latest one in the ratio of requests to forecasts."""
ASKED_BPP, ASKED_OCTAVES_PER_QP = (0.008, 0.016, 0.027), 0.32
"""Bits per pixel requested at QP 30 for frames with references 2, 4, and 8 or more frames apart, and their
fall with the QP, before any are known: means over the nine clips of the results, 49 frames at QP 24 to 36, of
``parity`` and ``crc`` of ``per_frame`` in the output of `dvc-rd run`."""


class ExpectedBits(NamedTuple):
    """Bits that a group is expected to take."""

    certain: float
    asked: Floats = np.zeros(0)  # bits that a decoder would request for each frame, in display order


class QualityStep(NamedTuple):
    """A quality at a QP or between two QPs."""

    qp: int
    coarser_share: float = 0.0  # share of the Wyner-Ziv frames that are one QP coarser

    @classmethod
    def of(cls, number: int) -> Self:
        """Return the quality with a number; `STEPS` numbers make one QP."""
        return cls(number // STEPS, number % STEPS / STEPS)

    @property
    def number(self) -> int:
        """Number of the quality; inverse of `of`."""
        return round(STEPS * (self.qp + self.coarser_share))

    def qps(self, distances: Sequence[int]) -> list[int]:
        """Return the QPs of frames from the distances between their references."""
        order = sorted(range(len(distances)), key=distances.__getitem__)
        coarser = set(order[: round(self.coarser_share * len(distances))])
        return [min(self.qp + (index in coarser), MAX_QP) for index in range(len(distances))]

    def steps(self, usual: WynerZivConfig, distances: Sequence[int]) -> list[float]:
        """Return the finest quantiser steps of frames from the distances between their references."""
        pairs = zip(self.qps(distances), distances, strict=True)
        return [replace(usual, qp=qp).step(distance) for qp, distance in pairs]


Choice = Generator[QualityStep, ExpectedBits, QualityStep]
"""Coroutine that yields qualities to try, receives the bits they take, and returns the quality to use."""


def forecast(quality: QualityStep, distances: Sequence[int], num_px: int) -> Floats:
    """Return the bits usually requested for frames, from the distances between their references."""
    levels = [min((distance - 1).bit_length(), len(ASKED_BPP)) - 1 for distance in distances]
    octaves = ASKED_OCTAVES_PER_QP * (30.0 - np.array(quality.qps(distances), np.float64))
    asked: Floats = num_px * np.array(ASKED_BPP)[levels] * 2.0**octaves
    return asked


class _OpenGroup(NamedTuple):
    """A group with requests that are not known yet."""

    forecast_bits: float
    certain: float  # bits beyond its share
    assumed: float  # bits that a decoder is assumed to request
    allowed: float


class LeakyBucket:
    """Chooses the quality of one group after the other, and the bits that a decoder may request."""

    def __init__(self, bits_per_s: float, frame_rate: Fraction) -> None:
        self.peak_bits = 0.0  # highest level: the bits that a link of that rate would have held back
        self.allowed = np.zeros(0)  # bits that a decoder may request for each frame of the latest group
        self._bits_per_s, self._bits_per_frame = bits_per_s, bits_per_s / float(frame_rate)
        self._bound = 0.5 * TOLERANCE * WINDOW_S * bits_per_s
        self._settled = 0.0  # bits beyond the share of the groups that are complete
        self._open: dict[int, _OpenGroup] = {}
        self._asked = self._forecast = 0.0  # recent requests and their forecasts, in bits
        self._number: int | None = None  # quality of the group before
        self._slope = OCTAVES_PER_STEP[0]
        self._num_groups = self._num_frames = 0

    @property
    def level(self) -> float:
        """Bits beyond the share of all groups, with the requests that are assumed."""
        return self._settled + sum(group.certain + group.assumed for group in self._open.values())

    @property
    def _start_bits(self) -> float:
        """Bits that the first group may take beyond its time."""
        return START_S * self._bits_per_s if self._number is None else 0.0

    def outlook(self, num_frames: int) -> Choice:
        """Choose the quality for a part of the next group that is coded before the rest."""
        quality, _ = yield from self._search(num_frames, None, learns=True)
        return quality

    def choose(self, num_frames: int, outlook: QualityStep | None = None) -> Choice:
        """Choose the quality of the next group, near an outlook; account for its bits."""
        quality, expected = yield from self._search(num_frames, outlook, learns=outlook is None)
        self._add(expected, num_frames)
        self.peak_bits = max(self.peak_bits, self.level + self._start_bits)
        self._num_groups += 1
        self._num_frames += num_frames
        self._number = quality.number
        return quality

    def _search(
        self, num_frames: int, outlook: QualityStep | None, learns: bool
    ) -> Generator[QualityStep, ExpectedBits, tuple[QualityStep, ExpectedBits]]:
        """Find the quality of the next group and its bits; scale forecasts by the error of earlier ones."""
        share, max_bits = self._share(num_frames), self._max_bits(num_frames)
        number, coarsest = self._number or STEPS * DEFAULT_QP, STEPS * MAX_QP
        if self._num_frames * self._bits_per_frame > WINDOW_S * self._bits_per_s:
            coarsest = min(number + MAX_RISE, coarsest)
        if outlook is not None:
            number = outlook.number
        search = QualitySearch(max(min(share - self.level, max_bits), 1.0), self._bound, self._slope)
        tries = search.run(number, coarsest)
        tried: dict[int, ExpectedBits] = {}
        number = next(tries)
        try:
            while True:
                tried[number] = yield QualityStep.of(number)
                demand = float(self._demand(tried[number]).sum())
                number = tries.send(tried[number].certain + demand / DEMAND_MARGIN)
        except StopIteration as end:
            number = end.value
        if learns:
            self._slope = search.slope
        return QualityStep.of(number), tried[number]

    def _share(self, num_frames: int) -> float:
        return num_frames * self._bits_per_frame + self._start_bits

    def _max_bits(self, num_frames: int) -> float:
        """Return the bits that the next group may take even if decoders request all that they may."""
        highest = self._settled + sum(group.certain + group.allowed for group in self._open.values())
        return self._share(num_frames) + self._bound - highest

    def _demand(self, expected: ExpectedBits) -> Floats:
        """Return the bits that an unlimited decoder would request for each frame."""
        lowest, highest = DEMAND_BOUNDS
        ratio = self._asked / self._forecast if self._forecast else 1.0
        demand: Floats = min(max(ratio, lowest), highest) * expected.asked
        return demand

    def _add(self, expected: ExpectedBits, num_frames: int) -> None:
        """Account for a group, and allot the bits that a decoder may request."""
        certain = expected.certain - self._share(num_frames)
        self.allowed = self._demand(expected)
        demand = float(self.allowed.sum())
        if not demand:
            self._settled += certain
            return
        allowed = max(self._max_bits(num_frames) - expected.certain, MIN_ALLOWED_SHARE * demand)
        self.allowed *= allowed / demand
        forecast_bits = float(expected.asked.sum())
        self._open[self._num_groups] = _OpenGroup(forecast_bits, certain, demand / DEMAND_MARGIN, allowed)

    def account(self, number: int, asked: NDArray[np.int64]) -> None:
        """Replace the assumed requests for a group by the real ones of its frames."""
        if number not in self._open:
            return
        group, num_bits = self._open.pop(number), int(asked.sum())
        # Unused bits cannot be saved up beyond the bound.
        self._settled = max(self._settled + group.certain + num_bits, -self._bound)
        self.peak_bits = max(self.peak_bits, self.level)
        gain = 1.0
        if num_bits > SATURATED_SHARE * group.allowed:
            gain = SATURATED_GAIN * max(DEMAND_MARGIN * group.assumed / num_bits, 1.0)
        self._asked = MEMORY * self._asked + gain * num_bits
        self._forecast = MEMORY * self._forecast + group.forecast_bits


class QualitySearch:
    """Search for the quality closest to the usual one that gives a group a target number of bits."""

    def __init__(self, target: float, bound: float, slope: float) -> None:
        self.tried: dict[int, float] = {}  # bits by number of the quality
        self.slope = slope  # octaves from one quality to the next
        self._target, self._bound = target, bound

    def run(self, number: int, coarsest: int) -> Generator[int, float, int]:
        """Yield qualities and receive their bits until one is within the bound; return the best one tried."""
        for _ in range(MAX_TRIES):
            self.tried[number] = max((yield number), 1.0)
            if abs(self.tried[number] - self._target) <= self._bound:
                return number
            if len(self.tried) > 1:
                (before, more), (after, fewer) = list(self.tried.items())[-2:]
                _, lowest, highest = OCTAVES_PER_STEP
                self.slope = min(max(math.log2(more / fewer) / (after - before), lowest), highest)
            number = min(max(self._next(), STEPS), coarsest)
            if number in self.tried:
                break
        return min(self.tried, key=lambda number: abs(self.tried[number] - self._target))

    def _next(self) -> int:
        """Return the next quality to try, between the closest ones on both sides of the target."""
        finer = [number for number, bits in self.tried.items() if bits >= self._target]
        coarser = [number for number, bits in self.tried.items() if bits < self._target]
        if not (finer and coarser):
            near = max(finer) if finer else min(coarser)
            steps = math.log2(self.tried[near] / self._target) / self.slope
            return near + (math.ceil(steps) if finer else math.floor(steps))
        first, last = max(finer), min(coarser)
        if last - first < 2:
            return first
        whole, part = (math.log(self.tried[first] / to) for to in (self.tried[last], self._target))
        return min(max(first + round(part / max(whole, 1e-9) * (last - first)), first + 1), last - 1)


def coarser_qp(qp: int, num_bits: float, max_bits: float) -> int:
    """Return a QP with fewer bits, which probably fit."""
    return min(qp + math.ceil(math.log2(num_bits / max_bits) / OCTAVES_PER_STEP[0] / STEPS), MAX_QP)
