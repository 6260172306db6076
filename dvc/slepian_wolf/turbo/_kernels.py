"""Compiled loops of the turbo codec: SISO, message passing, re-encoding; no validation, no I/O."""

import numpy as np

from dvc._jit import kernel
from dvc.slepian_wolf._kernels import bit_probabilities, log_mantissa

NUM_LANES = 32
"""Trellis windows that one SISO call runs in lock step, one per SIMD lane."""

_ONE = np.float32(1.0)
_LN2 = np.float32(0.6931471805599453)
_METRIC_FLOOR = np.float32(1e-14)
_SUM_FLOOR = np.float32(1e-30)
MAX_DESCENT = 16
_MAX_EXPONENT = np.float32(80.0)
PIVOT_BLOCK = 6
_ZERO = np.float32(0.0)
MAX_EXTRINSIC = np.float32(24.0)

# Rows of NUM_LANES values that make up the record of one trellis step: scale, then the metrics of all states.
ROW_SCALE, ROW_METRIC = range(2)
_SCALE, _METRIC = (row * NUM_LANES for row in range(2))


@kernel
def log_clipped(ratio, limit):
    """Replace ratios by their logarithms, clipped to +-limit; flat float32 array, ratio > 0."""
    bits = ratio.view(np.int32)
    for i in range(ratio.size):
        whole = np.float32((bits[i] >> np.int32(23)) - np.int32(127))
        mantissa = np.int32((bits[i] & np.int32(0x7FFFFF)) | np.int32(0x3F800000)).view(np.float32)
        ratio[i] = min(max(whole * _LN2 + log_mantissa(mantissa), -limit), limit)


@kernel
def _select(label, g00, g01, g10, g11):
    if label == 0:
        return g00
    if label == 1:
        return g01
    if label == 2:
        return g10
    return g11


# The BCJR recursions need the trellis as constants to be vectorised over lanes, so each trellis has its own.
# Bit s of a mask is the input bit, or the parity bit, of the transition that leaves state s by shifting a 0
# in; the one that shifts a 1 in has both inverted. States k and k + S/2 share the successors 2k and 2k + 1.
#
# prob0, prob1 : (L * W,) a priori probabilities of the input bits. allow0, allow1 : (L * W,), 1 where the
# parity may be 0, or 1. work : (L + 1, R, W) flattened, see ROW_METRIC. edges : (2, S * W), metrics at the
# start and at the end of every lane. All float32.


@kernel
def _label(k, input_mask, parity_mask):
    return ((input_mask >> k) & 1) * 2 + ((parity_mask >> k) & 1)


def make_forward(num_states, input_mask, parity_mask):
    """Build the forward recursion of one trellis."""
    half = num_states // 2
    record = (ROW_METRIC + num_states) * NUM_LANES

    @kernel
    def forward(prob0, prob1, allow0, allow1, work, edges):
        """Write alpha of every step to `work`, from ``edges[0]`` on, and replace it by alpha at the end."""
        num_steps = prob0.size // NUM_LANES
        for i in range(num_states * NUM_LANES):
            work[_METRIC + i] = edges[0, i]
        for w in range(NUM_LANES):
            work[_SCALE + w] = _ONE
        for t in range(num_steps):
            now = work[t * record : (t + 2) * record]
            cells = slice(t * NUM_LANES, (t + 1) * NUM_LANES)
            p0_now, p1_now, allow0_now, allow1_now = prob0[cells], prob1[cells], allow0[cells], allow1[cells]
            for w in range(NUM_LANES):
                c0 = allow0_now[w] * now[_SCALE + w]
                c1 = allow1_now[w] * now[_SCALE + w]
                g00 = p0_now[w] * c0
                g01 = p0_now[w] * c1
                g10 = p1_now[w] * c0
                g11 = p1_now[w] * c1
                total = _SUM_FLOOR
                for k in range(half):
                    low = now[_METRIC + k * NUM_LANES + w]
                    high = now[_METRIC + (k + half) * NUM_LANES + w]
                    i = _label(k, input_mask, parity_mask)
                    j = _label(k + half, input_mask, parity_mask)
                    x0 = low * _select(i, g00, g01, g10, g11) + high * _select(j, g00, g01, g10, g11)
                    x1 = low * _select(3 - i, g00, g01, g10, g11) + high * _select(3 - j, g00, g01, g10, g11)
                    x0 = max(x0, _METRIC_FLOOR)
                    x1 = max(x1, _METRIC_FLOOR)
                    total += x0 + x1
                    now[record + _METRIC + 2 * k * NUM_LANES + w] = x0
                    now[record + _METRIC + (2 * k + 1) * NUM_LANES + w] = x1
                now[record + _SCALE + w] = _ONE / total
        tail = work[num_steps * record : (num_steps + 1) * record]
        for i in range(num_states * NUM_LANES):
            edges[0, i] = tail[_METRIC + i]

    return forward


