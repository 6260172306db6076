"""What decoding planes returns."""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import NamedTuple

from dvc.slepian_wolf.requests import Bits, ParityRequest


class PlaneCost(NamedTuple):
    """What a plane is expected to cost before anything of it is asked for."""

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
    entropy_bits: float  # of the prior: the length that was to be expected
    ideal_bits: float  # ideal code length of the bits under the prior


@dataclass(frozen=True)
class FrameCheck:
    """What a check of all planes of a frame has shown, and its cost besides that of the planes."""

    corrected: dict[int, PlaneResult] = field(default_factory=dict)  # by number of the plane, with all costs
    num_requests: int = 0
    crc_bits: int = 0
    success: bool = True  # whether the check holds now


PlaneCoroutine = Generator[ParityRequest, Bits, PlaneResult]
