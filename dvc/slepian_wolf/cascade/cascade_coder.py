"""Cascade: decoding of bit planes by requests for parities of ranges, each as uncertain as possible; no I/O.

This is the interactive reconciliation of quantum key distribution (Cascade) with two changes: side
information gives the probability that each bit is wrong, and beliefs combine all parities. Each plane is
decoded until it is likely right, then all of a frame are checked together: check bits that make sure of one
plane cost more than a plane of low entropy itself.
"""

import math
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from dvc.config import CascadeConfig
from dvc.slepian_wolf.cascade import _kernels
from dvc.slepian_wolf.cascade.posterior import NUM_ORDERS, Positions, RangePosterior, order_of_power
from dvc.slepian_wolf.checks import CRC_BITS, crc, joint_check
from dvc.slepian_wolf.coupling import NeighbourCoupling, bounded_llr, entropy_bits, ideal_bits
from dvc.slepian_wolf.plane_protocol import FrameCheck, PlaneCoroutine, PlaneCost, PlaneResult, Words
from dvc.slepian_wolf.requests import Bits, Kind, ParityRequest, ask

ERROR_EXPONENT = 8
"""A plane is accepted by itself when the odds against it are below 2 to minus this."""
UNCODED_ENTROPY = 0.95
"""Entropy per bit above which a plane is requested uncoded."""
WORTH_ASKING = 0.5
"""Largest 2 |p - 1/2| of a requested answer while other answers of an order are as informative; this, the
next one, `SWEEPS`, `CHANGE` and `posterior.MORE_BITS` were found by `benchmarks.searches.requests`."""
RANGE_BIAS = 0.15
"""The same for the initial ranges of an order."""
UNSURE_ERRORS = 0.5
"""Number of expected errors above which a check is pointless."""
FIRST_PARTITION = 2
"""Half the number of ranges of a new order after wrong beliefs; the number doubles each time."""
SWEEPS, LAST_SWEEPS = 4, 40
"""Sweeps of beliefs after an answer, and before decisions are checked."""
CHANGE = 0.02
"""Least change that is propagated, as a share of the errors expected in a range."""
LEAST_PROBABILITY = 2.0**-60
SEARCH_BITS = 6
"""Check bits of half of the planes that are asked for, to find one that is wrong."""


class PlaneReconciliation:
    """State of one plane while it is decoded, and for as long as it may turn out to be wrong."""

    def __init__(
        self,
        llr_ch: NDArray[np.floating],
        settings: CascadeConfig,
        position: tuple[int, int] = (0, 0),
        coupling: NeighbourCoupling | None = None,
    ) -> None:
        self._llr = bounded_llr(llr_ch)
        self._batch = settings.batch_percent / 100, WORTH_ASKING, RANGE_BIAS
        self._position = position
        self._coupling = coupling
        self._entropy_bits = entropy_bits(self._llr)
        self._check = np.zeros(0, np.uint8)
        self._answers: list[tuple[int, Positions, Bits]] = []
        self._fetched: Bits | None = None
        self._num_parity = self._num_requests = self._sweeps = self._restarts = 0

    def decode(self, posterior: RangePosterior) -> PlaneCoroutine:
        """Decode the plane as a coroutine: it yields requests and is sent the bits."""
        if self._entropy_bits >= UNCODED_ENTROPY * self._llr.size:
            return (yield from self._fetch())
        posterior.start(self._llr, self._coupling)
        return (yield from self._go_on(posterior, ERROR_EXPONENT))

    def correct(self, posterior: RangePosterior) -> PlaneCoroutine:
        """Decode the plane again, and let all check bits confirm it; nothing is asked for twice."""
        posterior.start(self._llr, self._coupling)
        for order, positions, bits in self._answers:
            posterior.add_answers(order, positions, bits)
        yield from self._request_check(CRC_BITS)
        return (yield from self._go_on(posterior, CRC_BITS))

    def _go_on(self, posterior: RangePosterior, exponent: int) -> PlaneCoroutine:
        while True:
            # Ask as long as answers are informative.
            self._sweeps += posterior.propagate(SWEEPS, CHANGE)
            if posterior.num_orders and posterior.couple():
                self._sweeps += posterior.propagate(SWEEPS, CHANGE)
            question = posterior.batch(*self._batch)
            if not question and posterior.num_orders and posterior.rescale():
                self._sweeps += posterior.propagate(SWEEPS, CHANGE)
                question = posterior.batch(*self._batch)
            question = question or posterior.new_order(RANGE_BIAS)
            if not question and (yield from self._accept(posterior, exponent)):
                return self._result(posterior.decisions)
            # Little can be learned, but the plane is not right yet.
            if not question and posterior.expected_errors > UNSURE_ERRORS:
                question = posterior.best_divisions()
            if not question:  # beliefs are wrong but sure, so that they cannot say where to ask
                self._restarts += 1
                posterior.restart()
                question = posterior.partition(min(FIRST_PARTITION << self._restarts, self._llr.size))
            size = sum(positions.size for _, positions in question)
            if not question or self._num_parity + size > self._llr.size:
                return (yield from self._fetch())
            first, stop = question[0][0], 0
            behind = [(order - first) * self._llr.size + positions for order, positions in question]
            wanted = tuple(np.concatenate(behind).tolist())
            bits = yield from self._request("parity", first, self._num_parity, size, wanted)
            self._num_parity += size
            for order, positions in question:
                start, stop = stop, stop + positions.size
                self._answers.append((order, positions, bits[start:stop]))
                posterior.add_answers(*self._answers[-1])

    def _accept(self, posterior: RangePosterior, exponent: int) -> Generator[ParityRequest, Bits, bool]:
        """Return whether the decisions are right; request as many check bits as that takes."""
        self._sweeps += posterior.propagate(LAST_SWEEPS, CHANGE)
        if posterior.expected_errors > UNSURE_ERRORS or not posterior.is_satisfied():
            return False
        decisions = posterior.decisions
        if not self._checks(decisions):
            return False
        mantissa, power = math.frexp(max(posterior.residual_errors(), LEAST_PROBABILITY))
        wanted = exponent + power - (mantissa == 0.5)  # the logarithm of the errors left, rounded up
        yield from self._request_check(min(wanted, CRC_BITS))
        return self._checks(decisions)

    def _checks(self, bits: Bits) -> bool:
        return bool((crc(bits, CRC_BITS)[: self._check.size] == self._check).all())

    def _request_check(self, wanted: int) -> Generator[ParityRequest, Bits, None]:
        missing = wanted - self._check.size
        if missing > 0:
            new = yield from self._request("crc", 0, self._check.size, missing)
            self._check = np.concatenate([self._check, new])

    def _fetch(self) -> PlaneCoroutine:
        """Ask for the bits themselves, unless they have come before."""
        if self._fetched is None:
            self._fetched = yield from self._request("uncoded", 0, 0, self._llr.size)
            self._num_parity += self._fetched.size
        return self._result(self._fetched)

    def _request(
        self, kind: Kind, code: int, start: int, count: int, positions: tuple[int, ...] = ()
    ) -> Generator[ParityRequest, Bits, Bits]:
        self._num_requests += 1
        return (yield from ask(ParityRequest(*self._position, kind, code, start, count, positions)))

    def _result(self, bits: Bits) -> PlaneResult:
        llr = self._llr
        if self._coupling is not None:
            llr = bounded_llr(self._coupling.llr_given(bits, causal=True))
        counts = self._num_requests, self._check.size, self._num_parity, self._sweeps
        return PlaneResult(bits.copy(), *counts, self._entropy_bits, ideal_bits(llr, bits))


