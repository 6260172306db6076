"""Compiled loops of the turbo codec: SISO, message passing, re-encoding; no validation, no I/O."""

import numpy as np

from dvc._jit import kernel

NUM_LANES = 32
"""Trellis windows that one SISO call runs in lock step, one per SIMD lane."""

_ONE = np.float32(1.0)
_LOG2E = np.float32(1.4426950408889634)
_LN2 = np.float32(0.6931471805599453)
# Least squares at Chebyshev nodes: 2**f on [0, 1), relative error 3.5e-6; log(m) on [1, 2), error 1.7e-6.
_E0, _E1, _E2, _E3, _E4 = (
    np.float32(c)
    for c in (
        1.0000034929076977,
        0.6929729221730628,
        0.24160435727003668,
        0.05174499776419958,
        0.013670309453307137,
    )
)
_L0, _L1, _L2, _L3, _L4, _L5, _L6 = (
    np.float32(c)
    for c in (
        -2.0996478486768844,
        4.20523484145975,
        -3.647120395291447,
        2.2269434607536414,
        -0.8520795951448832,
        0.18370084115152,
        -0.017029610589036435,
    )
)
_METRIC_FLOOR = np.float32(1e-14)
_SUM_FLOOR = np.float32(1e-30)
MAX_DESCENT = 64
_ZERO = np.float32(0.0)
MAX_EXTRINSIC = np.float32(24.0)

# Rows of NUM_LANES values that make up the record of one trellis step; the metrics of all states follow.
ROW_ALLOW0, ROW_ALLOW1, ROW_SUM0, ROW_SUM1, ROW_SCALE, ROW_METRIC = range(6)
_ALLOW0, _ALLOW1, _SUM0, _SUM1, _SCALE, _METRIC = (row * NUM_LANES for row in range(6))


@kernel
def bit_probabilities(llr, prob0, prob1):
    """Turn LLRs into p(0) and p(1): prob1 = 1 / (1 + exp(llr)); flat float32 arrays, |llr| < 80."""
    power = np.empty(llr.size, np.float32)
    power_bits = power.view(np.int32)
    for i in range(llr.size):
        x = llr[i] * _LOG2E
        whole = np.floor(x)
        f = x - whole
        prob0[i] = _E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * _E4)))
        power_bits[i] = (np.int32(whole) + np.int32(127)) << np.int32(23)
    for i in range(llr.size):
        odds = prob0[i] * power[i]
        q = _ONE / (_ONE + odds)
        prob1[i] = q
        prob0[i] = odds * q


@kernel
def _log_mantissa(m):
    return _L0 + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))


@kernel
def log_clipped(ratio, llr, limit):
    """Write log(ratio), clipped to +-limit, to `llr`; flat float32 arrays, ratio > 0 is overwritten."""
    ratio_bits = ratio.view(np.int32)
    for i in range(llr.size):
        b = ratio_bits[i]
        llr[i] = np.float32((b >> np.int32(23)) - np.int32(127)) * _LN2
        ratio_bits[i] = (b & np.int32(0x7FFFFF)) | np.int32(0x3F800000)
    for i in range(llr.size):
        llr[i] = min(max(llr[i] + _log_mantissa(ratio[i]), -limit), limit)


@kernel
def _select(label, g00, g01, g10, g11):
    if label == 0:
        return g00
    if label == 1:
        return g01
    if label == 2:
        return g10
    return g11


