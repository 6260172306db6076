"""Binarisation: whole numbers as sequences of decisions, each in its context."""

from dvc._jit import inlined_kernel
from dvc.entropy.mixing import Counts, code_adaptive
from dvc.entropy.range_coder import FAILED, CoderState, code_decision

NUM_EXPONENTS = 12
"""Contexts of exponents, and as many of mantissas; larger exponents share the last."""
MAX_EXPONENT = 24
"""Magnitudes are below 2^25 - 1."""
MAX_DECISIONS = 2 + 2 * MAX_EXPONENT
"""Most decisions of a number."""


@inlined_kernel
def code_exp_golomb(
    coder: CoderState, counts: Counts, zero: int, sign: int, exponents: int, mantissas: int, value: int
) -> int:
    """Code a whole number by the code of Exp-Golomb, adaptive and with a sign, compiled.

    Whether it is zero is decided first, then its sign; the exponent of the magnitude plus one in unary, the
    first digit after the leading one in a context of the exponent, and the other digits as they are.

    Parameters
    ----------
    coder : CoderState
        Coder to write to or to read from.
    counts : ndarray of shape (contexts, 2), int64
        Zeros and ones seen by each context; updated.
    zero, sign : int
        Contexts of these decisions.
    exponents, mantissas : int
        First of the `NUM_EXPONENTS` contexts of each: that of exponent e is e further; the first is unused.
    value : int
        The number, of magnitude below ``2^25 - 1``; of no meaning when reading.

    Returns
    -------
    int
        The number; any, if the data are damaged.
    """
    magnitude = abs(value) + 1
    if not code_adaptive(coder, counts, zero, int(magnitude > 1)):
        return 0
    positive = code_adaptive(coder, counts, sign, int(value > 0))
    exponent = 1
    while code_adaptive(
        coder, counts, exponents + min(exponent, NUM_EXPONENTS - 1), int(magnitude >> (exponent + 1) > 0)
    ):
        exponent += 1
        if exponent > MAX_EXPONENT:
            coder.fields[FAILED] = 1
            return 0
    mantissa = mantissas + min(exponent, NUM_EXPONENTS - 1)
    coded = 2 | code_adaptive(coder, counts, mantissa, magnitude >> (exponent - 1) & 1)
    for k in range(exponent - 2, -1, -1):
        coded = coded << 1 | code_decision(coder, 0.5, magnitude >> k & 1)
    return coded - 1 if positive else 1 - coded
