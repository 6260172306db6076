"""The planes of a block from its syndrome, and from where each number is likely to be.

Bits of one number depend on each other: what its syndrome bits tell of one of them changes what its prior
tells of the others. All updates are sums, products and quotients, the same on any processor.

References
----------
[Kschischang2001] F. Kschischang, B. Frey, H.-A. Loeliger, "Factor graphs and the sum-product algorithm", IEEE
Trans. Inf. Theory 47(2), 2001.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.ldpc import _kernels
from dvc.slepian_wolf.ldpc.graph import NUM_EDGES, Bits, SyndromeGraph

Array = NDArray[np.float64]

MAX_ITERATIONS = 100
PATIENCE = 15
"""Iterations without progress after which decoding is given up."""
LEARNING_PERIOD = 4
"""Iterations from which something is learned about priors."""
_PROGRESS = 0.98
"""Share of contradicted syndrome bits that must be left for that to count as progress."""


@dataclass(frozen=True, eq=False)
class NumberPriors:
    """Where the numbers of a band are likely to be."""

    depth: int  # bits of each number, at least 1
    lowest: NDArray[np.int64]  # the least candidate of each number
    counts: NDArray[np.int64]  # how many candidates follow one another from there
    probabilities: NDArray[np.float32]  # of the candidates; they add up to 1 - `outliers`
    outliers: float  # probability that a number is none of these; then all are equally likely

    def ideal_bits(self, numbers: NDArray[np.int64]) -> float:
        """Return the ideal code length of numbers."""
        positions = numbers - self.lowest
        among = (positions >= 0) & (positions < self.counts)
        likely = self.probabilities[np.arange(numbers.size), np.where(among, positions, 0)]
        likelihood = np.where(among, likely.astype(np.float64), 0.0) + self.outliers / (1 << self.depth)
        return float(-np.log2(likelihood).sum())


@dataclass(frozen=True, eq=False)
class DecodedBlock:
    """What decoding of a block found."""

    bits: Bits  # its planes
    success: bool  # whether they have the syndrome that was sent
    num_iterations: int  # iterations of belief propagation
    # without success, the probabilities of the candidates of each band by its last priors and the syndrome
    beliefs: tuple[NDArray[np.float32], ...] = ()


Learn = Callable[[Sequence[NDArray[np.float32]]], Sequence[NumberPriors]]
"""From what is believed of all candidates, shape (N, K) for each band, to new priors."""


def decode_block(
    graph: SyndromeGraph, syndrome: Bits, bands: Sequence[NumberPriors], learn: Learn | None = None
) -> DecodedBlock:
    """Find the likely planes that have a syndrome."""
    if sum(band.depth for band in bands) != len(graph.planes) or syndrome.size != graph.num_checks:
        raise ValueError(
            f"{len(graph.planes)} planes with a syndrome of {graph.num_checks} bits, got priors of "
            f"{sum(band.depth for band in bands)} and {syndrome.size}"
        )
    edges = graph.edges().ravel()
    first = np.empty(graph.num_checks + 1, np.int64)
    edge_of = np.empty(int((edges >= 0).sum()), np.int64)
    _kernels.sort_edges(edges, graph.num_checks, first, edge_of)
    messages = np.ones((graph.size, NUM_EDGES))
    certainties = np.empty((graph.size, NUM_EDGES))
    odds = np.empty(graph.size)
    least_wrong, patience, iteration, num_wrong = graph.num_checks + 1.0, PATIENCE, 0, 1
    while num_wrong and patience and iteration < MAX_ITERATIONS:
        if learn is not None and iteration and iteration % LEARNING_PERIOD == 0:
            bands = learn(_beliefs(bands, graph.num_bits, messages))
        iteration += 1
        _update_bands(bands, graph.num_bits, messages, certainties, odds)
        num_wrong = _kernels.update_checks(syndrome, first, edge_of, certainties, odds, messages)
        patience -= 1
        if num_wrong < _PROGRESS * least_wrong:
            least_wrong, patience = num_wrong, PATIENCE
    bits = (odds > 1.0).astype(np.uint8).reshape(len(graph.planes), graph.num_bits)
    beliefs = _beliefs(bands, graph.num_bits, messages) if num_wrong else []
    return DecodedBlock(bits, num_wrong == 0, iteration, tuple(beliefs))


def _beliefs(bands: Sequence[NumberPriors], num_bits: int, messages: Array) -> list[NDArray[np.float32]]:
    """Return the probabilities of the candidates of all bands by priors and syndrome."""
    beliefs, plane = [], 0
    for band in bands:
        believed = np.zeros_like(band.probabilities)
        first_bit = (plane + np.arange(band.depth)) * num_bits
        _kernels.believe(band.lowest, band.counts, band.probabilities, first_bit, messages, believed)
        beliefs.append(believed)
        plane += band.depth
    return beliefs


def _update_bands(
    bands: Sequence[NumberPriors],
    num_bits: int,
    messages: Array,
    certainties: Array,
    odds: Array,
) -> None:
    plane = 0
    for band in bands:
        first_bit = (plane + np.arange(band.depth)) * num_bits
        _kernels.update_numbers(
            band.lowest,
            band.counts,
            band.probabilities,
            first_bit,
            band.outliers,
            messages,
            certainties,
            odds,
        )
        plane += band.depth