def make_siso(num_states, input_mask, parity_mask):
    """Build the BCJR pass over all lanes of one trellis, which must be constant to be vectorised.

    Bit s of the masks is the input bit, and the parity bit, of the transition that leaves state s by shifting a 0 in; the
    transition that shifts a 1 in has both inverted. States k and k + S/2 share the successors 2k and 2k + 1.
    """
    half = num_states // 2

    @kernel
    def siso(prob0, prob1, work, edges):
        """Run forward and backward recursions; all lanes in lock step.

        prob0, prob1 : (L * W,) a priori probabilities; work : (L + 1, R, W) flattened, R = ROW_METRIC + S, holds
        in rows ROW_ALLOW0 and ROW_ALLOW1 of each step which parity is possible, receives in ROW_SUM0 and ROW_SUM1
        the extrinsic sums of alpha * beta; edges : (2, S * W) metrics at the start and the end of
        every lane, replaced by the metrics at its end and its start. Everything is float32.
        """
        record = (ROW_METRIC + num_states) * NUM_LANES
        num_steps = prob0.size // NUM_LANES
        head = work[:record]
        for i in range(num_states * NUM_LANES):
            head[_METRIC + i] = edges[0, i]
        for w in range(NUM_LANES):
            head[_SCALE + w] = _ONE
        for t in range(num_steps):
            now = work[t * record : (t + 2) * record]
            p0_now = prob0[t * NUM_LANES : (t + 1) * NUM_LANES]
            p1_now = prob1[t * NUM_LANES : (t + 1) * NUM_LANES]
            for w in range(NUM_LANES):
                c0 = now[_ALLOW0 + w] * now[_SCALE + w]
                c1 = now[_ALLOW1 + w] * now[_SCALE + w]
                g00 = p0_now[w] * c0
                g01 = p0_now[w] * c1
                g10 = p1_now[w] * c0
                g11 = p1_now[w] * c1
                total = _SUM_FLOOR
                for k in range(half):
                    low = now[_METRIC + k * NUM_LANES + w]
                    high = now[_METRIC + (k + half) * NUM_LANES + w]
                    i = ((input_mask >> k) & 1) * 2 + ((parity_mask >> k) & 1)
                    j = ((input_mask >> (k + half)) & 1) * 2 + ((parity_mask >> (k + half)) & 1)
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
            metric = tail[_METRIC + i]
            tail[_METRIC + i] = edges[1, i]
            edges[0, i] = metric
        for w in range(NUM_LANES):
            tail[_SCALE + w] = _ONE
        for back in range(num_steps):
            t = num_steps - 1 - back
            now = work[t * record : (t + 2) * record]
            p0_now = prob0[t * NUM_LANES : (t + 1) * NUM_LANES]
            p1_now = prob1[t * NUM_LANES : (t + 1) * NUM_LANES]
            for w in range(NUM_LANES):
                c0 = now[_ALLOW0 + w] * now[record + _SCALE + w]
                c1 = now[_ALLOW1 + w] * now[record + _SCALE + w]
                p0 = p0_now[w]
                p1 = p1_now[w]
                sum0 = _ZERO
                sum1 = _ZERO
                total = _SUM_FLOOR
                for k in range(half):
                    even = now[record + _METRIC + 2 * k * NUM_LANES + w]
                    odd = now[record + _METRIC + (2 * k + 1) * NUM_LANES + w]
                    e0 = even * c0
                    e1 = even * c1
                    o0 = odd * c0
                    o1 = odd * c1
                    i = ((input_mask >> k) & 1) * 2 + ((parity_mask >> k) & 1)
                    j = ((input_mask >> (k + half)) & 1) * 2 + ((parity_mask >> (k + half)) & 1)
                    low = now[_METRIC + k * NUM_LANES + w]
                    y0 = _select(i, e0, e1, o1, o0)
                    y1 = _select(i, o1, o0, e0, e1)
                    sum0 += low * y0
                    sum1 += low * y1
                    beta_low = max(y0 * p0 + y1 * p1, _METRIC_FLOOR)
                    high = now[_METRIC + (k + half) * NUM_LANES + w]
                    y0 = _select(j, e0, e1, o1, o0)
                    y1 = _select(j, o1, o0, e0, e1)
                    sum0 += high * y0
                    sum1 += high * y1
                    beta_high = max(y0 * p0 + y1 * p1, _METRIC_FLOOR)
                    total += beta_low + beta_high
                    now[_METRIC + k * NUM_LANES + w] = beta_low
                    now[_METRIC + (k + half) * NUM_LANES + w] = beta_high
                now[_SUM0 + w] = sum0
                now[_SUM1 + w] = sum1
                now[_SCALE + w] = _ONE / total
        for i in range(num_states * NUM_LANES):
            edges[1, i] = head[_METRIC + i]

    return siso


@kernel
def combine(llr_ch, bit_of_cell, llr_e, llr_a, llr):
    """Pass messages at the bits: totals to `llr`, and to each copy the total without its own extrinsic.

    The last element of `llr_ch` and `llr` belongs to the cells that pad the lanes.
    """
    for n in range(llr.size):
        llr[n] = llr_ch[n]
    for i in range(llr_e.size):
        llr[bit_of_cell[i]] += llr_e[i]
    for i in range(llr_e.size):
        llr_a[i] = min(max(llr[bit_of_cell[i]] - llr_e[i], -MAX_EXTRINSIC), MAX_EXTRINSIC)


@kernel
def decide(llr, decisions):
    """Write hard decisions."""
    for n in range(decisions.size):
        decisions[n] = np.uint8(llr[n] < _ZERO)


