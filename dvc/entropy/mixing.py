"""Logistic mixtures: the probability of a decision, from several adaptive contexts at once.

Each context knows the probability of a 1 and how often it was met, and learns fast at first. The logarithms
of their odds are added with weights that learn as well, slowly. All is tables, and products of double
precision, one at a time, so that it is the same on every processor.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.entropy.range_coder import CoderState, code_decision

STRETCH, SQUASH, RATE = range(3)
TABLE_SIZE = 4096
STRETCH_LIMIT = 12.0
MAX_COUNT = 255
LEARNING_RATE = 0.02


class Mixture(NamedTuple):
    """What is known of the contexts, and how they are mixed.

    Attributes
    ----------
    contexts : ndarray of shape (C, 2), float64
        Probability of a 1, and how many decisions it was learnt from.
    weights : ndarray of shape (M, k), float64
        Of the k contexts of a mixture in the logistic domain.
    tables : ndarray of shape (3, 4096), float64
        Logarithm of the odds, its inverse, and rates of learning by count.
    """

    contexts: NDArray[np.float64]
    weights: NDArray[np.float64]
    tables: NDArray[np.float64]


def new_mixture(num_contexts: int, num_mixtures: int, initial_weight: float) -> Mixture:
    """Return a mixture of three contexts that knows nothing.

    Parameters
    ----------
    num_contexts : int
        Contexts.
    num_mixtures : int
        Sets of weights.
    initial_weight : float
        Of each context.

    Returns
    -------
    Mixture
        All contexts even.
    """
    contexts = np.tile([0.5, 0.0], (num_contexts, 1))
    return Mixture(contexts, np.full((num_mixtures, 3), initial_weight), logistic_tables())


@cache
def logistic_tables() -> NDArray[np.float64]:
    """Return the tables of mixtures, rounded so that they are the same on every processor.

    Returns
    -------
    ndarray of shape (3, 4096), float64
        Logarithm of the odds, its inverse, and rates of learning by count: not to be changed.
    """
    middles = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE
    stretch = np.round(np.log(middles / (1.0 - middles)) * 2**12) / 2**12
    squash = np.round(2**20 / (1.0 + np.exp(STRETCH_LIMIT - 2 * STRETCH_LIMIT * middles))) / 2**20
    rates = 1.0 / (np.minimum(np.arange(TABLE_SIZE), MAX_COUNT) + 1.6)
    return np.stack([stretch, np.clip(squash, 2.0**-13, 1.0 - 2.0**-13), rates])


@kernel
def mixed_probability(mixture: Mixture, first: int, second: int, third: int, weights: int) -> float:
    """Return the probability of a 1, compiled.

    Parameters
    ----------
    mixture : Mixture
        What is known.
    first, second, third : int
        Contexts; -1 for the third: there are two.
    weights : int
        Which weights they have.

    Returns
    -------
    float
        From 2^-13 to 1 - 2^-13.
    """
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
    """Draw contexts and weights to a decision, compiled.

    Parameters
    ----------
    mixture : Mixture
        What is known: changed.
    first, second, third : int
        Contexts; -1 for the third: there are two.
    weights : int
        Which weights they have.
    probability : float
        That the decision was coded with.
    decision : int
        0 or 1.
    """
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
    """Draw one context to a decision, compiled.

    Parameters
    ----------
    mixture : Mixture
        What is known: changed.
    context : int
        Which.
    decision : int
        0 or 1.
    """
    contexts = mixture.contexts
    count = contexts[context, 1]
    contexts[context, 0] += (decision - contexts[context, 0]) * mixture.tables[RATE, np.int64(count)]
    contexts[context, 1] = min(count + 1.0, float(MAX_COUNT))


@kernel
def code_mixed(
    coder: CoderState, mixture: Mixture, first: int, second: int, third: int, weights: int, decision: int
) -> int:
    """Code a decision in two or three contexts, and learn from it, compiled.

    Parameters
    ----------
    coder : CoderState
        Where to write or to read.
    mixture : Mixture
        What is known: changed.
    first, second, third : int
        Contexts; -1 for the third: there are two.
    weights : int
        Which weights they have.
    decision : int
        0 or 1; of no meaning when reading.

    Returns
    -------
    int
        The decision.
    """
    probability = mixed_probability(mixture, first, second, third, weights)
    decision = code_decision(coder, probability, decision)
    learn_mixed(mixture, first, second, third, weights, probability, decision)
    return decision
