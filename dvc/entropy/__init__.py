"""Entropy coding: range coder, adaptive binary contexts, binarisations.

Each function codes in both directions: it writes the value that it is given, or reads one and returns it, as
the coder does. So the syntax of a payload is stated once, by a function that codes it, and this function can
be compiled. Models are apart from the coder: a probability, a bound, or a table of contexts.
"""

from dvc.entropy.binarisation import code_exp_golomb
from dvc.entropy.mixing import code_adaptive, context_counts
from dvc.entropy.range_coder import CoderState, RangeCoder, code_decision, code_uniform

__all__ = [
    "CoderState",
    "RangeCoder",
    "code_adaptive",
    "code_decision",
    "code_exp_golomb",
    "code_uniform",
    "context_counts",
]
