"""Side information of a plane: the log-likelihood ratio log p(0) / p(1) of each bit."""

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels

MAX_LLR = 9.0
"""Side information is never taken for surer than this: one bit that is wrong costs at most 13 bits."""


def bounded_llr(llr_ch: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return side information that is no surer than it may be."""
    llr = np.asarray(llr_ch, np.float32)
    if llr.ndim != 1 or llr.size < 1 or np.isnan(llr).any():
        raise ValueError(f"`llr_ch` must be a vector of numbers, got shape {llr.shape}")
    return np.clip(llr, -MAX_LLR, MAX_LLR)


def entropy_bits(llr: NDArray[np.float32]) -> float:
    """Return the entropy of a plane, given its side information."""
    return float(_kernels.prior_entropy(llr))


def ideal_bits(llr: NDArray[np.float32], bits: NDArray[np.uint8]) -> float:
    """Return the ideal code length of a plane, given its side information."""
    return float(_kernels.prior_information(llr, bits))
