"""Coders of planes by name, for tests that do without a configuration."""

import numpy as np
from numpy.typing import NDArray

from dvc.config import CascadeConfig
from dvc.slepian_wolf import PlaneCoder
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.turbo.turbo_coder import TurboCoder

SEED = 1


def coder_of(name: str, settings: CascadeConfig | None = None) -> PlaneCoder:
    """Return a coder; settings are those of Cascade."""
    return TurboCoder(SEED) if name == "turbo" else CascadeCoder(settings or CascadeConfig(), SEED)


def encode_planes(bits: NDArray[np.uint8], seed: int) -> NDArray[np.uint8]:
    """Return the parity of bit planes by the turbo coder, in order of release."""
    parity = np.empty_like(bits)
    for first in range(0, len(bits), 64):
        group = bits[first : first + 64]
        shifts = np.arange(len(group), dtype=np.uint64)[:, None]
        words = (group.astype(np.uint64) << shifts).sum(axis=0, dtype=np.uint64)
        released = np.empty_like(words)
        TurboCoder(seed).encode(0, words, released)
        parity[first : first + 64] = released >> shifts & np.uint64(1)
    return parity
