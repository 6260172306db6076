"""The payload of the no-feedback form: what an encoder without feedback chose to send of a Wyner-Ziv frame.

After the header it tells how many planes of each band are sent and how long the syndromes are, one for each
block of bands; then come the check bits and the syndrome of each block.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.bits import BitReader, pack_bits
from dvc.errors import BitstreamError
from dvc.slepian_wolf.crc import POLYNOMIALS
from dvc.slepian_wolf.ldpc.graph import Sparsity, SyndromeGraph, block_code
from dvc.wynerziv import _kernels
from dvc.wynerziv.lengths import LENGTH_CODE_BITS, length_of_code, lengths
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout, Quantization, plane_digits, read_planes

Bits = NDArray[np.uint8]

BLOCKS = (range(1), range(1, 16))
"""Bands whose planes have one syndrome: DC first, so that it can refine the prediction of the others."""
SPARSITY = Sparsity(0.8, (0.02, 0.06)), Sparsity(0.5, (0.02, 0.06))
"""Of the code of each block."""
_BLOCKS = (
    np.array([0, *(bands.stop for bands in BLOCKS)]),
    np.array([sparsity.numbers for sparsity in SPARSITY]),
)
MAX_BLOCK_BITS = 1 << 25
"""Bits of the planes of a block: belief propagation takes some hundred bytes of memory for each."""


@dataclass(frozen=True)
class SentPlanes:
    """What is sent of a frame."""

    depths: tuple[int, ...]  # planes of the 16 bands that are sent, the most significant ones
    # code of the length of the syndrome of each of `BLOCKS`; 0 where none of its planes is sent
    length_codes: tuple[int, ...]

    def graph(self, block: int, quantization: Quantization, num_bits: int, seed: int) -> SyndromeGraph | None:
        """Return the code of a block."""
        first, depths = quantization.first_plane, self.depths
        bands = [range(first[band], first[band] + depths[band]) for band in BLOCKS[block] if depths[band]]
        planes = tuple(chain.from_iterable(bands))
        length = length_of_code(self.length_codes[block])
        if not (length and planes):
            return None
        return SyndromeGraph(num_bits, planes, length, seed, SPARSITY[block])


def encode_payload(frame: EncodedFrame, sent: SentPlanes, seed: int) -> bytes:
    """Pack what is sent of a frame; inverse of `NoFeedbackFrame.read`."""
    digits = _digits(sent).encode()
    sizes = [lengths()[code] for code in sent.length_codes]
    bits = np.empty(len(digits) + sum(sizes) + len(BLOCKS) * frame.layout.crc_bits, np.uint8)
    bits[: len(digits)] = np.frombuffer(digits, np.uint8) & 1
    num_bits = len(digits)
    if any(sizes) and any(sent.depths):
        packed = frame.pack(max(band + 1 for band, depth in enumerate(sent.depths) if depth))
        num_bits += _kernels.write_blocks(
            packed,
            POLYNOMIALS[frame.layout.crc_bits],
            frame.quantization.plane_counts,
            np.array(sent.depths),
            _BLOCKS,
            np.array(sizes),
            block_code(frame.layout.num_bits, len(packed[0]), seed),
            bits[len(digits) :],
        )
    return frame.header + pack_bits([bits[:num_bits]])


def payload_bits(frame: EncodedFrame, sent: SentPlanes) -> int:
    """Return the size of what `encode_payload` gives, in bits."""
    sizes = [
        length_of_code(code)
        for bands, code in zip(BLOCKS, sent.length_codes, strict=True)
        if code and any(sent.depths[bands.start : bands.stop])
    ]
    num_bits = len(_digits(sent)) + sum(sizes) + frame.layout.crc_bits * len(sizes)
    return 8 * (len(frame.header) + -(-num_bits // 8))


@lru_cache(maxsize=256)
def _digits(sent: SentPlanes) -> str:
    """Spell what is sent of a frame."""
    return plane_digits(sent.depths) + "".join(f"{code:0{LENGTH_CODE_BITS}b}" for code in sent.length_codes)


@dataclass(frozen=True, eq=False)
class SentBlock:
    """What was received of a block."""

    graph: SyndromeGraph
    check: Bits  # shape (crc_bits,)
    syndrome: Bits  # shape (M,)


@dataclass(frozen=True, eq=False)
class NoFeedbackFrame:
    """What was received of a frame."""

    quantization: Quantization  # its quantisers
    sent: SentPlanes  # what was sent
    blocks: tuple[SentBlock | None, ...]  # each of `BLOCKS`; None where nothing was sent of it

    @classmethod
    def read(cls, layout: FrameLayout, payload: bytes, seed: int) -> Self:
        """Unpack a payload; inverse of `encode_payload`."""
        quantization = layout.read_header(payload)
        reader = BitReader(payload[len(quantization.header) :])
        depths = read_planes(reader)
        if any(depth > planes for depth, planes in zip(depths, quantization.planes, strict=True)):
            raise BitstreamError("more bit planes of a band are sent than it has")
        codes = tuple(reader.read_number(LENGTH_CODE_BITS) for _ in BLOCKS)
        sent = SentPlanes(depths, codes)
        blocks: list[SentBlock | None] = []
        for number in range(len(BLOCKS)):
            graph = sent.graph(number, quantization, layout.num_bits, seed)
            if graph is not None and graph.size > MAX_BLOCK_BITS:
                raise BitstreamError(f"a block of {graph.size} bits, at most {MAX_BLOCK_BITS} are allowed")
            if graph is None:
                blocks.append(None)
            else:
                blocks.append(SentBlock(graph, reader.read(layout.crc_bits), reader.read(graph.num_checks)))
        reader.expect_end()
        return cls(quantization, sent, tuple(blocks))

    @cached_property
    def syndrome_bits(self) -> int:
        """Bits of all its syndromes."""
        return sum(block.graph.num_checks for block in self.blocks if block is not None)

    @cached_property
    def check_bits(self) -> int:
        """Check bits of all its blocks."""
        return sum(block.check.size for block in self.blocks if block is not None)