def make_backward(num_states, input_mask, parity_mask):
    """Build the backward recursion of one trellis, which also sums up the extrinsic probabilities."""
    half = num_states // 2
    record = (ROW_METRIC + num_states) * NUM_LANES

    @kernel
    def backward(prob0, prob1, allow0, allow1, work, edges, ratio):
        """Run beta over `work`, from ``edges[1]`` on; replace it by beta at the lane's start."""
        num_steps = prob0.size // NUM_LANES
        tail = work[num_steps * record : (num_steps + 1) * record]
        for i in range(num_states * NUM_LANES):
            tail[_METRIC + i] = edges[1, i]
        for w in range(NUM_LANES):
            tail[_SCALE + w] = _ONE
        for back in range(num_steps):
            t = num_steps - 1 - back
            now = work[t * record : (t + 2) * record]
            cells = slice(t * NUM_LANES, (t + 1) * NUM_LANES)
            p0_now, p1_now, allow0_now, allow1_now = prob0[cells], prob1[cells], allow0[cells], allow1[cells]
            ratio_now = ratio[cells]
            for w in range(NUM_LANES):
                c0 = allow0_now[w] * now[record + _SCALE + w]
                c1 = allow1_now[w] * now[record + _SCALE + w]
                g00 = p0_now[w] * c0
                g01 = p0_now[w] * c1
                g10 = p1_now[w] * c0
                g11 = p1_now[w] * c1
                # Sums of alpha times beta by label of the transition.
                s00 = s01 = s10 = s11 = _ZERO
                total = _SUM_FLOOR
                for k in range(half):
                    even = now[record + _METRIC + 2 * k * NUM_LANES + w]
                    odd = now[record + _METRIC + (2 * k + 1) * NUM_LANES + w]
                    low = now[_METRIC + k * NUM_LANES + w]
                    high = now[_METRIC + (k + half) * NUM_LANES + w]
                    i = _label(k, input_mask, parity_mask)
                    j = _label(k + half, input_mask, parity_mask)
                    if i == 0 or i == 3:  # noqa: PLR1714 (numba unrolls this one)
                        s00 += low * (odd if i else even)
                        s11 += low * (even if i else odd)
                    else:
                        s01 += low * (even if i == 1 else odd)
                        s10 += low * (odd if i == 1 else even)
                    if j == 0 or j == 3:  # noqa: PLR1714
                        s00 += high * (odd if j else even)
                        s11 += high * (even if j else odd)
                    else:
                        s01 += high * (even if j == 1 else odd)
                        s10 += high * (odd if j == 1 else even)
                    y0 = even * _select(i, g00, g01, g10, g11) + odd * _select(3 - i, g00, g01, g10, g11)
                    y1 = even * _select(j, g00, g01, g10, g11) + odd * _select(3 - j, g00, g01, g10, g11)
                    y0 = max(y0, _METRIC_FLOOR)
                    y1 = max(y1, _METRIC_FLOOR)
                    total += y0 + y1
                    now[_METRIC + k * NUM_LANES + w] = y0
                    now[_METRIC + (k + half) * NUM_LANES + w] = y1
                now[_SCALE + w] = _ONE / total
                ratio_now[w] = (c0 * s00 + c1 * s01 + _SUM_FLOOR) / (c0 * s10 + c1 * s11 + _SUM_FLOOR)
        for i in range(num_states * NUM_LANES):
            edges[1, i] = work[_METRIC + i]

    return backward


