"""Bits on a lattice that depend on their neighbours: LLRs of each, given beliefs of these."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]


@dataclass(frozen=True)
class NeighbourCoupling:
    """A plane as an Ising model: a bit gives the shift of its neighbours, and how far they spread."""

    alone: Array  # LLR log p(0) / p(1) of each bit where nothing is known of its neighbours
    shift: Array  # by how much a bit of 1, in place of 0, shifts the values of its neighbours
    slope: Array  # by how much the LLR changes with the shift by neighbours
    # square of the shift of a bit's own value, in squared scales; where there is more of it than was to
    # be expected, values of neighbours spread further
    energy: Array
    widening: Array  # by how much the LLR changes with the energy of neighbours beyond what was expected
    weights: Array  # of shifts from the sides, of those from above and below, and of energies

    @cached_property
    def probability_alone(self) -> Array:
        """Probability of a 1 where nothing is known of the neighbours; shape (rows, columns)."""
        llr = self.alone.ravel().astype(np.float32)
        zero, one = np.empty_like(llr), np.empty_like(llr)
        _kernels.bit_probabilities(llr, zero, one)
        return one.reshape(self.alone.shape).astype(np.float64)

    @cached_property
    def excess_energy(self) -> Array:
        """Energy beyond what was expected of a bit of 1, in place of 0; shape (rows, columns)."""
        return self.energy * (1.0 - 2.0 * self.probability_alone)

    @cached_property
    def lattice(self) -> _kernels.Lattice:
        """The same for kernels."""
        return _kernels.Lattice(
            self.alone, self.shift, self.slope, self.excess_energy, self.widening, self.weights
        )

    def llr_given(self, probability: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the LLR of each bit, given what is believed of its neighbours."""
        return self._llr(probability, causal=False)

    def llr_in_sequence(self, bits: Bits) -> NDArray[np.float32]:
        """Return the LLR of each bit, given those before it in raster order: such that they make a code."""
        return self._llr(bits, causal=True)

    def _llr(self, probability: NDArray[np.floating] | Bits, causal: bool) -> NDArray[np.float32]:
        deviation = probability.astype(np.float64).reshape(self.alone.shape) - self.probability_alone
        llr = np.empty_like(self.alone)
        _kernels.add_neighbours(self.lattice, deviation, causal, llr)
        return llr.ravel().astype(np.float32)
