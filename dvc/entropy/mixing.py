"""Logistic mixtures: the probability of a decision, from several adaptive contexts at once.

Each context knows the probability of a 1 and how often it was met, and learns fast at first. The logarithms
of their odds are added with weights that learn as well, slowly. All is tables, and products of double
precision, one at a time, so that it is the same on every processor.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.entropy.range_coder import CoderState, code_decision

Counts = NDArray[np.int64]

_COUNT_STEP = 16
_MAX_COUNT = 64 * _COUNT_STEP
_INITIAL_COUNT = 20 * _COUNT_STEP


def context_counts(percent: ArrayLike) -> Counts:
    """Return initial counts of contexts, as if each had seen twenty decisions.

    Parameters
    ----------
    percent : array_like of shape (...)
        Probability of a 1 in each context, in percent, from 1 to 99.

    Returns
    -------
    ndarray of shape (..., 2), int64
        Zeros and ones of each.
    """
    ones = np.asarray(percent, np.int64) * _INITIAL_COUNT // 100
    return np.stack([_INITIAL_COUNT - ones, ones], axis=-1)


@inlined_kernel
def code_adaptive(coder: CoderState, counts: Counts, context: int, decision: int) -> int:
    """Code a decision in its context, and count it, compiled.

    Parameters
    ----------
    coder : CoderState
        Where to write or to read.
    counts : ndarray of shape (contexts, 2), int64
        Zeros and ones that each context has seen: changed.
    context : int
        Which it is.
    decision : int
        0 or 1; of no meaning when reading.

    Returns
    -------
    int
        The decision.
    """
    zeros, ones = counts[context, 0], counts[context, 1]
    decision = code_decision(coder, ones / (zeros + ones), decision)
    counts[context, decision] += _COUNT_STEP
    if zeros + ones + _COUNT_STEP > _MAX_COUNT:
        counts[context, 0] = (counts[context, 0] + 1) >> 1
        counts[context, 1] = (counts[context, 1] + 1) >> 1
    return decision


STRETCH, SQUASH, RATE = range(3)
TABLE_SIZE = 4096
STRETCH_LIMIT = 12.0
MAX_COUNT = 255
LEARNING_RATE = 0.02


class Mixture(NamedTuple):
    """State of the contexts and their mixture."""

    contexts: NDArray[np.float64]  # probability of a 1, and how many decisions it was learnt from
    weights: NDArray[np.float64]  # weights of the k contexts of a mixture in the logistic domain
    tables: NDArray[np.float64]  # logarithm of the odds, its inverse, and rates of learning by count


def new_mixture(num_contexts: int, num_mixtures: int, initial_weight: float) -> Mixture:
    """Return a mixture of three contexts that knows nothing."""
    contexts = np.tile([0.5, 0.0], (num_contexts, 1))
    return Mixture(contexts, np.full((num_mixtures, 3), initial_weight), logistic_tables())


@cache
def logistic_tables() -> NDArray[np.float64]:
    """Return the tables of mixtures, rounded so that they are the same on every processor."""
    middles = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE
    stretch = np.round(np.log(middles / (1.0 - middles)) * 2**12) / 2**12
    squash = np.round(2**20 / (1.0 + np.exp(STRETCH_LIMIT - 2 * STRETCH_LIMIT * middles))) / 2**20
    rates = 1.0 / (np.minimum(np.arange(TABLE_SIZE), MAX_COUNT) + 1.6)
    return np.stack([stretch, np.clip(squash, 2.0**-13, 1.0 - 2.0**-13), rates])


@kernel
def mixed_probability(mixture: Mixture, first: int, second: int, third: int, weights: int) -> float:
    """Return the probability of a 1, compiled."""
    contexts, tables = mixture.contexts, mixture.tables
    w = mixture.weights[weights]
    mixed = w[0] * tables[STRETCH, np.int64(contexts[first, 0] * TABLE_SIZE)]
    mixed += w[1] * tables[STRETCH, np.int64(contexts[second, 0] * TABLE_SIZE)]
    if third >= 0:
        mixed += w[2] * tables[STRETCH, np.int64(contexts[third, 0] * TABLE_SIZE)]
    mixed = min(max(mixed, 0.01 - STRETCH_LIMIT), STRETCH_LIMIT - 0.01)
    return float(tables[SQUASH, np.int64((mixed + STRETCH_LIMIT) * (TABLE_SIZE / (2 * STRETCH_LIMIT)))])


@kernel
def learn_mixed(
    mixture: Mixture, first: int, second: int, third: int, weights: int, probability: float, decision: int
) -> None:
    """Draw contexts and weights to a decision, compiled."""
    contexts, tables = mixture.contexts, mixture.tables
    w = mixture.weights[weights]
    error = (decision - probability) * LEARNING_RATE
    w[0] += error * tables[STRETCH, np.int64(contexts[first, 0] * TABLE_SIZE)]
    w[1] += error * tables[STRETCH, np.int64(contexts[second, 0] * TABLE_SIZE)]
    if third >= 0:
        w[2] += error * tables[STRETCH, np.int64(contexts[third, 0] * TABLE_SIZE)]
        learn(mixture, third, decision)
    learn(mixture, first, decision)
    learn(mixture, second, decision)


@kernel
def learn(mixture: Mixture, context: int, decision: int) -> None:
    """Draw one context to a decision, compiled."""
    contexts = mixture.contexts
    count = contexts[context, 1]
    contexts[context, 0] += (decision - contexts[context, 0]) * mixture.tables[RATE, np.int64(count)]
    contexts[context, 1] = min(count + 1.0, float(MAX_COUNT))


@kernel
def code_mixed(
    coder: CoderState, mixture: Mixture, first: int, second: int, third: int, weights: int, decision: int
) -> int:
    """Code a decision in two or three contexts, and learn from it, compiled."""
    probability = mixed_probability(mixture, first, second, third, weights)
    decision = code_decision(coder, probability, decision)
    learn_mixed(mixture, first, second, third, weights, probability, decision)
    return decision
