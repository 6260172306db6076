"""Beliefs of the errors of a plane: prior odds, and parities of ranges in several pseudo-random orders."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels as shared_kernels
from dvc.slepian_wolf.cascade import _kernels
from dvc.slepian_wolf.checks import random_permutation
from dvc.slepian_wolf.coupling import MAX_LLR, NeighbourCoupling

Bits = NDArray[np.uint8]
Positions = NDArray[np.int64]
Question = list[tuple[int, Positions]]
"""Orders that follow each other, with the positions that are asked for in each."""

NUM_ORDERS = 8
"""Orders of the bits that encoder and decoder share."""
MAX_SCALE_CHANGE = 1.1
"""Least factor on the prior odds, learned from parities, that is used."""
MORE_BITS = 32.0
"""Number of bits that count as unknown beyond those of the plane, so that its rest takes few requests."""
CERTAIN = 0.999
"""Largest 2 |p - 1/2| of answers that are worth a request."""
MIN_COUPLED_CHANGE = 0.01
"""Least change of an LLR by its neighbours that is used: with 0.1 planes cost 0.3 % more."""
SCALE_STRENGTH = 5.0
"""Errors that must be expected besides those of the plane, lest a few of them change the prior."""


@lru_cache(maxsize=8 * NUM_ORDERS)
def order_of_power(number: int, exponent: int, seed: int) -> NDArray[np.uint32]:
    """Return an order of a number of bits that is a power of two."""
    first_seed = (seed + 1) << 8  # apart from those of the turbo codes' interleavers
    order = random_permutation(first_seed + number, 1 << exponent).astype(np.uint32)
    order.flags.writeable = False
    return order


def bit_order(number: int, num_bits: int, seed: int) -> NDArray[np.uint32]:
    """Return an order of bits: that of the next power of two, without the bits that are too many."""
    order = order_of_power(number, (num_bits - 1).bit_length(), seed)
    return order if order.size == num_bits else order[order < num_bits]


class RangePosterior:
    """Beliefs of errors, from the prior and the answers so far."""

    def __init__(self, num_bits: int, seed: int) -> None:
        self._seed = seed
        shape = NUM_ORDERS, num_bits
        self._orders = np.empty(shape, np.uint32)
        self._orders_known = 0  # further orders take no memory
        self._beliefs = _kernels.Beliefs(
            self._orders,
            last=np.empty(shape, np.int32),
            ends=np.empty(shape[::-1], np.int32),
            first=np.empty(shape, np.int32),
            prefix=np.empty(shape, np.uint8),
            prior=np.zeros(num_bits),
            odds=np.zeros(num_bits),
            messages=np.empty(shape),
            pending=np.empty(shape),
            expected=np.empty(shape),
            stale=np.empty(shape, np.uint8),
            division=np.empty(shape, np.int32),
            bias=np.empty(shape),
            work=np.empty((3, num_bits)),
        )
        self._positions = np.empty(num_bits, np.int64)
        self._keys = np.empty(num_bits, np.uint64)

    @property
    def num_bits(self) -> int:
        """Length N of the plane."""
        return self._beliefs.odds.size

    @property
    def odds(self) -> NDArray[np.float64]:
        """Odds that each bit differs from its first decision, by all that is known."""
        return self._beliefs.odds

    @property
    def decisions(self) -> Bits:
        """Most likely value of each bit by itself."""
        bits: Bits = self._first_decisions ^ (self.odds > 1.0)
        return bits

    @property
    def expected_errors(self) -> float:
        """Number of wrong decisions to be expected by the beliefs."""
        return float(_kernels.expected_errors(self.odds)[1])

    def start(self, llr_ch: NDArray[np.float32], coupling: NeighbourCoupling | None = None) -> None:
        """Begin a new plane."""
        self._first_decisions: Bits = (llr_ch < 0).astype(np.uint8)
        self._coupling = coupling
        self._coupled: _kernels.Coupled | None = None
        if coupling is not None:
            self._coupled = _kernels.Coupled(
                coupling.base_probability,
                deviation=np.zeros(coupling.base.shape),
                places=coupling.places,
                decided=self._first_decisions,
                llr=llr_ch.copy(),
                bound=np.array([MAX_LLR], np.float32),
                marks=np.empty(coupling.base.size, np.uint8),
            )
        beliefs = self._beliefs
        right, wrong = np.empty_like(llr_ch), np.empty_like(llr_ch)
        shared_kernels.bit_probabilities(np.where(self._first_decisions, -llr_ch, llr_ch), right, wrong)
        beliefs.prior[:] = beliefs.odds[:] = wrong.astype(np.float64) / right
        self._expected = float(_kernels.expected_errors(beliefs.prior)[0])
        self._scale = 1.0
        # Bits of the last order that have been laid out: now, and once all answers have come.
        self._laid_out = self._laid_after = self.num_bits
        self.num_orders = 0
        self._decided_prefix: dict[int, Bits] = {}  # parities of the first decisions in an order

    def add_answers(self, order: int, positions: Positions, bits: Bits) -> None:
        """Take in parities."""
        beliefs = self._beliefs
        if order == self.num_orders:  # begin it with one range; orders that no plane needs use no memory
            self._know_order(order)
            beliefs.last[order] = beliefs.ends[:, order] = self.num_bits - 1
            beliefs.first[order], beliefs.messages[order] = 0, 1.0
            beliefs.prefix[order, -1] = beliefs.prefix[0, -1] if order else 0  # the parity of the plane
            beliefs.pending[order, -1], beliefs.expected[order, -1], beliefs.stale[order, -1] = 1.0, 0.0, 1
            decided = self._first_decisions[self._orders[order]]
            self._decided_prefix[order] = np.bitwise_xor.accumulate(decided)
            self.num_orders += 1
        self._laid_out = self._laid_after
        errors = bits ^ self._decided_prefix[order][positions]
        _kernels.divide(beliefs, order, positions, errors)

    def propagate(self, max_sweeps: int, share: float) -> int:
        """Pass beliefs between bits and ranges until nothing changes any more."""
        return int(_kernels.propagate(self._beliefs, self.num_orders, self._laid_out, max_sweeps, share))

    def rescale(self) -> bool:
        """Scale all prior odds by one factor, so that the prior expects as many errors as the beliefs."""
        found = float(_kernels.expected_errors(self.odds)[0])
        scale = (found + SCALE_STRENGTH) / (self._expected + SCALE_STRENGTH)
        change = scale / self._scale
        if 1.0 / MAX_SCALE_CHANGE < change < MAX_SCALE_CHANGE:
            return False
        self._beliefs.prior[:] *= change
        self._beliefs.odds[:] *= change
        self._scale = scale
        self._touch_all()
        return True

    def couple(self) -> bool:
        """Update the prior of each bit from the beliefs of its neighbours."""
        if self._coupling is None or self._coupled is None:
            return False
        how = self._coupling.lattice, self._coupled, self._scale, MIN_COUPLED_CHANGE
        count, more = _kernels.couple(self._beliefs, self.num_orders, *how)
        self._expected += more
        return bool(count)

    def restart(self) -> None:
        """Forget all beliefs but the prior and the parities."""
        self._beliefs.messages[: self.num_orders] = 1.0
        self._beliefs.odds[:] = self._beliefs.prior
        self._touch_all()

    def _touch_all(self) -> None:
        self._beliefs.pending[: self.num_orders] = 1.0
        self._beliefs.expected[: self.num_orders] = 0.0
        self._beliefs.stale[: self.num_orders] = 1

    def divisions(self, max_bias: float) -> tuple[Question, float]:
        """Choose the divisions of the most informative order in use; return them with their information."""
        _kernels.find_divisions(self._beliefs, self.num_orders, self._laid_out)
        best: float = 0.0
        chosen: Question = []
        for order in range(self.num_orders):
            stop = self._laid_out if order + 1 == self.num_orders else self.num_bits
            count, information = _kernels.choose_divisions(
                self._beliefs, order, stop, max_bias, self._positions
            )
            if information > best:
                best, chosen = information, [(order, self._positions[:count].copy())]
        return chosen, best

    def batch(self, share: float, max_bias: float, new_bias: float) -> Question:
        """Choose the queries of the next round; none if no order in use is informative."""
        found, information = self.divisions(max_bias)
        if not found:
            return []
        # If divisions give less than a share of the unknown bits, ranges of the next order are added up to
        # that share, at least as many as there are orders in use: more orders cost time.
        missing = round(share * (_kernels.uncertainty_bits(self.odds) + MORE_BITS) - information)
        if missing >= (self.num_orders if self._laid_out == self.num_bits else 1):
            for order, positions in self.new_order(new_bias):
                if missing < positions.size:  # leave the rest of the order for later
                    self._laid_after = int(positions[missing - 1]) + 1
                found.append((order, positions[:missing]))
        # The entries of each order come next to each other, in order.
        orders = sorted({order for order, _ in found})
        parts = [np.concatenate([own for order, own in found if order == number]) for number in orders]
        return [(order, np.sort(own)) for order, own in zip(orders, parts, strict=True)]

    def best_divisions(self) -> Question:
        """Choose queries if no answer is informative: all within a factor of two of the best."""
        bias = float(_kernels.find_divisions(self._beliefs, self.num_orders, self._laid_out))
        return [] if bias >= CERTAIN else self.divisions(math.sqrt(0.5 + 0.5 * bias * bias))[0]

    def new_order(self, max_bias: float) -> Question:
        """Choose queries from the rest of the last order, or from the next one."""
        self._laid_after = self.num_bits
        if self.num_orders and self._laid_out < self.num_bits:
            rest = self._lay_out(self.num_orders - 1, max_bias, self._laid_out)
            if rest:
                return rest
            self._laid_out = self.num_bits
        return self._lay_out(self.num_orders, max_bias) if self.num_orders < NUM_ORDERS else []

    def _know_order(self, order: int) -> None:
        """Write down an order that is looked at for the first time."""
        if order >= self._orders_known:
            self._orders[order] = bit_order(order, self.num_bits, self._seed)
            self._orders_known = order + 1

    def _lay_out(self, order: int, max_bias: float, start: int = 0) -> Question:
        self._know_order(order)
        count = _kernels.lay_out(self._orders, order, start, self.odds, max_bias, self._positions)
        positions = self._positions[:count].copy()
        if order == 0 and not start:  # the parity of the plane is not known yet
            positions = np.append(positions, self.num_bits - 1)
        return [(order, positions)] if positions.size else []

    def partition(self, num_ranges: int) -> Question:
        """Divide the next order, or once all are in use the last one, evenly, which shows any errors."""
        order = min(self.num_orders, NUM_ORDERS - 1)
        self._laid_out = self._laid_after = self.num_bits
        if order == self.num_orders:
            ends = np.arange(1, num_ranges + (order == 0)) * self.num_bits // num_ranges - 1
        else:
            ends = np.flatnonzero(self._beliefs.last[order] == np.arange(self.num_bits))
            ends = (np.concatenate([[-1], ends[:-1]]) + ends) // 2
        known = (self._beliefs.last[order] == np.arange(self.num_bits)) & (order < self.num_orders)
        positions = np.unique(ends[ends >= 0])
        positions = positions[~known[positions]].astype(np.int64)
        return [(order, positions)] if positions.size else []

    def is_satisfied(self) -> bool:
        """Return whether the decisions agree with all parities."""
        return not _kernels.num_unsatisfied(self._beliefs, self.num_orders)

    def residual_errors(self) -> float:
        """Return the odds against decisions that agree with all parities."""
        if not self.num_orders:
            return self.expected_errors
        _kernels.range_keys(self._beliefs, self.num_orders, self._keys)
        by_key = np.argsort(self._keys, kind="stable")
        pairs = _kernels.pair_odds(by_key, self._keys, self._beliefs.prior, self.odds)
        return float(pairs) + self.expected_errors
