"""Chains as bytes: by the code words of the thesis, or by adaptive arithmetic coding.

In the first, a chain is the vertex where it starts, its first direction and its length, of fixed numbers of
bits, and then a word for each differential direction: 10, 0, 11 for -1, 0, 1. In the second, starts are
distances from one to the next, and each step is coded in contexts of the last steps and of the last two
straight runs: whether the chain ends there (likely where it meets others), whether it goes straight on, and
to which side it turns. Steps onto edges that are there already are left out. Where edges bound a mask, after
the chains follows which regions are inside.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from dvc.entropy import RangeCoder, code_exp_golomb, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS
from dvc.entropy.mixing import new_mixture
from dvc.errors import BitstreamError, ConfigError
from dvc.images.edge_chains import Chains
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_masks import Mask, code_mask
from dvc.images.edges import _kernels as kernels

_WEIGHT = 0.4
_LENGTH_BITS = 24
_CHAINS_PER_BYTE, _FREE_CHAINS = 4, 64  # a chain has two bits at least, and zeros at the end are not written
_SIGN, _ZERO, _EXPONENTS = 0, 1, 2
_NUM_COUNTS = 2 + 2 * NUM_EXPONENTS


class EdgeCode(IntEnum):
    """How chains are coded."""

    FIXED = 0
    ADAPTIVE = 1


def encode(chains: Chains, code: EdgeCode, mask: Mask | None = None) -> bytes:
    """Code chains; the inverse of `decode`, or with a mask of `decode_masked`."""
    if not fits(chains, code):
        raise ConfigError(f"code words take at most 2^{_LENGTH_BITS} - 1 chains, and as many edges to each")
    coder = RangeCoder.writer()
    edges = _CODES[code](coder, chains, len(chains.starts))
    if mask is not None:
        code_mask(coder, edges, mask)
    return coder.to_bytes(shortest=True)


def fits(chains: Chains, code: EdgeCode) -> bool:
    """Return whether chains can be coded: the numbers of code words have 24 bits."""
    largest = max(len(chains.lengths), int(chains.lengths.max(initial=0)))
    return code is EdgeCode.ADAPTIVE or largest < 2**_LENGTH_BITS


def decode(data: bytes, shape: tuple[int, int], code: EdgeCode) -> EdgeMaps:
    """Read the edges of chains."""
    edges = _read(RangeCoder.reader(data), shape, code, len(data))
    if not edges.count():
        raise BitstreamError("the edges are damaged: there are none")
    return edges


def decode_masked(data: bytes, shape: tuple[int, int], code: EdgeCode) -> tuple[EdgeMaps, Mask]:
    """Read the edges of chains, and the mask whose border is among them."""
    coder = RangeCoder.reader(data)
    edges = _read(coder, shape, code, len(data))
    return edges, code_mask(coder, edges)


def _read(coder: RangeCoder, shape: tuple[int, int], code: EdgeCode, num_bytes: int) -> EdgeMaps:
    nothing = np.zeros(0, np.int64)
    most = _CHAINS_PER_BYTE * num_bytes + _FREE_CHAINS
    edges = _CODES[code](coder, Chains(shape, nothing, nothing, np.zeros(0, np.int8)), most)
    coder.check()
    return edges


def _field_bits(shape: tuple[int, int], chains: Chains) -> tuple[int, int, int]:
    """Bits of rows, columns and lengths."""
    longest = int(chains.lengths.max(initial=1))
    return shape[0].bit_length(), shape[1].bit_length(), longest.bit_length()


def _code_fixed(coder: RangeCoder, chains: Chains, most: int) -> EdgeMaps:
    """Write or read chains by code words."""
    edges = EdgeMaps.none(chains.shape)
    height, width = chains.shape
    row_bits, column_bits, length_bits = _field_bits(chains.shape, chains)
    number = coder.uniform(2**_LENGTH_BITS, len(chains.starts))
    length_bits = coder.uniform(32, length_bits)
    if length_bits > _LENGTH_BITS or number > most:
        raise BitstreamError("the edges are damaged")
    parts = chains.parts() if len(chains.starts) else []
    for k in range(number):
        start = divmod(int(chains.starts[k]), width + 1) if parts else (0, 0)
        given = parts[k] if parts else np.zeros(1, np.int8)
        row, column = coder.uniform(2**row_bits, start[0]), coder.uniform(2**column_bits, start[1])
        first = coder.uniform(4, int(given[0]))
        length = coder.uniform(2**length_bits, len(given))
        if row > height or column > width or not 0 < length <= 2 * height * width:
            raise BitstreamError("the edges are damaged")
        directions = np.full(length, first, np.int8)
        directions[: len(given)] = given
        directions[0] = first
        kernels.code_words(coder.room_for(2 * length), directions)
        coder.check()
        if not kernels.draw(edges.between_rows, edges.between_columns, row, column, directions):
            raise BitstreamError("an edge leaves the picture")
    return edges


def _code_adaptive(coder: RangeCoder, chains: Chains, most: int) -> EdgeMaps:
    """Write or read chains in contexts."""
    edges = EdgeMaps.none(chains.shape)
    height, width = chains.shape
    counts = context_counts(np.full(_NUM_COUNTS, 50))
    number = _code_number(coder, counts, len(chains.starts))
    if number > most:
        raise BitstreamError("the edges are damaged")
    counts = context_counts(np.full(_NUM_COUNTS, 50))
    mixture = new_mixture(kernels.NUM_CONTEXTS, kernels.NUM_MIXTURES, _WEIGHT)
    room = np.zeros(2 * height * width, np.int8)
    room[: len(chains.directions)] = chains.directions
    before, offset = 0, 0
    for k in range(number):
        given = k < len(chains.starts)
        start = before + _code_number(coder, counts, int(chains.starts[k]) - before if given else 0)
        row, column = divmod(start, width + 1)
        if row > height or offset >= len(room):
            raise BitstreamError("the edges are damaged")
        before = start
        room[offset] = coder.uniform(4, int(room[offset]))
        length = kernels.code_chain(
            coder.room_for(3 * int(chains.lengths[k]) + 3 if given else 0),
            mixture,
            edges.between_rows,
            edges.between_columns,
            row,
            column,
            room[offset:],
            int(chains.lengths[k]) if given else 0,
        )
        coder.check()
        if length < 0:
            raise BitstreamError("an edge leaves the picture")
        offset += length
    return edges


def _code_number(coder: RangeCoder, counts: NDArray[np.int64], value: int) -> int:
    state = coder.room_for(MAX_DECISIONS)
    number = code_exp_golomb(state, counts, _ZERO, _SIGN, _EXPONENTS, _EXPONENTS + NUM_EXPONENTS, value)
    coder.check()
    if number < 0:
        raise BitstreamError("the edges are damaged")
    return int(number)


_CODES = {EdgeCode.FIXED: _code_fixed, EdgeCode.ADAPTIVE: _code_adaptive}
