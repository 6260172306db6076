"""Protocols of a coder of bit planes, for the encoder that answers and the decoder that asks."""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.requests import Bits, ParityRequest


class PlaneCost(NamedTuple):
    """Expected cost of a plane before any of it is requested."""

    per_ideal_bit: float  # relative to the entropy of the prior
    per_plane: float  # bits on top of that: checks, and the last request

    def bits(self, entropy_bits: float, planes: int = 1) -> float:
        """Return the bits to be expected."""
        return self.per_ideal_bit * entropy_bits + self.per_plane * planes


@dataclass(frozen=True)
class PlaneResult:
    """A decoded plane and what it cost; uncoded bits count as parity."""

    bits: Bits
    num_requests: int
    crc_bits: int
    parity_bits: int
    iterations: int
    entropy_bits: float  # entropy of the prior: the expected length
    ideal_bits: float  # ideal code length of the bits under the prior


@dataclass(frozen=True)
class FrameCheck:
    """Result of a check of all planes of a frame, and its cost besides that of the planes."""

    corrected: dict[int, PlaneResult] = field(default_factory=dict)  # by number of the plane, with all costs
    num_requests: int = 0
    crc_bits: int = 0
    success: bool = True  # whether the check holds now


PlaneCoroutine = Generator[ParityRequest, Bits, PlaneResult]
Words = NDArray[np.uint64]


class PlaneDecoder(Protocol):
    """Decodes the planes of one frame, one after the other or several side by side."""

    @property
    def cost(self) -> PlaneCost:
        """Expected cost of planes."""

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a plane, or a run of bits, as a coroutine: it yields requests and is sent the bits.

        Parameters
        ----------
        llr_ch : ndarray of shape (N,), float
            Side information as LLR log p(0) / p(1) of every bit.
        position : tuple of two int
            Index of the frame, and of the plane in it, or the first plane of a run.
        coupling : NeighbourCoupling, optional
            Dependences between bits; a coder may ignore them.
        """

    def check(self, frame: int) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Check the planes of a frame together, and correct those that are wrong, as a coroutine."""


class PlaneCoder(Protocol):
    """Codes bit planes: what an encoder computes of them, and who decodes them.

    Attributes
    ----------
    num_codes : int
        Kinds of parity of a plane, each as long as the plane.
    by_positions : bool
        Whether a decoder names the bits of parity that it wants; else they are released in order. If it does,
        it must decode runs of any length, with bits of several planes; else whole planes, one at a time.
    """

    @property
    def num_codes(self) -> int: ...

    @property
    def by_positions(self) -> bool: ...

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Write one kind of parity of up to 64 planes in order of release; bit p of a word is of plane p."""

    def decoder(self, num_bits: int) -> PlaneDecoder:
        """Return a decoder of the planes of a frame; whole planes have `num_bits`."""
