"""Plain twin of the fixed code of chains: differential directions (4.6), (4.7), and bits that they take."""

import numpy as np

from dvc.images.chain_code import Chains


def differences(directions: np.ndarray) -> np.ndarray:
    """Return -1 (to the right), 0 or 1 (to the left) between directions without reversals (4.6)."""
    wide = directions.astype(np.int64)
    return ((wide[1:] - wide[:-1] + 1 & 3) - 1).astype(np.int8)


def directions_of(first: int, steps: np.ndarray) -> np.ndarray:
    """Return the directions of a chain from the first one and the differential ones (4.7)."""
    return (np.cumsum(np.insert(steps, 0, first), dtype=np.int64) & 3).astype(np.int8)


def code_bits(chains: Chains) -> int:
    """Return the bits of code words, with positions, lengths and their number."""
    longest = int(chains.lengths.max(initial=1))
    header = chains.shape[0].bit_length() + chains.shape[1].bit_length() + 2 + longest.bit_length()
    words = sum(1 + abs(int(step)) for part in chains.parts() for step in differences(part))
    return 24 + 5 + header * len(chains.starts) + words
