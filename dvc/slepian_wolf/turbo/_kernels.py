"""Compiled loops of the turbo codec: SISO, message passing, re-encoding; no validation, no I/O."""

import numpy as np

from dvc._jit import inlined_kernel, kernel
from dvc.slepian_wolf._kernels import bit_probabilities, log_mantissa

NUM_LANES = 32
"""Trellis windows that one SISO call runs in lock step, one per SIMD lane."""

_ONE = np.float32(1.0)
_LN2 = np.float32(0.6931471805599453)
_METRIC_FLOOR = np.float32(1e-14)
_SUM_FLOOR = np.float32(1e-30)
_MAX_EXPONENT = np.float32(80.0)
_ZERO = np.float32(0.0)
MAX_EXTRINSIC = np.float32(24.0)

# Rows of NUM_LANES values that make up the record of one trellis step: scale, then the metrics of all states.
ROW_METRIC = 1
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


@inlined_kernel
def _gammas(prob0, prob1, allow0, allow1, scale):
    """Return the metrics of transitions by input bit and parity, and the two of the parity alone."""
    c0, c1 = allow0 * scale, allow1 * scale
    return prob0 * c0, prob0 * c1, prob1 * c0, prob1 * c1, c0, c1


@inlined_kernel
def _add_by_label(label, even, odd, s00, s01, s10, s11):
    """Add metrics of the two transitions that leave a state to the sums by input bit and parity."""
    if label == 0:
        return s00 + even, s01, s10, s11 + odd
    if label == 1:
        return s00, s01 + even, s10 + odd, s11
    if label == 2:
        return s00, s01 + odd, s10 + even, s11
    return s00 + odd, s01, s10, s11 + even


def make_forward(num_states, input_mask, parity_mask):
    """Build the forward recursion of one trellis."""
    half = num_states // 2
    record = (ROW_METRIC + num_states) * NUM_LANES

    @kernel
    def forward(prob0, prob1, allow0, allow1, work, edges):
        """Write alpha of every step to `work`, from ``edges[0]`` on, and replace it by alpha at the end."""
        num_steps = prob0.size // NUM_LANES
        work[_SCALE:_METRIC] = _ONE
        edge, last = edges[0], work[num_steps * record + _METRIC : (num_steps + 1) * record]
        for i in range(edge.size):
            work[_METRIC + i] = edge[i]
        for t in range(num_steps):
            now = work[t * record : (t + 2) * record]
            cells = slice(t * NUM_LANES, (t + 1) * NUM_LANES)
            p0_now, p1_now, allow0_now, allow1_now = prob0[cells], prob1[cells], allow0[cells], allow1[cells]
            for w in range(NUM_LANES):
                g00, g01, g10, g11, _, _ = _gammas(
                    p0_now[w], p1_now[w], allow0_now[w], allow1_now[w], now[_SCALE + w]
                )
                total = _SUM_FLOOR
                for k in range(half):
                    low = now[_METRIC + k * NUM_LANES + w]
                    high = now[_METRIC + (k + half) * NUM_LANES + w]
                    i = _label(k, input_mask, parity_mask)
                    j = _label(k + half, input_mask, parity_mask)
                    x0 = low * _select(i, g00, g01, g10, g11) + high * _select(j, g00, g01, g10, g11)
                    x1 = low * _select(3 - i, g00, g01, g10, g11) + high * _select(3 - j, g00, g01, g10, g11)
                    x0, x1 = max(x0, _METRIC_FLOOR), max(x1, _METRIC_FLOOR)
                    total += x0 + x1
                    now[record + _METRIC + 2 * k * NUM_LANES + w] = x0
                    now[record + _METRIC + (2 * k + 1) * NUM_LANES + w] = x1
                now[record + _SCALE + w] = _ONE / total
        for i in range(edge.size):
            edge[i] = last[i]

    return forward


def make_backward(num_states, input_mask, parity_mask):
    """Build the backward recursion of one trellis, which also sums up the extrinsic probabilities."""
    half = num_states // 2
    record = (ROW_METRIC + num_states) * NUM_LANES

    @kernel
    def backward(prob0, prob1, allow0, allow1, work, edges, ratio):
        """Run beta over `work`, from ``edges[1]`` on; replace it by beta at the lane's start."""
        num_steps = prob0.size // NUM_LANES
        work[num_steps * record + _SCALE : num_steps * record + _METRIC] = _ONE
        edge, last = edges[1], work[num_steps * record + _METRIC : (num_steps + 1) * record]
        for i in range(edge.size):
            last[i] = edge[i]
        for t in range(num_steps - 1, -1, -1):
            now = work[t * record : (t + 2) * record]
            cells = slice(t * NUM_LANES, (t + 1) * NUM_LANES)
            p0_now, p1_now, allow0_now, allow1_now = prob0[cells], prob1[cells], allow0[cells], allow1[cells]
            ratio_now = ratio[cells]
            for w in range(NUM_LANES):
                g00, g01, g10, g11, c0, c1 = _gammas(
                    p0_now[w], p1_now[w], allow0_now[w], allow1_now[w], now[record + _SCALE + w]
                )
                s00 = s01 = s10 = s11 = _ZERO
                total = _SUM_FLOOR
                for k in range(half):
                    even = now[record + _METRIC + 2 * k * NUM_LANES + w]
                    odd = now[record + _METRIC + (2 * k + 1) * NUM_LANES + w]
                    low = now[_METRIC + k * NUM_LANES + w]
                    high = now[_METRIC + (k + half) * NUM_LANES + w]
                    i = _label(k, input_mask, parity_mask)
                    j = _label(k + half, input_mask, parity_mask)
                    s00, s01, s10, s11 = _add_by_label(i, low * even, low * odd, s00, s01, s10, s11)
                    s00, s01, s10, s11 = _add_by_label(j, high * even, high * odd, s00, s01, s10, s11)
                    y0 = even * _select(i, g00, g01, g10, g11) + odd * _select(3 - i, g00, g01, g10, g11)
                    y1 = even * _select(j, g00, g01, g10, g11) + odd * _select(3 - j, g00, g01, g10, g11)
                    y0, y1 = max(y0, _METRIC_FLOOR), max(y1, _METRIC_FLOOR)
                    total += y0 + y1
                    now[_METRIC + k * NUM_LANES + w] = y0
                    now[_METRIC + (k + half) * NUM_LANES + w] = y1
                now[_SCALE + w] = _ONE / total
                ratio_now[w] = (c0 * s00 + c1 * s01 + _SUM_FLOOR) / (c0 * s10 + c1 * s11 + _SUM_FLOOR)
        for i in range(edge.size):
            edge[i] = work[_METRIC + i]

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
    """Return whether decisions, encoded again, agree with all parity received (-1: none at this step)."""
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
def finish_pass(edges, opens, closes, llr_e):
    """Turn the ratios of a BCJR pass into clipped extrinsic LLRs, in place, and hand on the edge metrics.

    The metrics at the ends of lanes are for their neighbours; sections start in state 0, end anywhere.
    """
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
    log_clipped(llr_e, MAX_EXTRINSIC)


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
