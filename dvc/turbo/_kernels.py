"""Compiled loops of the turbo codec: SISO, message passing, re-encoding; no validation, no I/O."""

import numpy as np

from dvc._jit import kernel

NUM_LANES = 32
"""Trellis windows that one SISO call runs in lock step, one per SIMD lane."""

_ONE = np.float32(1.0)
_HALF = np.float32(0.5)
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
_MAX_EXTRINSIC = np.float32(24.0)


@kernel
def bit_probabilities(llr, prob0, prob1):
    """Turn LLRs into p(0) and p(1): prob1 = 1 / (1 + exp(llr)), all arrays flat float32, |llr| < 80."""
    scratch = np.empty(llr.size, np.float32)
    bits = scratch.view(np.int32)
    for i in range(llr.size):
        x = llr[i] * _LOG2E
        whole = np.floor(x)
        f = x - whole
        prob0[i] = _E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * _E4)))
        bits[i] = (np.int32(whole) + np.int32(127)) << np.int32(23)
    for i in range(llr.size):
        z = prob0[i] * scratch[i]
        q = _ONE / (_ONE + z)
        prob1[i] = q
        prob0[i] = z * q


@kernel
def log_ratio(sum0, sum1, llr):
    """Write log(sum0 / sum1) to `llr`, clipped to the largest extrinsic LLR; all arrays flat float32."""
    bits = sum0.view(np.int32)
    exponent = np.empty(llr.size, np.float32)
    for i in range(llr.size):
        sum0[i] = (sum0[i] + _SUM_FLOOR) / (sum1[i] + _SUM_FLOOR)
    for i in range(llr.size):
        b = bits[i]
        exponent[i] = np.float32((b >> np.int32(23)) - np.int32(127))
        bits[i] = (b & np.int32(0x7FFFFF)) | np.int32(0x3F800000)
    for i in range(llr.size):
        m = sum0[i]
        y = _L0 + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))
        y = y + exponent[i] * _LN2
        llr[i] = min(max(y, -_MAX_EXTRINSIC), _MAX_EXTRINSIC)


@kernel
def siso_forward_backward(
    next_state, output, previous, prob0, prob1, allow0, allow1, alpha, alpha_edge, beta_edge, sum0, sum1
):
    """Run one BCJR pass over all lanes in lock step.

    prob0, prob1, allow0, allow1, sum0, sum1 : (L, W) float32; alpha : (L + 1, S, W) float32 scratch;
    alpha_edge, beta_edge : (S, W) metrics at the two ends of every lane, replaced by what this pass finds
    at the lane's *other* end (alpha after its last step, beta before its first).
    """
    num_steps = prob0.shape[0]
    num_states = next_state.shape[0]
    gamma = np.empty((4, NUM_LANES), np.float32)
    total = np.empty(NUM_LANES, np.float32)
    beta = np.empty((num_states, NUM_LANES), np.float32)
    beta_new = np.empty((num_states, NUM_LANES), np.float32)
    for s in range(num_states):
        for w in range(NUM_LANES):
            alpha[0, s, w] = alpha_edge[s, w]
            beta[s, w] = beta_edge[s, w]
    for t in range(num_steps):
        for w in range(NUM_LANES):
            gamma[0, w] = prob0[t, w] * allow0[t, w]
            gamma[1, w] = prob0[t, w] * allow1[t, w]
            gamma[2, w] = prob1[t, w] * allow0[t, w]
            gamma[3, w] = prob1[t, w] * allow1[t, w]
            total[w] = _SUM_FLOOR
        for s in range(num_states):
            sa = previous[s, 0]
            ga = previous[s, 1]
            sb = previous[s, 2]
            gb = previous[s, 3]
            for w in range(NUM_LANES):
                x = alpha[t, sa, w] * gamma[ga, w] + alpha[t, sb, w] * gamma[gb, w]
                alpha[t + 1, s, w] = x
                total[w] += x
        for w in range(NUM_LANES):
            total[w] = _ONE / total[w]
        for s in range(num_states):
            for w in range(NUM_LANES):
                alpha[t + 1, s, w] = max(alpha[t + 1, s, w] * total[w], _METRIC_FLOOR)
    for s in range(num_states):
        for w in range(NUM_LANES):
            alpha_edge[s, w] = alpha[num_steps, s, w]
    for t in range(num_steps - 1, -1, -1):
        for w in range(NUM_LANES):
            sum0[t, w] = np.float32(0.0)
            sum1[t, w] = np.float32(0.0)
            total[w] = _SUM_FLOOR
            gamma[0, w] = allow0[t, w]
            gamma[1, w] = allow1[t, w]
        for s in range(num_states):
            n0 = next_state[s, 0]
            n1 = next_state[s, 1]
            v0 = output[s, 0]
            v1 = output[s, 1]
            for w in range(NUM_LANES):
                x0 = gamma[v0, w] * beta[n0, w]
                x1 = gamma[v1, w] * beta[n1, w]
                sum0[t, w] += alpha[t, s, w] * x0
                sum1[t, w] += alpha[t, s, w] * x1
                y = x0 * prob0[t, w] + x1 * prob1[t, w]
                beta_new[s, w] = y
                total[w] += y
        for w in range(NUM_LANES):
            total[w] = _ONE / total[w]
        for s in range(num_states):
            for w in range(NUM_LANES):
                beta[s, w] = max(beta_new[s, w] * total[w], _METRIC_FLOOR)
    for s in range(num_states):
        for w in range(NUM_LANES):
            beta_edge[s, w] = beta[s, w]


@kernel
def combine(llr_ch, first_copy, step_of_copy, llr_e, llr_a, llr):
    """Pass messages at the bits: totals to `llr`, and to each copy the total without its own extrinsic."""
    for n in range(llr_ch.size):
        total = llr_ch[n]
        for j in range(first_copy[n], first_copy[n + 1]):
            total += llr_e[step_of_copy[j]]
        llr[n] = total
        for j in range(first_copy[n], first_copy[n + 1]):
            k = step_of_copy[j]
            llr_a[k] = min(max(total - llr_e[k], -_MAX_EXTRINSIC), _MAX_EXTRINSIC)


@kernel
def decide(llr, decisions):
    """Write hard decisions and return how many of them changed."""
    changed = 0
    for n in range(llr.size):
        bit = np.uint8(llr[n] < np.float32(0.0))
        changed += bit != decisions[n]
        decisions[n] = bit
    return changed


@kernel
def count_violations(decisions, bit_at_step, section_starts, next_state, output, parity):
    """Count the received parity bits (0 or 1 in `parity`, -1 for none) that re-encoded decisions break."""
    state = 0
    section = 0
    violations = 0
    for k in range(bit_at_step.size):
        if section < section_starts.size and k == section_starts[section]:
            state = 0
            section += 1
        bit = decisions[bit_at_step[k]]
        violations += (parity[k] >= 0) & (output[state, bit] != parity[k])
        state = next_state[state, bit]
    return violations


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
