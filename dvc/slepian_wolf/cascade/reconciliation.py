"""Decoding of one bit plane by requests for parities of ranges, each as uncertain as possible; no I/O.

This is the interactive reconciliation of quantum key distribution (Cascade) with two changes: side
information gives the probability that each bit is wrong, and beliefs combine all parities.
"""

import math
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from dvc.config import CascadeConfig
from dvc.slepian_wolf.cascade.posterior import Positions, RangePosterior
from dvc.slepian_wolf.checks import CRC_BITS, crc
from dvc.slepian_wolf.coupling import NeighbourCoupling, bounded_llr, entropy_bits, ideal_bits
from dvc.slepian_wolf.plane_protocol import PlaneCoroutine, PlaneResult
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


Question = list[tuple[int, Positions]]
"""Orders that follow each other, with the positions that are asked for in each."""


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
        self._share = settings.batch_percent / 100
        self._position = position
        self._coupling = coupling
        self._entropy_bits = entropy_bits(self._llr)
        self._check = np.zeros(0, np.uint8)
        self._answers: list[tuple[int, Positions, Bits]] = []
        self._fetched: Bits | None = None
        self._num_parity = 0
        self._num_requests = 0
        self._sweeps = 0
        self._restarts = 0

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
            question = self._next_question(posterior)
            if not question and (yield from self._accept(posterior, exponent)):
                return self._result(posterior.decisions)
            question = question or self._last_question(posterior)
            size = sum(positions.size for _, positions in question)
            if not question or self._num_parity + size > self._llr.size:
                return (yield from self._fetch())
            yield from self._ask(posterior, question)

    def _next_question(self, posterior: RangePosterior) -> Question:
        """Choose queries as long as answers are informative."""
        self._sweeps += posterior.propagate(SWEEPS, CHANGE)
        if posterior.num_orders and posterior.couple():
            self._sweeps += posterior.propagate(SWEEPS, CHANGE)
        question = self._worth_asking(posterior)
        if not question and posterior.num_orders and posterior.rescale():
            self._sweeps += posterior.propagate(SWEEPS, CHANGE)
            question = self._worth_asking(posterior)
        return question or _only(posterior.new_order(RANGE_BIAS))

    def _worth_asking(self, posterior: RangePosterior) -> Question:
        return posterior.batch(self._share, WORTH_ASKING, RANGE_BIAS)

    def _last_question(self, posterior: RangePosterior) -> Question:
        """Choose what to ask where little can be learned, but the plane is not right yet."""
        question = None
        if posterior.expected_errors > UNSURE_ERRORS:
            question = posterior.best_divisions()
        if question is None:
            # Beliefs are wrong but sure, so that they cannot say where to ask.
            self._restarts += 1
            posterior.restart()
            question = posterior.partition(min(FIRST_PARTITION << self._restarts, self._llr.size))
        return _only(question)

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

    def _ask(self, posterior: RangePosterior, question: Question) -> Generator[ParityRequest, Bits, None]:
        first = question[0][0]
        behind = [(order - first) * self._llr.size + positions for order, positions in question]
        wanted = tuple(np.concatenate(behind).tolist())
        bits = yield from self._request("parity", first, self._num_parity, len(wanted), wanted)
        self._num_parity += len(wanted)
        start = 0
        for order, positions in question:
            self._answers.append((order, positions, bits[start : start + positions.size]))
            posterior.add_answers(*self._answers[-1])
            start += positions.size

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
            llr = bounded_llr(self._coupling.llr_in_sequence(bits))
        return PlaneResult(
            bits.copy(),
            self._num_requests,
            self._check.size,
            self._num_parity,
            self._sweeps,
            self._entropy_bits,
            ideal_bits(llr, bits),
        )


def _only(question: tuple[int, Positions] | None) -> Question:
    return [] if question is None else [question]
