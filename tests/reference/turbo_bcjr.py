"""BCJR and RSC encoding written from their equations, in plain numpy, one step at a time."""

import numpy as np
from numpy.typing import NDArray


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
