"""Solving the parity equations of a plane over GF(2), where iterations do not get there."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.turbo import _kernels
from dvc.slepian_wolf.turbo.codes import TurboCode
from dvc.slepian_wolf.turbo.interleaver import copy_layout, num_segments
from dvc.slepian_wolf.turbo.puncturing import release_order

Bits = NDArray[np.uint8]
Words = NDArray[np.uint64]
NUM_NEIGHBOURS = 7
"""Neighbours of the plane found that `ordered_statistics` returns as well."""
COST_SCALE = 256
"""Steps per unit of LLR in the integer costs of `ordered_statistics`."""


@dataclass(frozen=True)
class Solution:
    """All solutions of a set of parity equations: `bits` plus any combination of the rows of `free`."""

    bits: Bits  # the solution whose free bits are the hard decisions
    free: Bits  # what changes when one of the r free bits is inverted


@lru_cache(maxsize=8)
def parity_equations(code: TurboCode, num_bits: int, seed: int) -> Words:
    """Write all parity bits of one codeword, in order of release, as linear equations of the plane's bits."""
    if num_segments(num_bits) > 1:
        raise ValueError(f"`num_bits` must be the length of one segment, got {num_bits}")
    layout = copy_layout(code, num_bits, seed)
    row_of_step = np.full(layout.num_steps, -1, np.int32)
    row_of_step[release_order(code, num_bits)] = np.arange(num_bits)
    rows = np.zeros((num_bits, num_bits // 64 + 1), np.uint64)
    starts = np.array(layout.section_starts, np.int64)
    _kernels.parity_rows(layout.bit_at_step, starts, code.feedback, code.feedforward, row_of_step, rows)
    rows.flags.writeable = False
    return rows


@dataclass(frozen=True)
class _Reduced:
    """Equations in reduced form: ``bits[pivots] = values ^ weights @ bits[free]`` (modulo 2)."""

    pivots: NDArray[np.int64]
    free: NDArray[np.int64]  # least reliable first
    weights: Bits  # (pivots, free bits)
    values: Bits

    def fill_pivots(self, bits: Bits) -> None:
        """Solve for the pivots in place, given the free bits."""
        parity = np.empty(self.pivots.size, np.uint8)
        _kernels.weigh(self.weights, bits[self.free], parity)
        bits[self.pivots] = self.values ^ parity


def _reduce(equations: Words, parity: Bits, llr: NDArray[np.float32]) -> tuple[_Reduced, Bits] | None:
    """Solve the equations for the least reliable bits; None where they contradict each other."""
    num_bits = llr.size
    rows = equations.copy()
    rows[:, num_bits // 64] |= parity.astype(np.uint64) << np.uint64(num_bits % 64)
    order = np.argsort(np.abs(llr), kind="stable")
    row_of_pivot = np.empty(num_bits, np.int64)
    rank = int(_kernels.eliminate(rows, order, row_of_pivot))
    values = ((rows[:, num_bits // 64] >> np.uint64(num_bits % 64)) & np.uint64(1)).astype(np.uint8)
    if values[rank:].any():
        return None
    is_pivot = row_of_pivot[order] >= 0
    pivots, free = order[is_pivot], order[~is_pivot]
    weights = np.empty((pivots.size, free.size), np.uint8)
    _kernels.gather_weights(rows, row_of_pivot[pivots], free, weights)
    reduced = _Reduced(pivots, free, weights, values[row_of_pivot[pivots]])
    bits = (llr < 0).astype(np.uint8)
    reduced.fill_pivots(bits)
    return reduced, bits


def solve(equations: Words, parity: Bits, llr: NDArray[np.float32]) -> Solution | None:
    """Solve parity equations, leaving the most reliable bits free where they do not determine all."""
    solved = _reduce(equations, parity, llr)
    if solved is None:
        return None
    reduced, bits = solved
    free = np.zeros((reduced.free.size, llr.size), np.uint8)
    free[np.arange(reduced.free.size), reduced.free] = 1
    free[:, reduced.pivots] = reduced.weights.T
    return Solution(bits, free)


def ordered_statistics(
    equations: Words, parity: Bits, llr_ch: NDArray[np.float32], llr: NDArray[np.float32]
) -> Bits | None:
    """Search likely planes that satisfy all parity, starting from soft decisions."""
    solved = _reduce(equations, parity, llr)
    if solved is None:
        return None
    reduced, bits = solved
    price = np.rint(np.abs(llr_ch) * np.float32(COST_SCALE)).astype(np.int32)
    price = np.where(bits == (llr_ch < 0), price, -price)  # of inverting a bit
    flips = np.zeros(reduced.free.size, np.uint8)
    gaps = price[reduced.free]
    _kernels.descend(reduced.weights, price[reduced.pivots], gaps, flips)
    bits[reduced.free] ^= flips
    reduced.fill_pivots(bits)
    nearest = np.argsort(gaps, kind="stable")[:NUM_NEIGHBOURS]
    planes = np.repeat(bits[np.newaxis], 1 + nearest.size, axis=0)
    planes[1 + np.arange(nearest.size), reduced.free[nearest]] ^= 1
    planes[1:, reduced.pivots] ^= reduced.weights[:, nearest].T
    return planes
