"""Compiled loops of what coders of planes share: words of bits, checks, priors; no validation, no I/O."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_LOG2E = np.float32(1.4426950408889634)
_BITS_PER_NAT = 1.4426950408889634
# Interpolated at Chebyshev nodes: 2**f on [0, 1), relative error 3.5e-6; log(m) on [1, 2), error 1.7e-6.
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
_MAX_SPREAD = 2.0  # that excess energies of neighbours count as together


@kernel
def odds_of_zero(llr):
    """Return exp(llr); float32, |llr| < 80."""
    x = llr * _LOG2E
    whole = np.floor(x)
    f = x - whole
    power = np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)
    return (_E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * _E4)))) * power


@kernel
def bit_probabilities(llr, prob0, prob1):
    """Turn LLRs into p(0) and p(1): prob1 = 1 / (1 + exp(llr)); flat float32 arrays, |llr| < 80."""
    for i in range(llr.size):
        odds = odds_of_zero(llr[i])
        q = _ONE / (_ONE + odds)
        prob1[i] = q
        prob0[i] = odds * q


@kernel
def log_mantissa(m):
    return _L0 + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))


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
    """Divide 64 planes at once by the CRC polynomial P; `register` ends as the remainder, top bit first."""
    dividend = np.zeros(words.size + width, np.uint64)
    for n in range(words.size):
        dividend[n] = words[n]
    nearest = 1
    while not (polynomial >> (width - nearest)) & 1:
        nearest += 1
    start = 0
    for power in (64, 16, 4, 1):
        while start < dividend.size - width * power:
            stop = min(start + nearest * power, dividend.size - width * power)
            fed = dividend[start:stop]
            for lag in range(nearest, width + 1):
                if (polynomial >> (width - lag)) & 1:
                    reached = dividend[start + lag * power : stop + lag * power]
                    for n in range(fed.size):
                        reached[n] ^= fed[n]
            start = stop
    for n in range(width):
        register[n] = dividend[words.size + n]


@kernel
def _bit_information(magnitude, prob_wrong, info):
    """Write -log(1 - p) of every bit, p the probability that its sign is wrong, and p itself."""
    bit_probabilities(magnitude, info, prob_wrong)
    for i in range(magnitude.size):
        info[i] = max(log_mantissa(_ONE / info[i]), _ZERO)


@kernel
def prior_entropy(llr):
    """Return the entropy of the prior in bits; float32 terms, summed in order."""
    magnitude = np.abs(llr)
    prob_wrong = np.empty(llr.size, np.float32)
    info = np.empty(llr.size, np.float32)
    _bit_information(magnitude, prob_wrong, info)
    total = 0.0
    for i in range(llr.size):
        total += info[i] + magnitude[i] * prob_wrong[i]
    return total * _BITS_PER_NAT


@kernel
def prior_information(llr, decisions):
    """Return -log2 of the prior probability of the decisions; float32 terms, summed in order."""
    magnitude = np.abs(llr)
    prob_wrong = np.empty(llr.size, np.float32)
    info = np.empty(llr.size, np.float32)
    _bit_information(magnitude, prob_wrong, info)
    total = 0.0
    for i in range(llr.size):
        total += info[i]
        if (llr[i] < _ZERO) != (decisions[i] == 1):
            total += magnitude[i]
    return total * _BITS_PER_NAT


class Lattice(NamedTuple):
    """Bits that depend on their neighbours; all of shape (rows, columns), but `weights`: (rows, 3)."""

    base: NDArray[np.float64]
    shift: NDArray[np.float64]
    slope: NDArray[np.float64]
    excess: NDArray[np.float64]
    widening: NDArray[np.float64]
    weights: NDArray[np.float64]


@inlined_kernel
def llr_of(lattice, deviation, r, c, causal):
    """Return the LLR of a bit with the beliefs of its neighbours added; `deviation`: (rows, columns)."""
    base, shift, slope, excess, widening, weights = lattice
    rows, columns = base.shape
    moved = spread = 0.0
    for k in range(2 if causal else 4):
        y, x = r - (k == 1) + (k == 3), c - (k == 0) + (k == 2)
        if 0 <= y < rows and 0 <= x < columns:
            moved += weights[r, k & 1] * (shift[y, x] * deviation[y, x])
            spread += excess[y, x] * deviation[y, x]
    spread = min(max(spread, -_MAX_SPREAD), _MAX_SPREAD)
    return base[r, c] + slope[r, c] * moved + widening[r, c] * (weights[r, 2] * spread)


@kernel
def add_neighbours(lattice, deviation, causal, llr):
    """Write LLRs with the beliefs of neighbours added; `deviation` and `llr`: (rows, columns)."""
    rows, columns = llr.shape
    for r in range(rows):
        for c in range(columns):
            llr[r, c] = llr_of(lattice, deviation, r, c, causal)