@kernel
def exchange_messages(llr_ch, bit_of_cell, llr_e, llr_a, prob0, prob1, llr, decisions):
    """Pass messages at the bits: totals to `llr`, to each copy the rest of the total; decide."""
    for n in range(llr.size):
        llr[n] = llr_ch[n]
    for i in range(llr_e.size):
        llr[bit_of_cell[i]] += llr_e[i]
    for i in range(llr_e.size):
        llr_a[i] = llr[bit_of_cell[i]]
    for i in range(llr_e.size):
        llr_a[i] = min(max(llr_a[i] - llr_e[i], -MAX_EXTRINSIC), MAX_EXTRINSIC)
    bit_probabilities(llr_a, prob0, prob1)
    for n in range(decisions.size):
        decisions[n] = np.uint8(llr[n] < _ZERO)


@kernel
def satisfies(decisions, bit_at_step, section_starts, next_state, output, parity):
    """Say whether decisions, encoded again, agree with all parity received (-1: none at this step)."""
    state = 0
    section = 0
    for k in range(bit_at_step.size):
        if section < section_starts.size and k == section_starts[section]:
            state = 0
            section += 1
        bit = decisions[bit_at_step[k]]
        if parity[k] >= 0 and output[state, bit] != parity[k]:
            return False
        state = next_state[state, bit]
    return True


@kernel
def set_parity(cells, bits, allow0, allow1):
    """Allow only the parity that is known, at some cells."""
    for i in range(cells.size):
        allow0[cells[i]] = np.float32(bits[i] == 0)
        allow1[cells[i]] = np.float32(bits[i] == 1)


@kernel
def exchange_edges(edges, opens, closes):
    """Hand the metrics at the ends of lanes to their neighbours; sections start in state 0, end anywhere."""
    num_states = edges.shape[1] // NUM_LANES
    for s in range(num_states):
        row = s * NUM_LANES
        for w in range(NUM_LANES - 1, 0, -1):
            edges[0, row + w] = edges[0, row + w - 1]
        for w in range(NUM_LANES - 1):
            edges[1, row + w] = edges[1, row + w + 1]
        for w in range(NUM_LANES):
            if opens[w]:
                edges[0, row + w] = _ONE if s == 0 else _ZERO
            if closes[w]:
                edges[1, row + w] = _ONE


@kernel
def finish_pass(edges, opens, closes, llr_e):
    """Turn the ratios of a BCJR pass into clipped extrinsic LLRs, in place, and hand on the edge metrics."""
    exchange_edges(edges, opens, closes)
    log_clipped(llr_e, MAX_EXTRINSIC)


@kernel
def _is_crowded(step, bits, first_copy, steps_of_bit, spread, max_copies):
    """Say whether a copy is near another one of its bit, or near a bit that its bit meets elsewhere, too."""
    bit = bits[step]
    for i in range(first_copy[bit], first_copy[bit + 1]):
        other = steps_of_bit[i]
        if other != step and abs(other - step) <= spread:
            return True
    if first_copy[bit + 1] - first_copy[bit] > max_copies:
        return False
    for i in range(first_copy[bit], first_copy[bit + 1]):
        other = steps_of_bit[i]
        if other == step:
            continue
        for near in range(max(0, other - spread), min(bits.size, other + spread + 1)):
            neighbour = bits[near]
            if neighbour == bit or first_copy[neighbour + 1] - first_copy[neighbour] > max_copies:
                continue
            for j in range(first_copy[neighbour], first_copy[neighbour + 1]):
                if steps_of_bit[j] != near and abs(steps_of_bit[j] - step) <= spread:
                    return True
    return False


@kernel
def _swap_steps(a, b, bits, first_copy, steps_of_bit):
    bit_a = bits[a]
    bit_b = bits[b]
    slot_a = slot_b = 0
    for i in range(first_copy[bit_a], first_copy[bit_a + 1]):
        if steps_of_bit[i] == a:
            slot_a = i
    for i in range(first_copy[bit_b], first_copy[bit_b + 1]):
        if steps_of_bit[i] == b:
            slot_b = i
    steps_of_bit[slot_a] = b
    steps_of_bit[slot_b] = a
    bits[a] = bit_b
    bits[b] = bit_a