@kernel
def satisfies(decisions, bit_at_step, section_starts, next_state, output, parity):
    """Say whether re-encoded decisions agree with the received parity bits (-1 in `parity`: none received)."""
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
def exchange_edges(edges, opens, closes):
    """Hand the metrics at the ends of every lane to its neighbours; sections start in state 0 and end anywhere."""
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
def take_sums(work, edges, prob0, llr_e):
    """Turn the sums that a BCJR pass left in `work` into clipped extrinsic LLRs; `prob0` is scratch."""
    num_steps = llr_e.size // NUM_LANES
    record = ROW_METRIC * NUM_LANES + edges.shape[1]
    for t in range(num_steps):
        sums = work[t * record + _SUM0 : t * record + _SUM0 + 2 * NUM_LANES]
        target = prob0[t * NUM_LANES : (t + 1) * NUM_LANES]
        for w in range(NUM_LANES):
            target[w] = (sums[w] + _SUM_FLOOR) / (sums[NUM_LANES + w] + _SUM_FLOOR)
    log_clipped(prob0, llr_e, MAX_EXTRINSIC)


@kernel
def prepare_pass(llr_ch, bit_of_cell, messages, llr):
    """Turn extrinsic LLRs (row 1 of `messages`) into a priori LLRs (row 0) and probabilities (rows 2 and 3)."""
    combine(llr_ch, bit_of_cell, messages[1], messages[0], llr)
    bit_probabilities(messages[0], messages[2], messages[3])


@kernel
def finish_pass(lanes, code_bits, tables, llr_ch, work, edges, messages, llr, decisions):
    """Pass messages after a BCJR pass, decide, and say whether the decisions satisfy all received parity.

    lanes : (bit_of_cell, opens, closes); code_bits : (bit_at_step, section_starts, parity); tables : (next_state, output).
    """
    bit_of_cell, opens, closes = lanes
    exchange_edges(edges, opens, closes)
    take_sums(work, edges, messages[2], messages[1])
    prepare_pass(llr_ch, bit_of_cell, messages, llr)
    decide(llr, decisions)
    return satisfies(decisions, code_bits[0], code_bits[1], tables[0], tables[1], code_bits[2])


@kernel
def _is_crowded(step, bits, first_copy, steps_of_bit, spread, max_copies):
    """Say whether a copy is near another one of its bit, or near a bit that is its neighbour elsewhere, too."""
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
def encode_words(words, bit_at_step, section_starts, feedback, feedforward, parity):
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
            parity[k] = a ^ (r1 & g1) ^ (r2 & g2) ^ (r3 & g3) ^ (r4 & g4)
            r4 = r3
            r3 = r2
            r2 = r1
            r1 = a


@kernel
def gather_bits(words, order, bits):
    """Unpack bit p of ``words[order[j]]`` to ``bits[p, j]``."""
    for p in range(bits.shape[0]):
        shift = np.uint64(p)
        for j in range(order.size):
            bits[p, j] = np.uint8((words[order[j]] >> shift) & np.uint64(1))


@kernel
def pack_words(bits, words):
    """Pack up to 64 planes: bit p of ``words[n]`` is ``bits[p, n]``."""
    for n in range(words.size):
        words[n] = np.uint64(0)
    for p in range(bits.shape[0]):
        shift = np.uint64(p)
        for n in range(words.size):
            words[n] |= np.uint64(bits[p, n]) << shift


@kernel
def crc_words(words, polynomial, width, register):
    """Divide 64 planes at once by the CRC polynomial; `register` (width,) uint64 ends as the remainder, top bit first."""
    head = 0  # register is circular: element (head + i) % width holds the coefficient of x**(width - 1 - i)
    for i in range(width):
        register[i] = np.uint64(0)
    for n in range(words.size):
        fed = words[n] ^ register[head]
        register[head] = np.uint64(0)
        head += 1
        if head == width:
            head = 0
        for i in range(width):
            if (polynomial >> (width - 1 - i)) & 1:
                j = head + i
                if j >= width:
                    j -= width
                register[j] ^= fed
    rotated = np.empty(width, np.uint64)
    for i in range(width):
        rotated[i] = register[(head + i) % width]
    for i in range(width):
        register[i] = rotated[i]


@kernel
def prior_entropy(llr):
    """Return the sum over the bits of the binary entropy of the prior, in bits; strict order, float32 terms."""
    prob0 = np.empty(llr.size, np.float32)
    prob1 = np.empty(llr.size, np.float32)
    info = np.empty(llr.size, np.float32)
    magnitude = np.abs(llr)
    bit_probabilities(magnitude, prob0, prob1)
    for i in range(llr.size):
        m = _ONE / prob0[i]
        y = _L0 + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))
        info[i] = max(y, np.float32(0.0)) + magnitude[i] * prob1[i]
    total = 0.0
    for i in range(llr.size):
        total += info[i]
    return total * 1.4426950408889634


