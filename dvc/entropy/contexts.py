"""Adaptive binary contexts: the probability of a decision, from those made before in the same context.

A context counts its zeros and ones in steps of 16; once they are above 1024 together, both are halved, so
that old decisions fade. All counts are whole numbers, and the same at both ends.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc._jit import inlined_kernel
from dvc.entropy.range_coder import CoderState, code_decision

Counts = NDArray[np.int64]

_COUNT_STEP = 16
_MAX_COUNT = 64 * _COUNT_STEP
_INITIAL_COUNT = 20 * _COUNT_STEP


def context_counts(percent: ArrayLike) -> Counts:
    """Return counts from which contexts start, as if each had seen twenty decisions.

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
