"""Plain twins of Slepian-Wolf coding: check bits, codes and beliefs from their definitions, step by step."""

import itertools

import numpy as np
from numpy.typing import NDArray

Range = tuple[NDArray[np.integer], int]
"""Bits of a range, and the parity of their errors."""


def crc_remainder(bits: NDArray[np.uint8], polynomial: int, width: int) -> NDArray[np.uint8]:
    """Return ``bits * x**width`` modulo ``x**width + polynomial``, highest power first."""
    dividend = [int(bit) for bit in bits] + [0] * width
    divisor = [1] + [polynomial >> (width - 1 - i) & 1 for i in range(width)]
    for i in range(bits.size):
        if dividend[i]:
            for j, coefficient in enumerate(divisor):
                dividend[i + j] ^= coefficient
    return np.array(dividend[-width:], np.uint8)


def rsc_encode(bits: NDArray[np.uint8], feedback: int, feedforward: int) -> NDArray[np.uint8]:
    """Divide and multiply polynomials over GF(2): parity = bits * feedforward / feedback, from state zero."""
    fed = np.zeros(bits.size, np.uint8)
    parity = np.zeros(bits.size, np.uint8)
    for k in range(bits.size):
        fed[k] = bits[k]
        for delay in range(1, min(k, 8) + 1):
            fed[k] ^= (feedback >> delay & 1) * fed[k - delay]
        for delay in range(min(k, 8) + 1):
            parity[k] ^= (feedforward >> delay & 1) * fed[k - delay]
    return parity


def bcjr(
    llr_a: NDArray[np.float64],
    parity: NDArray[np.int8],
    next_state: NDArray[np.int64],
    output: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the extrinsic LLRs log p(0) / p(1) of the inputs of a trellis that starts in state 0."""
    num_steps, num_states = llr_a.size, next_state.shape[0]
    prob = np.stack([1 / (1 + np.exp(-llr_a)), 1 / (1 + np.exp(llr_a))], axis=1)
    possible = (parity[:, None, None] < 0) | (output[None] == parity[:, None, None])
    alpha = np.zeros((num_steps + 1, num_states))
    beta = np.zeros((num_steps + 1, num_states))
    alpha[0, 0] = 1
    beta[-1] = 1
    for t in range(num_steps):
        np.add.at(alpha[t + 1], next_state, alpha[t][:, None] * prob[t] * possible[t])
        alpha[t + 1] /= alpha[t + 1].sum()
    for t in range(num_steps - 1, -1, -1):
        beta[t] = (beta[t + 1][next_state] * prob[t] * possible[t]).sum(axis=1)
        beta[t] /= beta[t].sum()
    joint = alpha[:-1, :, None] * beta[1:][:, next_state] * possible
    evidence = joint.sum(axis=1)
    with np.errstate(divide="ignore"):
        extrinsic: NDArray[np.float64] = np.log(evidence[:, 0]) - np.log(evidence[:, 1])
    return extrinsic


def patterns(prior: NDArray[np.float64], known: list[Range]) -> list[tuple[NDArray[np.int64], float]]:
    """Return the errors of a few bits that agree with parities of sets of bits, and their odds."""
    every = map(np.array, itertools.product((0, 1), repeat=prior.size))
    agreeing = [errors for errors in every if all(errors[own].sum() % 2 == parity for own, parity in known)]
    return [(errors, float(np.prod(prior[errors == 1]))) for errors in agreeing]


def exact_odds(prior: NDArray[np.float64], known: list[Range]) -> NDArray[np.float64]:
    """Return the odds of an error in each of a few bits, given parities of sets of bits."""
    wrong, right = np.zeros(prior.size), np.zeros(prior.size)
    for errors, weight in patterns(prior, known):
        wrong[errors == 1] += weight
        right[errors == 0] += weight
    return wrong / right


def probability_odd(prior: NDArray[np.float64], known: list[Range], bits: NDArray[np.integer]) -> float:
    """Return the probability that a set of bits has an odd number of errors."""
    likely = patterns(prior, known)
    odd = sum(weight * (errors[bits].sum() % 2) for errors, weight in likely)
    return float(odd / sum(weight for _, weight in likely))
