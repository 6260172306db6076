"""Cascade: each plane is decoded until it is likely right, then all of a frame are checked together.

Check bits that make sure of one plane cost more than a plane of low entropy itself.
"""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from dvc.config import CascadeConfig
from dvc.slepian_wolf.cascade.orders import NUM_ORDERS, prefix_parities
from dvc.slepian_wolf.cascade.posterior import RangePosterior
from dvc.slepian_wolf.cascade.reconciliation import PlaneReconciliation
from dvc.slepian_wolf.checks import CRC_BITS, crc, joint_check
from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.plane_protocol import FrameCheck, PlaneCoroutine, PlaneCost, PlaneResult, Words
from dvc.slepian_wolf.requests import Bits, ParityRequest, ask

SEARCH_BITS = 6
"""Check bits of half of the planes that are asked for, to find one that is wrong."""


class CascadeDecoder:
    """Decodes the planes of one frame after another."""

    cost = PlaneCost(1.06, 6.0)

    def __init__(self, settings: CascadeConfig, seed: int) -> None:
        self._settings, self._seed = settings, seed
        self._planes: dict[int, tuple[PlaneReconciliation, PlaneResult]] = {}

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int] = (0, 0),
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a run of bits as a coroutine: it yields requests and is sent the bits."""
        plane = PlaneReconciliation(llr_ch, self._settings, position, coupling)
        result = yield from plane.decode(RangePosterior(len(llr_ch), self._seed))
        self._planes[position[1]] = plane, result
        return result

    def check(self, frame: int = 0) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Check all planes since the last check together, and correct those that are wrong."""
        planes, self._planes = self._planes, {}
        if not planes:
            return FrameCheck()
        check = _JointCheck(frame, {p: planes[p][1].bits for p in planes})
        corrected: dict[int, PlaneResult] = {}
        suspects, search_bits = sorted(planes), SEARCH_BITS
        while not (success := (yield from check.holds(sorted(planes), CRC_BITS))) and suspects:
            number = yield from check.find(suspects, search_bits)
            suspects.remove(number)
            posterior = RangePosterior(planes[number][1].bits.size, self._seed)
            corrected[number] = yield from planes[number][0].correct(posterior)
            check.set_bits(number, corrected[number].bits)
            if np.array_equal(corrected[number].bits, planes[number][1].bits):
                search_bits = CRC_BITS  # a wrong plane must have passed for right
        return FrameCheck(corrected, check.num_requests, check.num_bits, success)


class _JointCheck:
    """Compares check bits of sets of planes with those of the encoder."""

    def __init__(self, frame: int, bits: dict[int, Bits]) -> None:
        self._frame = frame
        self._checks = {plane: crc(own, CRC_BITS) for plane, own in bits.items()}
        self._answers: dict[tuple[int, ...], Bits] = {}
        self._charged: dict[int, int] = {}  # bits that were asked for by the first of their planes
        self.num_requests = 0
        self.num_bits = 0

    def set_bits(self, plane: int, bits: Bits) -> None:
        self._checks[plane] = crc(bits, CRC_BITS)

    def holds(self, planes: list[int], count: int) -> Generator[ParityRequest, Bits, bool]:
        """Return whether the check of some planes is the encoder's; request it if it is unknown."""
        key = tuple(planes)
        if key not in self._answers or self._answers[key].size < count:
            charged = self._charged.get(key[0], 0)
            self._answers[key] = yield from ask(
                ParityRequest(self._frame, key[0], "joint", 0, charged, count, key)
            )
            self._charged[key[0]] = charged + count
            self.num_requests += 1
            self.num_bits += count
        known = self._answers[key]
        own = joint_check(np.stack([self._checks[plane] for plane in planes]))
        return bool((own[: known.size] == known).all())

    def find(self, suspects: list[int], count: int) -> Generator[ParityRequest, Bits, int]:
        """Return one of the planes that is probably wrong; one of them is."""
        while len(suspects) > 1:
            half = suspects[: len(suspects) // 2]
            holds = yield from self.holds(half, count)
            suspects = suspects[len(suspects) // 2 :] if holds else half
        return suspects[0]


class CascadeCoder:
    """Parities of ranges of several orders of the bits, which the decoder chooses."""

    num_codes = NUM_ORDERS
    by_positions = True

    def __init__(self, settings: CascadeConfig, seed: int) -> None:
        self._settings, self._seed = settings, seed

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Compute the parities of all that comes first in one of the orders, of up to 64 planes."""
        prefix_parities(words, code, self._seed, parity)

    def decoder(self, num_bits: int) -> CascadeDecoder:
        """Return a decoder of planes."""
        del num_bits
        return CascadeDecoder(self._settings, self._seed)
