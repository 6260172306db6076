"""Bits on a lattice that depend on their neighbours: LLRs of each, given beliefs of these."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

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


Array = NDArray[np.float64]
Bits = NDArray[np.uint8]


@dataclass(frozen=True)
class NeighbourCoupling:
    """A run of bits as an Ising model: a bit gives the shift of its neighbours, and how far they spread.

    Bits lie on a lattice. All arrays have the shape (rows, columns) except `weights`, (rows, 3), and
    `places`, (N,). Places without a bit are neither known nor requested.
    """

    base: Array  # LLR log p(0) / p(1) of each bit if its neighbours are unknown
    shift: Array  # shift of the values of neighbours by a bit of 1 instead of 0
    slope: Array  # change of the LLR with the shift by neighbours
    # square of the shift of a bit's own value, in squared scales; values of neighbours spread further if it
    # exceeds the expectation
    energy: Array
    widening: Array  # change of the LLR with the energy of neighbours beyond the expected one
    weights: Array  # weights of shifts from the sides, of shifts from above and below, and of energies
    places: NDArray[np.int64]  # raster index of each bit

    @classmethod
    def stacked(cls, parts: Sequence[Self]) -> Self:
        """Join bits of several lattices of one shape, which do not depend on each other."""
        if len(parts) == 1:
            return parts[0]
        rows, columns = parts[0].base.shape
        gap = (rows + 1) * columns  # a row between two lattices keeps them apart

        def stack(name: str) -> Array:
            padded = [np.pad(getattr(part, name), ((0, 1), (0, 0))) for part in parts]
            return np.concatenate(padded)

        places = np.concatenate([number * gap + part.places for number, part in enumerate(parts)])
        base, shift, slope, energy, widening, weights = map(
            stack, ("base", "shift", "slope", "energy", "widening", "weights")
        )
        return cls(base, shift, slope, energy, widening, weights, places)

    @cached_property
    def base_probability(self) -> Array:
        """Probability of a 1 if the neighbours are unknown; shape (rows, columns)."""
        llr = self.base.ravel().astype(np.float32)
        zero, one = np.empty_like(llr), np.empty_like(llr)
        _kernels.bit_probabilities(llr, zero, one)
        return one.reshape(self.base.shape).astype(np.float64)

    @cached_property
    def excess_energy(self) -> Array:
        """Energy beyond the expected one of a bit of 1 instead of 0; shape (rows, columns)."""
        return self.energy * (1.0 - 2.0 * self.base_probability)

    @cached_property
    def lattice(self) -> _kernels.Lattice:
        """The same for kernels."""
        return _kernels.Lattice(
            self.base, self.shift, self.slope, self.excess_energy, self.widening, self.weights
        )

    def deviation(self, probability: NDArray[np.floating] | Bits) -> Array:
        """Return the difference of beliefs from `base_probability`, on the lattice."""
        found = np.zeros(self.base.size)
        found[self.places] = probability - self.base_probability.ravel()[self.places]
        return found.reshape(self.base.shape)

    def llr_given(self, probability: NDArray[np.floating] | Bits, causal: bool) -> NDArray[np.float32]:
        """Return the LLR of each bit, given its neighbours or only those before it in raster order."""
        llr = np.empty_like(self.base)
        _kernels.add_neighbours(self.lattice, self.deviation(probability), causal, llr)
        return llr.ravel()[self.places].astype(np.float32)
