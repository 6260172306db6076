"""Low-density parity-check codes of any length: which bits of a block each bit of its syndrome adds up.

A block is made of bit planes of one frame. Each of its bits takes part in two or three bits of the syndrome,
where it stands in as many pseudo-random orders of a plane, each from a start of the plane's own on and all
around: a few permutations serve blocks of any planes and syndromes of any length.

References
----------
[Liveris2002] A. Liveris, Z. Xiong, C. Georghiades, "Compression of binary sources with side information at
the decoder using LDPC codes", IEEE Communications Letters 6(10), 2002.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.ldpc import _kernels
from dvc.slepian_wolf.permutations import random_keys, random_permutation

Bits = NDArray[np.uint8]
Words = NDArray[np.uint64]

NUM_EDGES = 3
"""Most bits of the syndrome that a bit takes part in."""


class Sparsity(NamedTuple):
    """How many bits of a block take part in two bits of the syndrome only, by the rate of its code."""

    max_share: float  # greatest share of bits, in [0, 1]
    # bits of the syndrome for each bit of the block, from which on some do, and from which on as many as may
    rates: tuple[float, float]

    @property
    def numbers(self) -> tuple[float, float, float]:
        """All three, for compiled callers."""
        return self.max_share, *self.rates


add_block = _kernels.add_block
"""What writes a syndrome, for compiled callers, too."""
MIXED = Sparsity(0.5, (0.03, 0.10))
"""For any block."""


@dataclass(frozen=True)
class SyndromeGraph:
    """The code of one block."""

    num_bits: int  # length N of a plane
    planes: tuple[int, ...]  # numbers of the planes of the block in their frame, in decoding order
    num_checks: int  # length M of the syndrome
    seed: int  # seed that encoder and decoder share
    sparsity: Sparsity = MIXED  # how many of its bits take part in two syndrome bits only

    def __post_init__(self) -> None:
        """Refuse blocks without bits, and syndromes of which no bit could take part in several."""
        if self.num_bits < 1 or not self.planes or self.num_checks < NUM_EDGES:
            raise ValueError(
                f"a block of {len(self.planes)} planes of {self.num_bits} bits has no syndrome of "
                f"{self.num_checks} bits"
            )

    @property
    def size(self) -> int:
        """Bits in the block."""
        return self.num_bits * len(self.planes)

    @cached_property
    def num_thrice(self) -> int:
        """How many bits of a plane, the first of the last order, take part in three syndrome bits."""
        return int(
            _kernels.count_thrice(self.num_bits, len(self.planes), self.num_checks, self.sparsity.numbers)
        )

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """Where each plane starts in each order; shape (len(planes), NUM_EDGES), int64."""
        keys = _start_keys(self.seed, -(-(max(self.planes) + 1) // 64))[list(self.planes)]
        return (keys % np.uint64(self.num_checks)).astype(np.int64)

    def edges(self) -> NDArray[np.int32]:
        """List the syndrome bits of every bit."""
        edges = np.empty((len(self.planes), self.num_bits, NUM_EDGES), np.int32)
        positions = bit_positions(self.num_bits, self.seed)
        _kernels.list_edges(positions, self.starts, self.num_thrice, self.num_checks, edges)
        return edges


@lru_cache(maxsize=8)
def _start_keys(seed: int, num_rows: int) -> NDArray[np.uint64]:
    """Return what tells where planes start, for 64 planes a row."""
    return random_keys((seed << 8) + NUM_EDGES, 64 * num_rows * NUM_EDGES).reshape(-1, NUM_EDGES)


@lru_cache(maxsize=8)
def bit_positions(num_bits: int, seed: int) -> NDArray[np.int32]:
    """Return where each bit of a plane stands in the orders in which they meet syndrome bits."""
    positions = np.stack([random_permutation((seed << 8) + j, num_bits) for j in range(NUM_EDGES)], axis=1)
    positions.flags.writeable = False
    return positions


class BitOrders(NamedTuple):
    """The orders in which bits of a plane meet syndrome bits, and which bits may meet one twice."""

    positions: NDArray[np.int32]  # position of each bit in each order
    bits: NDArray[np.int32]  # bit at each position
    # bits by the difference of their positions in the first and the second order of each of `PAIRS`
    by_difference: NDArray[np.int32]
    # those of difference d are at ``first[d + N - 1]`` and the following, up to ``first[d + N]``
    first: NDArray[np.int32]


@lru_cache(maxsize=8)
def bit_orders(num_bits: int, seed: int) -> BitOrders:
    """Return the orders in which bits of a plane meet syndrome bits."""
    positions = bit_positions(num_bits, seed)
    differences = (positions[:, _kernels.PAIRS[:, 0]] - positions[:, _kernels.PAIRS[:, 1]]).T
    number = np.arange(num_bits, dtype=np.int32)
    by_difference = np.sort((differences.astype(np.int64) << 32) + number, axis=1).astype(np.int32)
    counts = [np.bincount(line + num_bits, minlength=2 * num_bits) for line in differences]
    first = np.cumsum(counts, axis=1).astype(np.int32)
    bits = np.empty(positions.shape[::-1], np.int32)
    np.put_along_axis(bits, positions.T, number[None], axis=1)
    return BitOrders(positions, bits, by_difference, first)


class Code(NamedTuple):
    """What all blocks of a frame share, for compiled callers."""

    orders: BitOrders
    keys: NDArray[np.uint64]  # by which planes start in each order; shape (planes, NUM_EDGES)


@lru_cache(maxsize=8)
def block_code(num_bits: int, num_rows: int, seed: int) -> Code:
    """Return the code of frames of so many rows of 64 planes."""
    return Code(bit_orders(num_bits, seed), _start_keys(seed, num_rows))


def syndrome(words: Words, graph: SyndromeGraph) -> Bits:
    """Add up bits of a block, modulo 2."""
    sums = np.empty(graph.num_checks, np.uint8)
    code = block_code(graph.num_bits, len(words), graph.seed)
    _kernels.add_block(words, np.array(graph.planes), code, graph.sparsity.numbers, sums)
    return sums