@kernel
def spread_copies(bits, first_copy, steps_of_bit, spread, max_copies, partners):
    """Swap copies until none is crowded, where `partners` (num_tries per step, random steps) allow it."""
    num_tries = partners.size // bits.size
    for step in range(bits.size):
        if not _is_crowded(step, bits, first_copy, steps_of_bit, spread, max_copies):
            continue
        for k in range(num_tries):
            partner = partners[step * num_tries + k]
            if bits[partner] == bits[step]:
                continue
            _swap_steps(step, partner, bits, first_copy, steps_of_bit)
            if not _is_crowded(step, bits, first_copy, steps_of_bit, spread, max_copies) and not _is_crowded(
                partner, bits, first_copy, steps_of_bit, spread, max_copies
            ):
                break
            _swap_steps(step, partner, bits, first_copy, steps_of_bit)


@kernel
def encode_words(words, bit_at_step, slot_at_step, section_starts, feedback, feedforward, released):
    """Encode 64 planes at once: every uint64 word holds one bit position of all planes."""
    zero = np.uint64(0)
    full = ~zero
    f1 = full if feedback & 2 else zero
    f2 = full if feedback & 4 else zero
    f3 = full if feedback & 8 else zero
    f4 = full if feedback & 16 else zero
    g1 = full if feedforward & 2 else zero
    g2 = full if feedforward & 4 else zero
    g3 = full if feedforward & 8 else zero
    g4 = full if feedforward & 16 else zero
    for section in range(section_starts.size):
        start = section_starts[section]
        end = section_starts[section + 1] if section + 1 < section_starts.size else bit_at_step.size
        r1 = r2 = r3 = r4 = zero
        for k in range(start, end):
            a = words[bit_at_step[k]] ^ (r1 & f1) ^ (r2 & f2) ^ (r3 & f3) ^ (r4 & f4)
            released[slot_at_step[k]] = a ^ (r1 & g1) ^ (r2 & g2) ^ (r3 & g3) ^ (r4 & g4)
            r4 = r3
            r3 = r2
            r2 = r1
            r1 = a


@kernel
def sum_of_error_probabilities(llr):
    """Add up 1 / (1 + exp(|llr|)) of float32 LLRs: first every NUM_LANES-th term, then the partial sums."""
    magnitude = np.empty(llr.size, np.float32)
    for i in range(llr.size):
        magnitude[i] = min(abs(llr[i]), _MAX_EXPONENT)
    prob_wrong = np.empty(llr.size, np.float32)
    bit_probabilities(magnitude, np.empty(llr.size, np.float32), prob_wrong)
    partial = np.zeros(NUM_LANES)
    whole = llr.size - llr.size % NUM_LANES
    for start in range(0, whole, NUM_LANES):
        for w in range(NUM_LANES):
            partial[w] += prob_wrong[start + w]
    for i in range(whole, llr.size):
        partial[i - whole] += prob_wrong[i]
    total = 0.0
    for w in range(NUM_LANES):
        total += partial[w]
    return total


@kernel
def parity_rows(bit_at_step, section_starts, feedback, feedforward, row_of_step, rows):
    """Write parity as equations: bit n of ``rows[row_of_step[k]]`` is its weight in the parity of step k."""
    num_words = rows.shape[1]
    register = np.zeros((5, num_words), np.uint64)
    section = 0
    head = 0  # register[(head + i) % 5] is the bit fed i steps ago; slot head itself is being filled
    for k in range(bit_at_step.size):
        if section < section_starts.size and k == section_starts[section]:
            register[:] = np.uint64(0)
            section += 1
        head = (head + 4) % 5
        fed = register[head]
        fed[:] = np.uint64(0)
        _add_taps(register, head, feedback, fed)
        n = bit_at_step[k]
        fed[n >> 6] ^= np.uint64(1) << np.uint64(n & 63)
        r = row_of_step[k]
        if r >= 0:
            for j in range(num_words):
                rows[r, j] = fed[j]
            _add_taps(register, head, feedforward, rows[r])


@kernel
def _add_taps(register, head, polynomial, target):
    for i in range(1, 5):
        if (polynomial >> i) & 1:
            _add_row(register[(head + i) % 5], target)


