"""Compiled loops of reconciliation: beliefs passed between bits and ranges of known parity; no validation.

Orders are numbered k, positions in an order j, bits n.
Numbers of literals would be compiled apart: `np.int64(0)`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.slepian_wolf._kernels import llr_of, odds_of_zero

_SURE = 1.0 - 1e-6  # no range makes a bit surer than this
_SMALL_CHANGE = 1e-4  # change of the expected errors in a range that is not propagated
_NEGLIGIBLE_CHANGE = 2e-6  # the same for the probability of a single bit
_NEGLIGIBLE_BELIEF = 2e-4  # change of the probability of a bit that its neighbours need not know of
_SMALL_ODDS = 1.0 / 64
_NO_DIVISION = 2.0
_HASH, _MIX = 0x9E3779B97F4A7C15, 0x94D049BB133111EB  # constants of SplitMix64


class Beliefs(NamedTuple):
    """Beliefs of a plane, by the ranges of orders of its bits."""

    orders: NDArray[np.uint32]  # (K, N), bit at each position
    last: NDArray[np.int32]  # (K, N), end of the range that holds a position
    ends: NDArray[np.int32]  # (N, K), the same for each bit
    first: NDArray[np.int32]  # (K, N), start of the range that ends there
    prefix: NDArray[np.uint8]  # (K, N), parity of errors up to the end of a range
    prior: NDArray[np.float64]  # (N,), odds that a bit differs from its first decision
    odds: NDArray[np.float64]  # (N,), the same by all parities: the product of the prior and all messages
    messages: NDArray[np.float64]  # (K, N), factors on the odds of the bit at a position
    # (K, N) at ends of ranges: by how much beliefs of its bits have changed since they were passed on, the
    # errors expected in it then, and whether it is to be found out again where to divide it
    pending: NDArray[np.float64]
    expected: NDArray[np.float64]
    stale: NDArray[np.uint8]
    # (K, N) at ends of ranges: after which position to divide, and 2 |p - 1/2| of the parity there
    division: NDArray[np.int32]
    bias: NDArray[np.float64]
    work: NDArray[np.float64]  # (3, N)


class Coupled(NamedTuple):
    """Beliefs of bits that depend on their neighbours."""

    base: NDArray[np.float64]  # (rows, columns), probability of a 1 if the neighbours are unknown
    deviation: NDArray[np.float64]  # (rows, columns), belief minus `base`
    places: NDArray[np.int64]  # (N,), raster index of each bit
    decided: NDArray[np.uint8]  # (N,), first decisions
    llr: NDArray[np.float32]  # (N,), LLRs that priors follow from
    bound: NDArray[np.float32]  # (1,), of their magnitude
    marks: NDArray[np.uint8]  # (rows * columns,)


@kernel
def _soft(odds):
    """Return 1 - 2 p = (1 - odds) / (1 + odds); by its series, which is quicker, where odds are small."""
    if odds < _SMALL_ODDS:
        return 1.0 - 2.0 * odds * (1.0 - odds * (1.0 - odds * (1.0 - odds)))
    return (1.0 - odds) / (1.0 + odds)


@kernel
def _change_of_probability(low, high):
    """Return by how much the probability differs between two odds; where both are small, their difference."""
    change = high - low
    return change if high < _SMALL_ODDS else change / ((1.0 + low) * (1.0 + high))


@kernel
def _is_odd(prefix, order, start, end):
    return prefix[order, end] != (prefix[order, start - 1] if start else 0)


@kernel
def _pass_range(beliefs, order, start, end, num_orders):
    """Bring the messages of one range up to date; mark what depends on them; return the errors expected."""
    orders, messages, total = beliefs.orders, beliefs.messages, beliefs.odds
    odds, soft, others = beliefs.work[0], beliefs.work[1], beliefs.work[2]
    behind = -1.0 if _is_odd(beliefs.prefix, order, start, end) else 1.0
    expected = 0.0
    for j in range(end, start - 1, -1):
        odds[j] = total[orders[order, j]] / messages[order, j]
        soft[j] = _soft(odds[j])
        expected += 0.5 - 0.5 * soft[j]
        others[j] = behind
        behind *= soft[j]
    before = 1.0
    for j in range(start, end + 1):
        bit = orders[order, j]
        product = min(max(before * others[j], -_SURE), _SURE)
        before *= soft[j]
        old, new = messages[order, j], (1.0 - product) / (1.0 + product)
        messages[order, j], total[bit] = new, odds[j] * new
        change = _change_of_probability(odds[j] * min(old, new), odds[j] * max(old, new))
        if change < _NEGLIGIBLE_CHANGE:
            continue
        for k in range(num_orders):
            if k != order:
                beliefs.pending[k, beliefs.ends[bit, k]] += change
    return expected


@kernel
def propagate(beliefs, num_orders, stop, max_sweeps, share):
    """Pass beliefs through ranges where more than a `share` has changed; return the sweeps done.

    The range of the last order that starts at `stop` is not looked at.
    """
    last, pending, expected = beliefs.last, beliefs.pending, beliefs.expected
    num_bits = beliefs.prior.size
    for sweep in range(max_sweeps):
        quiet = True
        for k in range(num_orders):
            start = np.int64(0)
            while start < (stop if k + 1 == num_orders else num_bits):
                end = last[k, start]
                if pending[k, end] > share * expected[k, end] + _SMALL_CHANGE:
                    quiet = False
                    pending[k, end] = 0.0
                    beliefs.stale[k, end] = 1
                    expected[k, end] = _pass_range(beliefs, k, start, end, num_orders)
                start = end + 1
        if quiet:
            return sweep
    return max_sweeps


@kernel
def _note_beliefs(coupled, odds):
    """Note which bits are believed otherwise than before, and mark them and their neighbours."""
    deviation, marks = coupled.deviation.ravel(), coupled.marks
    base, columns = coupled.base.ravel(), coupled.deviation.shape[1]
    marks[:] = 0
    for n in range(odds.size):
        wrong, place = odds[n] / (1.0 + odds[n]), coupled.places[n]
        found = (1.0 - wrong if coupled.decided[n] else wrong) - base[place]
        if abs(found - deviation[place]) > _NEGLIGIBLE_BELIEF:
            deviation[place] = found
            column = place % columns
            marks[place - columns if place >= columns else place] = 1
            marks[place + columns if place + columns < marks.size else place] = 1
            marks[place - 1 if column else place] = 1
            marks[place + 1 if column + 1 < columns else place] = 1


@kernel
def couple(beliefs, num_orders, lattice, coupled, scale, least_change):
    """Update prior odds from beliefs of neighbours; return the number of changes, and the errors added."""
    prior, odds, ends = beliefs.prior, beliefs.odds, beliefs.ends
    columns = coupled.deviation.shape[1]
    count, more = 0, 0.0
    _note_beliefs(coupled, odds)
    for n in range(odds.size):
        place = coupled.places[n]
        if not coupled.marks[place]:
            continue
        found = np.float32(
            llr_of(lattice, coupled.deviation, place // columns, place % columns, np.bool_(False))
        )
        llr = min(max(found, -coupled.bound[0]), coupled.bound[0])
        if abs(llr - coupled.llr[n]) < least_change:
            continue
        before = prior[n] / scale
        base = 1.0 / np.float64(odds_of_zero(-llr if coupled.decided[n] else llr))
        coupled.llr[n], prior[n] = llr, base * scale
        more += base / (1.0 + base) - before / (1.0 + before)
        changed = odds[n] * (base / before)
        change = _change_of_probability(min(odds[n], changed), max(odds[n], changed))
        odds[n] = changed
        count += 1
        for k in range(num_orders):
            beliefs.pending[k, ends[n, k]] += change
    return count, more


@kernel
def divide(beliefs, order, positions, parities):
    """End ranges of an order at further positions with known parities of the errors before them."""
    last, first, pending, expected = beliefs.last, beliefs.first, beliefs.pending, beliefs.expected
    for i in range(positions.size):
        cut = positions[i]
        end = last[order, cut]
        beliefs.prefix[order, cut] = parities[i]
        if cut < end:
            start = first[order, end]
            first[order, cut] = start
            first[order, end] = cut + 1
            for j in range(start, cut + 1):
                last[order, j] = beliefs.ends[beliefs.orders[order, j], order] = cut
        pending[order, cut] = pending[order, end] = 1.0
        expected[order, cut] = expected[order, end] = 0.0
        beliefs.stale[order, cut] = beliefs.stale[order, end] = 1


@kernel
def _best_division(beliefs, order, start, end):
    """Return after which position the parity is nearest to a fair coin, and 2 |p - 1/2| there."""
    soft, behind = beliefs.work[0], beliefs.work[1]
    product = 1.0
    for j in range(end, start - 1, -1):
        soft[j] = _soft(beliefs.odds[beliefs.orders[order, j]])
        behind[j] = product
        product *= soft[j]
    sign = -1.0 if _is_odd(beliefs.prefix, order, start, end) else 1.0
    # P(even) - P(odd) of the part before is (before + sign * behind) / (1 + sign * product).
    total = 1.0 + sign * product
    best, at = _NO_DIVISION * total, end
    before = 1.0
    for j in range(start, end):
        before *= soft[j]
        difference = abs(before + sign * behind[j])
        if difference < best:
            best, at = difference, j
    return at, (best / total if total > 0.0 else _NO_DIVISION)


@kernel
def find_divisions(beliefs, num_orders, stop):
    """Update where to divide ranges, except the last order's from `stop` on; return the least bias."""
    least = _NO_DIVISION
    for k in range(num_orders):
        start = np.int64(0)
        while start < (stop if k + 1 == num_orders else beliefs.prior.size):
            end = beliefs.last[k, start]
            if beliefs.stale[k, end]:
                beliefs.stale[k, end] = 0
                at, bias = _best_division(beliefs, k, start, end)
                beliefs.division[k, end], beliefs.bias[k, end] = at, bias
            least = min(least, beliefs.bias[k, end])
            start = end + 1
    return least


