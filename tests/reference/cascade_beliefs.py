"""Errors of a plane under parities of ranges, by going through all patterns of errors."""

import itertools

import numpy as np
from numpy.typing import NDArray

Range = tuple[NDArray[np.integer], int]
"""Bits of a range, and the parity of their errors."""


def exact_odds(prior: NDArray[np.float64], known: list[Range]) -> NDArray[np.float64]:
    """Return the odds of an error in each of a few bits, given parities of sets of bits."""
    wrong, right = np.zeros(prior.size), np.zeros(prior.size)
    for pattern in itertools.product((0, 1), repeat=prior.size):
        errors = np.array(pattern)
        if all(errors[bits].sum() % 2 == parity for bits, parity in known):
            weight = float(np.prod(prior[errors == 1]))
            wrong[errors == 1] += weight
            right[errors == 0] += weight
    return wrong / right


def probability_odd(prior: NDArray[np.float64], known: list[Range], bits: NDArray[np.integer]) -> float:
    """Return the probability that a set of bits has an odd number of errors."""
    odd = total = 0.0
    for pattern in itertools.product((0, 1), repeat=prior.size):
        errors = np.array(pattern)
        if all(errors[own].sum() % 2 == parity for own, parity in known):
            weight = float(np.prod(prior[errors == 1]))
            total += weight
            odd += weight * (errors[bits].sum() % 2)
    return odd / total