@kernel
def prior_information(llr, decisions):
    """Return -log2 of the prior probability of the decisions, in bits; strict order, float32 terms."""
    prob0 = np.empty(llr.size, np.float32)
    prob1 = np.empty(llr.size, np.float32)
    info = np.empty(llr.size, np.float32)
    magnitude = np.abs(llr)
    bit_probabilities(magnitude, prob0, prob1)
    for i in range(llr.size):
        m = _ONE / prob0[i]
        y = _L0 + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))
        wrong = (llr[i] < np.float32(0.0)) != (decisions[i] == 1)
        info[i] = max(y, np.float32(0.0)) + (magnitude[i] if wrong else np.float32(0.0))
    total = 0.0
    for i in range(llr.size):
        total += info[i]
    return total * 1.4426950408889634


@kernel
def parity_rows(bit_at_step, section_starts, feedback, feedforward, row_of_step, rows):
    """Write the parity of the wanted steps as equations: bit n of ``rows[row_of_step[k]]`` is the weight of bit n."""
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
        for j in range(num_words):
            fed[j] = np.uint64(0)
        for i in range(1, 5):
            if (feedback >> i) & 1:
                old = register[(head + i) % 5]
                for j in range(num_words):
                    fed[j] ^= old[j]
        n = bit_at_step[k]
        fed[n >> 6] ^= np.uint64(1) << np.uint64(n & 63)
        r = row_of_step[k]
        if r >= 0:
            row = rows[r]
            for j in range(num_words):
                row[j] = fed[j]
            for i in range(1, 5):
                if (feedforward >> i) & 1:
                    old = register[(head + i) % 5]
                    for j in range(num_words):
                        row[j] ^= old[j]


@kernel
def eliminate(rows, rhs, column_order, pivot_row):
    """Bring GF(2) equations to reduced form, choosing pivots in the given column order.

    pivot_row[n] becomes the row solved for column n, or -1 for a free column; returns the rank, or -1 where
    the equations contradict each other.
    """
    num_rows, num_words = rows.shape
    rank = 0
    one = np.uint64(1)
    for i in range(pivot_row.size):
        pivot_row[i] = -1
    for c in column_order:
        if rank == num_rows:
            break
        word = c >> 6
        shift = np.uint64(c & 63)
        found = -1
        for r in range(rank, num_rows):
            if (rows[r, word] >> shift) & one:
                found = r
                break
        if found < 0:
            continue
        if found != rank:
            for j in range(num_words):
                swap = rows[found, j]
                rows[found, j] = rows[rank, j]
                rows[rank, j] = swap
            bit = rhs[found]
            rhs[found] = rhs[rank]
            rhs[rank] = bit
        source = rows[rank]
        for r in range(num_rows):
            if r != rank and (rows[r, word] >> shift) & one:
                target = rows[r]
                for j in range(num_words):
                    target[j] ^= source[j]
                rhs[r] ^= rhs[rank]
        pivot_row[c] = rank
        rank += 1
    for r in range(rank, num_rows):
        if rhs[r]:
            return -1
    return rank


@kernel
def gather_columns(rows, row_of_pivot, free, columns):
    """Unpack the weights of the free bits: ``columns[f, i]`` is that of bit ``free[f]`` in row ``row_of_pivot[i]``."""
    for i in range(row_of_pivot.size):
        row = rows[row_of_pivot[i]]
        for f in range(free.size):
            n = free[f]
            columns[f, i] = np.uint8((row[n >> 6] >> np.uint64(n & 63)) & np.uint64(1))


@kernel
def descend(columns, price_free, price_pivots, flips):
    """Invert free bits, the most rewarding first, while that lowers the cost; prices are int32 and change sign."""
    for _ in range(MAX_DESCENT):
        best = np.int32(0)
        best_free = -1
        for f in range(columns.shape[0]):
            column = columns[f]
            price = price_free[f]
            for i in range(column.size):
                price += price_pivots[i] * np.int32(column[i])
            if price < best:
                best = price
                best_free = f
        if best_free < 0:
            return
        flips[best_free] ^= np.uint8(1)
        price_free[best_free] = -price_free[best_free]
        for i in range(price_pivots.size):
            if columns[best_free, i]:
                price_pivots[i] = -price_pivots[i]