@kernel
def choose_divisions(beliefs, order, stop, max_bias, positions):
    """Collect divisions of an order up to `stop` with at most this bias; return count and information."""
    last, bias = beliefs.last, beliefs.bias
    count, information = 0, 0.0
    start = np.int64(0)
    while start < stop:
        end = last[order, start]
        if bias[order, end] <= max_bias:
            positions[count] = beliefs.division[order, end]
            count += 1
            information += 1.0 - bias[order, end] * bias[order, end]
        start = end + 1
    return count, information


@kernel
def lay_out(orders, order, start, odds, max_bias, positions):
    """Divide the rest of an order into ranges, each with as many bits as bring 1 - 2 P(odd) to `max_bias`."""
    count, bias = 0, 1.0
    for j in range(start, odds.size):
        x = odds[orders[order, j]]
        bias *= abs(1.0 - x) / (1.0 + x)
        if bias < max_bias:
            positions[count] = j
            count += 1
            bias = 1.0
    if count and (positions[count - 1] == odds.size - 1 or bias * bias > max_bias):
        count -= 1
    return count


@kernel
def num_unsatisfied(beliefs, num_orders):
    """Count the ranges with another parity than the decisions have."""
    orders, last, odds = beliefs.orders, beliefs.last, beliefs.odds
    count = 0
    for k in range(num_orders):
        parity, start = np.uint8(0), np.int64(0)
        for j in range(odds.size):
            parity ^= np.uint8(odds[orders[k, j]] > 1.0)
            if last[k, j] == j:
                if (parity == 1) != _is_odd(beliefs.prefix, k, start, j):
                    count += 1
                parity, start = np.uint8(0), j + 1
    return count


