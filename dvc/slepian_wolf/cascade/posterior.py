"""What is known of the errors of a plane: prior odds, and parities of ranges in several orders."""

import math

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels as shared_kernels
from dvc.slepian_wolf.cascade import _kernels
from dvc.slepian_wolf.cascade.orders import bit_orders
from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.llr import MAX_LLR

Bits = NDArray[np.uint8]
Positions = NDArray[np.int64]

MAX_SCALE_CHANGE = 1.1
"""Factor on the prior odds that is learned from parities, from which on it is used."""
CERTAIN = 0.999
"""2 |p - 1/2| of answers from which on they are not worth asking for."""
MIN_COUPLED_CHANGE = 0.01
"""Change of an LLR by what neighbours tell, from which on it is used: of 0.1 planes cost 0.3 % more."""
MIN_BATCH = 3.0
"""Least information of the answers to one request of several orders, in bits, if they have it."""
FIRST_ORDERS = 6
"""Most orders that the first request is about, where one may be about several."""
SCALE_STRENGTH = 5.0
"""Errors that must be expected besides those of the plane, lest a few of them change the prior."""


class RangePosterior:
    """Beliefs of errors, by the prior and by what was answered so far."""

    def __init__(self, num_bits: int, seed: int) -> None:
        self._orders, self._ranks = bit_orders(num_bits, seed)
        shape = self._orders.shape
        self._beliefs = _kernels.Beliefs(
            self._orders,
            self._ranks,
            last=np.empty(shape, np.int32),
            first=np.empty(shape, np.int32),
            prefix=np.empty(shape, np.uint8),
            prior=np.zeros(num_bits),
            messages=np.empty(shape[::-1]),
            pending=np.empty(shape),
            expected=np.empty(shape),
            stale=np.empty(shape, np.uint8),
            division=np.empty(shape, np.int32),
            bias=np.empty(shape),
            work=np.empty((3, num_bits)),
        )
        self._positions = np.empty(num_bits, np.int64)
        self._keys = np.empty(num_bits, np.uint64)
        self._first_decisions: Bits = np.zeros(num_bits, np.uint8)
        self._decided_prefix: dict[int, Bits] = {}  # parities of the first decisions in an order
        self._coupling: NeighbourCoupling | None = None
        self._coupled: _kernels.Coupled | None = None
        self._odds = np.zeros(num_bits)
        self._odds_known = False
        self._expected = 0.0
        self._scale = 1.0
        self.num_orders = 0

    @property
    def num_bits(self) -> int:
        """Length N of the plane."""
        return self._odds.size

    @property
    def orders_left(self) -> int:
        """Orders of which nothing is known yet."""
        return len(self._orders) - self.num_orders

    @property
    def decisions(self) -> Bits:
        """Most likely value of each bit by itself."""
        bits: Bits = self._first_decisions ^ (self._all_odds() > 1.0)
        return bits

    @property
    def expected_errors(self) -> float:
        """Number of wrong decisions to be expected by the beliefs."""
        return float(_kernels.expected_errors(self._all_odds())[1])

    def start(self, llr_ch: NDArray[np.float32], coupling: NeighbourCoupling | None = None) -> None:
        """Begin a new plane."""
        self._first_decisions = (llr_ch < 0).astype(np.uint8)
        self._coupling, self._coupled = coupling, None
        if coupling is not None:
            self._coupled = _kernels.Coupled(
                coupling.probability_alone,
                deviation=np.zeros(coupling.alone.shape),
                decided=self._first_decisions,
                llr=llr_ch.copy(),
                bound=np.array([MAX_LLR], np.float32),
                marks=np.empty(self.num_bits, np.uint8),
            )
        beliefs = self._beliefs
        beliefs.prior[:] = self._prior_odds(llr_ch)
        self._odds_known = False
        self._expected = float(_kernels.expected_errors(beliefs.prior)[0])
        self._scale = 1.0
        self.num_orders = 0
        beliefs.last[:] = self.num_bits - 1
        beliefs.first[:] = 0
        beliefs.prefix[:] = 0
        beliefs.messages[:] = 1.0
        self._decided_prefix = {}

    def _prior_odds(self, llr: NDArray[np.float32]) -> NDArray[np.float64]:
        """Odds that each bit differs from its first decision, by LLRs alone."""
        right, wrong = np.empty_like(llr), np.empty_like(llr)
        shared_kernels.bit_probabilities(np.where(self._first_decisions, -llr, llr), right, wrong)
        return wrong.astype(np.float64) / right

    def add_answers(self, order: int, positions: Positions, bits: Bits) -> None:
        """Take in parities."""
        beliefs = self._beliefs
        if order == self.num_orders:
            self.num_orders += 1
            beliefs.prefix[order, -1] = beliefs.prefix[0, -1]  # every order ends with the parity of the plane
            beliefs.pending[order, -1], beliefs.expected[order, -1], beliefs.stale[order, -1] = 1.0, 0.0, 1
        if order not in self._decided_prefix:
            decided = self._first_decisions[self._orders[order]]
            self._decided_prefix[order] = np.bitwise_xor.accumulate(decided)
        errors = bits ^ self._decided_prefix[order][positions]
        _kernels.divide(beliefs, order, positions, errors)

    def propagate(self, max_sweeps: int, share: float) -> int:
        """Pass beliefs between bits and ranges until nothing changes any more."""
        sweeps = _kernels.propagate(self._beliefs, self.num_orders, max_sweeps, share)
        self._odds_known = False
        return int(sweeps)

    def _all_odds(self) -> NDArray[np.float64]:
        """Odds of an error in each bit by all beliefs."""
        if not self._odds_known:
            _kernels.odds_of_errors(self._beliefs, self.num_orders, self._odds)
            self._odds_known = True
        return self._odds

    def rescale(self) -> bool:
        """Let the prior expect as many errors as the beliefs do, all of its odds by the same factor."""
        found = float(_kernels.expected_errors(self._all_odds())[0])
        scale = (found + SCALE_STRENGTH) / (self._expected + SCALE_STRENGTH)
        change = scale / self._scale
        if 1.0 / MAX_SCALE_CHANGE < change < MAX_SCALE_CHANGE:
            return False
        prior = self._beliefs.prior
        prior *= change
        self._scale = scale
        self._touch_all()
        return True

    def couple(self) -> bool:
        """Let the prior of each bit follow from what is believed of its neighbours."""
        if self._coupling is None or self._coupled is None:
            return False
        count, more = _kernels.couple(
            self._beliefs, self.num_orders, self._coupling.lattice, self._coupled, self._all_odds(),
            self._scale, MIN_COUPLED_CHANGE,
        )  # fmt: skip
        self._expected += more
        return bool(count)

    def restart(self) -> None:
        """Forget all beliefs but the prior and the parities."""
        self._beliefs.messages[:] = 1.0
        self._touch_all()

    def _touch_all(self) -> None:
        self._beliefs.pending[: self.num_orders] = 1.0
        self._beliefs.expected[: self.num_orders] = 0.0
        self._beliefs.stale[: self.num_orders] = 1

    def divisions(self, max_bias: float) -> tuple[int, Positions] | None:
        """Choose what to ask next of an order that is in use."""
        self._find_divisions()
        best, chosen = 0.0, None
        for order in range(self.num_orders):
            count, information = _kernels.choose_divisions(self._beliefs, order, max_bias, self._positions)
            if information > best:
                best, chosen = information, (order, self._positions[:count].copy())
        return chosen

    def batch(
        self, share: float, surplus_bits: float, max_bias: float, new_bias: float
    ) -> list[tuple[int, Positions]]:
        """Choose what to ask next at once, of several orders."""
        # Rounded: the last digit of a library's logarithm must not decide.
        unknown = round(_kernels.remaining_entropy(self._all_odds()) * 2.0**16) / 2.0**16
        wanted = max(share * unknown + surplus_bits, MIN_BATCH)
        found, information = self._informative_divisions(wanted, max_bias)
        if found and (not surplus_bits or information >= wanted):
            return found
        first = self.num_orders
        for order in range(first, min(len(self._orders), first + (1 if first else FIRST_ORDERS))):
            question = self._lay_out(order, new_bias)
            if question is None or (found and information + question[1].size > wanted):
                break
            found.append(question)
            information += question[1].size
            if information >= wanted:
                break
        return found

    def _informative_divisions(
        self, wanted: float, max_bias: float
    ) -> tuple[list[tuple[int, Positions]], float]:
        """Choose the divisions of all orders with the most information until it is enough; and how much."""
        self._find_divisions()
        beliefs = self._beliefs
        found, biases = [np.zeros((2, 0), np.int64)], [np.zeros(0)]
        for order in range(self.num_orders):
            count, _ = _kernels.choose_divisions(beliefs, order, max_bias, self._positions)
            positions = self._positions[:count].copy()
            found.append(np.stack([np.full(count, order), positions]))
            biases.append(beliefs.bias[order, beliefs.last[order, positions]])
        divisions, bias = np.concatenate(found, axis=1), np.concatenate(biases)
        best = np.argsort(bias, kind="stable")
        information = np.cumsum(1.0 - bias[best] ** 2)
        count = min(int(np.searchsorted(information, wanted)) + 1, best.size)
        orders, positions = divisions[:, best[:count]]
        chosen = [(int(order), np.sort(positions[orders == order])) for order in np.unique(orders)]
        return chosen, float(information[count - 1]) if count else 0.0

    def best_divisions(self) -> tuple[int, Positions] | None:
        """Choose what to ask where nothing tells much: all that tells at least half as much as the best."""
        self._find_divisions()
        bias = float(_kernels.least_bias(self._beliefs, self.num_orders))
        return None if bias >= CERTAIN else self.divisions(math.sqrt(0.5 + 0.5 * bias * bias))

    def _find_divisions(self) -> None:
        _kernels.find_divisions(self._beliefs, self.num_orders)

    def new_order(self, max_bias: float) -> tuple[int, Positions] | None:
        """Choose what to ask of the next order."""
        return self._lay_out(self.num_orders, max_bias) if self.orders_left else None

    def _lay_out(self, order: int, max_bias: float) -> tuple[int, Positions] | None:
        count = _kernels.lay_out(self._orders, order, self._all_odds(), max_bias, self._positions)
        positions = self._positions[:count].copy()
        if order == 0:  # the parity of the plane is not known yet
            positions = np.append(positions, self.num_bits - 1)
        return (order, positions) if positions.size else None

    def partition(self, num_ranges: int) -> tuple[int, Positions] | None:
        """Divide the next order, or once all are in use the last one, evenly, which shows any errors."""
        order = min(self.num_orders, len(self._orders) - 1)
        if order == self.num_orders:
            ends = np.arange(1, num_ranges + (order == 0)) * self.num_bits // num_ranges - 1
        else:
            ends = np.flatnonzero(self._beliefs.last[order] == np.arange(self.num_bits))
            ends = (np.concatenate([[-1], ends[:-1]]) + ends) // 2
        known = (self._beliefs.last[order] == np.arange(self.num_bits)) & (order < self.num_orders)
        positions = np.unique(ends[ends >= 0])
        positions = positions[~known[positions]].astype(np.int64)
        return (order, positions) if positions.size else None

    def is_satisfied(self) -> bool:
        """Say whether the decisions agree with all parities."""
        return not _kernels.num_unsatisfied(self._beliefs, self._all_odds(), self.num_orders)

    def residual_errors(self) -> float:
        """Return the odds against decisions that agree with all parities."""
        if not self.num_orders:
            return self.expected_errors
        _kernels.range_keys(self._beliefs, self.num_orders, self._keys)
        by_key = np.argsort(self._keys, kind="stable")
        pairs = _kernels.pair_odds(by_key, self._keys, self._beliefs.prior, self._all_odds())
        return float(pairs) + self.expected_errors
