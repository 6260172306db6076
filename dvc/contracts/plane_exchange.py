"""Planes coded from end to end: an encoder that answers the requests of a decoder, plane by plane."""

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import CRC_BITS, ParityRequest, PlaneCoder, PlaneResult, crc, drive, joint_check

Bits = NDArray[np.uint8]


class PlaneSource:
    """Answers requests for planes of one frame, a run each, and counts what it answers by kind."""

    def __init__(self, planes: Bits, coder: PlaneCoder) -> None:
        self._planes, self._coder = planes, coder
        self._parity: dict[tuple[int, int], Bits] = {}
        self.paid = dict.fromkeys(("crc", "parity", "uncoded", "joint"), 0)
        self._charged: dict[tuple[int, str], int] = {}
        self.asked: set[tuple[int, int]] = set()

    def answer(self, request: ParityRequest) -> Bits:
        """Answer a request, and check that no bit is asked for twice."""
        key = request.run, request.kind
        assert request.start == self._charged.get(key, 0)
        self._charged[key] = request.start + request.count
        self.paid[request.kind] += request.count
        if request.kind == "joint":
            check = joint_check(np.stack([crc(self._planes[p], CRC_BITS) for p in request.positions]))
            return check[: request.count]
        source: Bits = self._planes[request.run]
        if request.kind == "crc":
            source = crc(source, CRC_BITS)
        elif request.kind == "parity":
            source = np.concatenate(
                [self._parity_of(request.run, k) for k in range(request.code, self._coder.num_codes)]
            )
            assert bool(request.positions) == self._coder.by_positions
        if not request.positions:
            released: Bits = source[request.start : request.start + request.count]
            return released
        size = self._planes.shape[1]
        wanted = {(request.run, request.code * size + position) for position in request.positions}
        assert len(wanted) == request.count
        assert not wanted & self.asked
        self.asked |= wanted
        chosen: Bits = source[list(request.positions)]
        return chosen

    def _parity_of(self, plane: int, code: int) -> Bits:
        if (plane, code) not in self._parity:
            words = self._planes[plane].astype(np.uint64)
            parity = np.empty_like(words)
            self._coder.encode(code, words, parity)
            self._parity[plane, code] = (parity & np.uint64(1)).astype(np.uint8)
        return self._parity[plane, code]


def exchange(bits: Bits, llr_ch: NDArray[np.floating], coder: PlaneCoder) -> PlaneResult:
    """Decode a frame of one plane, and check that it pays for every bit once and in order."""
    source, decoder = PlaneSource(bits[None], coder), coder.decoder(bits.size)
    decoded = drive(decoder.decode(llr_ch, (0, 0)), source.answer)
    check = drive(decoder.check(0), source.answer)
    result = check.corrected.get(0, decoded)
    assert check.success
    assert check.crc_bits == source.paid["joint"]
    assert result.parity_bits == source.paid["parity"] + source.paid["uncoded"]
    assert result.crc_bits == source.paid["crc"] <= CRC_BITS
    return result


def noisy(
    rng: np.random.Generator, num_bits: int, probability: NDArray[np.float64] | float
) -> tuple[Bits, NDArray[np.float64]]:
    """Draw a plane, and side information that differs from it with the given probability, as LLRs."""
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    seen = bits ^ (rng.random(num_bits) < probability)
    confidence = np.log((1 - np.asarray(probability)) / np.asarray(probability))
    return bits, (1 - 2.0 * seen) * confidence