@kernel
def range_keys(beliefs, num_orders, keys):
    """Give each bit a number (uint64) that depends on the ranges that contain it."""
    keys[:] = np.uint64(0)
    for bit in range(keys.size):
        for k in range(num_orders):
            mixed = (keys[bit] + np.uint64(beliefs.ends[bit, k] + 1)) * np.uint64(_HASH)
            keys[bit] = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(_MIX)


@kernel
def pair_odds(by_key, keys, prior, odds):
    """Add up the odds of all pairs of further errors that no parity shows: both bits in the same ranges."""
    total, single, squares = 0.0, 0.0, 0.0
    for i in range(by_key.size):
        bit = by_key[i]
        weight = 1.0 / prior[bit] if odds[bit] > 1.0 else prior[bit]
        if i and keys[bit] != keys[by_key[i - 1]]:
            total += 0.5 * (single * single - squares)
            single = squares = 0.0
        single += weight
        squares += weight * weight
    return total + 0.5 * (single * single - squares)


@kernel
def expected_errors(odds):
    """Return the expected number of bits that differ from their first, and from their present, decisions."""
    first = present = 0.0
    for n in range(odds.size):
        first += odds[n] / (1.0 + odds[n])
        present += min(odds[n], 1.0) / (1.0 + odds[n])
    return first, present


@kernel
def uncertainty_bits(odds):
    """Return the approximate entropy in bits: (4 p (1 - p))^(3/4) is close to that of each bit."""
    total = 0.0
    for n in range(odds.size):
        soft = _soft(odds[n])
        root = np.sqrt(max(1.0 - soft * soft, 0.0))
        total += root * np.sqrt(root)
    return total


@kernel
def prefix_parities(words, order, released):
    """Sum words modulo 2 in an order up to and including each position."""
    total, size, count = np.uint64(0), np.uint32(words.size), 0
    for j in range(order.size):
        if order[j] < size:
            total ^= words[order[j]]
            released[count] = total
            count += 1