@kernel
def _add_row(source, target):
    for j in range(target.size):
        target[j] ^= source[j]


@kernel
def _bit(row, column):
    return np.int64((row[column >> 6] >> np.uint64(column & 63)) & np.uint64(1))


@kernel
def _find_pivot(rows, start, size, columns, column):
    """Find a row with `column` set after the `size` pivots from `start` on, and reduce it by them."""
    for r in range(start + size, rows.shape[0]):
        bit = _bit(rows[r], column)
        for i in range(size):
            bit ^= _bit(rows[r], columns[i]) & _bit(rows[start + i], column)
        if bit:
            for i in range(size):
                if _bit(rows[r], columns[i]):
                    _add_row(rows[start + i], rows[r])
            return r
    return -1


@kernel
def _collect_pivots(rows, start, column_order, position, columns, row_of_pivot):
    """Collect a block of pivots, reduced among each other; return their number and the next position."""
    size = 0
    while size < columns.size and start + size < rows.shape[0] and position < column_order.size:
        column = column_order[position]
        position += 1
        found = _find_pivot(rows, start, size, columns, column)
        if found < 0:
            continue
        pivot = start + size
        for j in range(rows.shape[1]):
            word = rows[found, j]
            rows[found, j] = rows[pivot, j]
            rows[pivot, j] = word
        for i in range(size):
            if _bit(rows[start + i], column):
                _add_row(rows[pivot], rows[start + i])
        columns[size] = column
        row_of_pivot[column] = pivot
        size += 1
    return size, position


@kernel
def eliminate(rows, column_order, row_of_pivot):
    """Bring GF(2) equations to reduced form, choosing pivots in the given column order; return the rank."""
    table = np.zeros((1 << PIVOT_BLOCK, rows.shape[1]), np.uint64)
    columns = np.empty(PIVOT_BLOCK, np.int64)
    row_of_pivot[:] = -1
    rank = position = 0
    while rank < rows.shape[0] and position < column_order.size:
        size, position = _collect_pivots(rows, rank, column_order, position, columns, row_of_pivot)
        for i in range(size):
            for index in range(1 << i):
                for j in range(table.shape[1]):
                    table[index + (1 << i), j] = table[index, j]
                _add_row(rows[rank + i], table[index + (1 << i)])
        for r in range(rows.shape[0]):
            index = 0
            for i in range(size):
                index |= _bit(rows[r], columns[i]) << i
            if index and not rank <= r < rank + size:
                _add_row(table[index], rows[r])
        rank += size
    return rank


@kernel
def gather_weights(rows, row_of_pivot, free, weights):
    """Unpack the weights of the free bits: ``weights[i, f]`` is that of bit ``free[f]`` in pivot row i."""
    for i in range(row_of_pivot.size):
        row = rows[row_of_pivot[i]]
        for f in range(free.size):
            weights[i, f] = _bit(row, free[f])


@kernel
def weigh(weights, bits, parity):
    """Add up the weights of the bits that are 1, modulo 2: ``parity = weights @ bits``."""
    for i in range(weights.shape[0]):
        row = weights[i]
        total = np.uint8(0)
        for f in range(row.size):
            total ^= row[f] & bits[f]
        parity[i] = total


@kernel
def _add_multiple(factor, weights, prices):
    for f in range(prices.size):
        prices[f] += factor * np.int32(weights[f])


@kernel
def descend(weights, price_pivots, price_free, flips):
    """Invert free bits, the most rewarding first, while that lowers the cost."""
    if price_free.size == 0:
        return
    own_price = price_free.copy()
    for i in range(price_pivots.size):
        _add_multiple(price_pivots[i], weights[i], price_free)
    for _ in range(MAX_DESCENT):
        best = np.argmin(price_free)
        if price_free[best] >= 0:
            return
        flips[best] ^= np.uint8(1)
        price_free[best] -= np.int32(2) * own_price[best]
        own_price[best] = -own_price[best]
        for i in range(price_pivots.size):
            if weights[i, best]:
                _add_multiple(np.int32(-2 * price_pivots[i]), weights[i], price_free)
                price_pivots[i] = -price_pivots[i]