class CascadeDecoder:
    """Decodes the planes of one frame after another."""

    cost = PlaneCost(1.06, 6.0)

    def __init__(self, settings: CascadeConfig, seed: int) -> None:
        self._settings, self._seed = settings, seed
        self._planes: dict[int, tuple[PlaneReconciliation, PlaneResult]] = {}

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int] = (0, 0),
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a run of bits as a coroutine: it yields requests and is sent the bits."""
        plane = PlaneReconciliation(llr_ch, self._settings, position, coupling)
        result = yield from plane.decode(RangePosterior(len(llr_ch), self._seed))
        self._planes[position[1]] = plane, result
        return result

    def check(self, frame: int = 0) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Check all planes since the last check together, and correct those that are wrong."""
        planes, self._planes = self._planes, {}
        checks = {number: crc(result.bits, CRC_BITS) for number, (_, result) in planes.items()}
        answers: dict[tuple[int, ...], Bits] = {}
        charged: dict[int, int] = {}  # bits that were asked for by the first of their planes
        num_requests = 0

        def holds(numbers: list[int], count: int) -> Generator[ParityRequest, Bits, bool]:
            """Return whether the check of some planes is the encoder's; request it if it is unknown."""
            nonlocal num_requests
            key = tuple(numbers)
            if key not in answers or answers[key].size < count:
                start = charged.get(key[0], 0)
                answers[key] = yield from ask(ParityRequest(frame, key[0], "joint", 0, start, count, key))
                charged[key[0]] = start + count
                num_requests += 1
            decoded = joint_check(np.stack([checks[number] for number in numbers]))
            return np.array_equal(decoded[: answers[key].size], answers[key])

        if not planes:
            return FrameCheck()
        corrected: dict[int, PlaneResult] = {}
        suspects, search_bits = sorted(planes), SEARCH_BITS
        while not (success := (yield from holds(sorted(planes), CRC_BITS))) and suspects:
            wrong = suspects  # one of these probably is
            while len(wrong) > 1:
                half = wrong[: len(wrong) // 2]
                wrong = wrong[len(wrong) // 2 :] if (yield from holds(half, search_bits)) else half
            number = wrong[0]
            suspects.remove(number)
            posterior = RangePosterior(planes[number][1].bits.size, self._seed)
            corrected[number] = yield from planes[number][0].correct(posterior)
            checks[number] = crc(corrected[number].bits, CRC_BITS)
            if np.array_equal(corrected[number].bits, planes[number][1].bits):
                search_bits = CRC_BITS  # a wrong plane must have passed for right
        return FrameCheck(corrected, num_requests, sum(charged.values()), success)


class CascadeCoder:
    """Parities of ranges of several orders of the bits, which the decoder chooses."""

    num_codes = NUM_ORDERS
    by_positions = True

    def __init__(self, settings: CascadeConfig, seed: int) -> None:
        self._settings, self._seed = settings, seed

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Compute the parities of all that comes first in one of the orders, of up to 64 planes."""
        order = order_of_power(code, (words.size - 1).bit_length(), self._seed)
        _kernels.prefix_parities(words, order, parity)

    def decoder(self, num_bits: int) -> CascadeDecoder:
        """Return a decoder of planes."""
        del num_bits
        return CascadeDecoder(self._settings, self._seed)
