"""Frames of a group that do not depend on each other, decoded in step: their next bits are one run.

All of them share check bits and rounds of requests. The cost of a run is divided by the ideal code lengths of
their bits.
"""

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.group_tasks import Bits, DecodedFrame
from dvc import slepian_wolf
from dvc.slepian_wolf import MAX_RUN_BITS, NeighbourCoupling, Part, PlaneDecoder, PlaneResult, Round
from dvc.slepian_wolf.coupling import bounded_llr, ideal_bits

Prior = NeighbourCoupling | NDArray[np.float64]
"""Prior of the bits of a plane: a coupling of neighbours, or LLRs."""


class Wish(NamedTuple):
    """Bits that a frame needs next, of some planes in some of its areas."""

    planes: tuple[int, ...]
    areas: bytes
    llr: NDArray[np.float64]  # LLRs of all bits, one plane after the other
    priors: Sequence[Prior]  # prior of each plane


class Decoded(NamedTuple):
    """The bits of a plane that a frame wished for."""

    bits: Bits
    ideal_bits: float  # their ideal code length
    paid_bits: float  # their share of the received bits


FrameCoroutine = Generator[Sequence[Wish], Sequence[Sequence[Decoded]], DecodedFrame]
"""Yields wishes and is sent what came of each; at last none, and is sent all again if some were wrong."""


class _Run:
    """Bits of a run, and the frames that they belong to."""

    def __init__(self, wishes: Sequence[tuple[int, Wish]], first_frame: int, number: int) -> None:
        self.wishes, self._position = wishes, (first_frame, number)
        self.result: PlaneResult | None = None
        self.decoded: list[list[Decoded]] = []  # results of each wish

    def decode(self, decoder: PlaneDecoder) -> Generator[slepian_wolf.ParityRequest, Bits, None]:
        """Decode its bits."""
        first, wishes = self._position[0], [wish for _, wish in self.wishes]
        priors = [prior for wish in wishes for prior in wish.priors]
        couplings = [prior for prior in priors if isinstance(prior, NeighbourCoupling)]
        coupling = NeighbourCoupling.stacked(couplings) if couplings else None
        parts = tuple(Part(index - first, wish.planes, wish.areas) for index, wish in self.wishes)
        llr = np.concatenate([wish.llr for wish in wishes])
        steps = decoder.decode(llr, self._position, coupling)
        self.take((yield from slepian_wolf.beginning(parts, steps)))

    def take(self, result: PlaneResult) -> None:
        """Divide the result among the wishes."""
        self.result = result
        paid_bits, start, found = result.parity_bits + result.crc_bits, 0, []
        for _, wish in self.wishes:
            own = []
            for prior in wish.priors:
                size = prior.places.size if isinstance(prior, NeighbourCoupling) else prior.size
                bits = result.bits[start : start + size]
                llr = prior.llr_in_sequence(bits) if isinstance(prior, NeighbourCoupling) else prior
                own.append((bits, ideal_bits(bounded_llr(llr), bits)))
                start += size
            found.append(own)
        whole = sum(ideal for own in found for _, ideal in own)
        equal = 1.0 / sum(map(len, found))
        shares = [[ideal / whole if whole > 0.0 else equal for _, ideal in own] for own in found]
        self.decoded = [
            [Decoded(*one, paid_bits * share) for one, share in zip(*pair, strict=True)]
            for pair in zip(found, shares, strict=True)
        ]


def decode_level(
    frames: Mapping[int, FrameCoroutine], decoder: PlaneDecoder, joins: bool
) -> Generator[Round, Sequence[Bits], list[DecodedFrame]]:
    """Decode frames in step; the first one names all runs; `joins`: whether wishes share runs."""
    started, runs = time.perf_counter(), list[_Run]()
    first = min(frames)
    wishes = {index: next(frame) for index, frame in frames.items()}
    while any(wishes.values()):
        asked = [(index, wish) for index, own in wishes.items() for wish in own]
        begun = [_Run(own, first, len(runs) + number) for number, own in enumerate(_divided(asked, joins))]
        runs += begun
        yield from slepian_wolf.side_by_side([run.decode(decoder) for run in begun])
        decoded = _by_frames(begun)
        for index in decoded:
            wishes[index] = frames[index].send(decoded[index])
    (check,) = yield from slepian_wolf.side_by_side([decoder.check(first)])
    for number, result in check.corrected.items():
        runs[number].take(result)
    again = _by_frames(runs) if check.corrected else {}
    found = [_last(frame, again.get(index, ())) for index, frame in frames.items()]
    decode_s = (time.perf_counter() - started) / len(found)
    num_failed, costs = int(not check.success), _costs(runs, check, [*frames]).tolist()
    return [
        replace(
            frame,
            num_requests=num_requests,
            crc_bits=crc_bits,
            parity_bits=parity_bits,
            num_failed_planes=num_failed,
            decode_s=decode_s,
        )
        for frame, (num_requests, crc_bits, parity_bits) in zip(found, costs, strict=True)
    ]


def _last(frame: FrameCoroutine, again: Sequence[Sequence[Decoded]]) -> DecodedFrame:
    """Finish a frame."""
    try:
        frame.send(again)
    except StopIteration as stop:
        decoded: DecodedFrame = stop.value
        return decoded
    raise AssertionError("a frame wishes for more after the check")


def _divided(asked: Sequence[tuple[int, Wish]], joins: bool) -> list[list[tuple[int, Wish]]]:
    """Divide wishes into runs, one frame after the other."""
    runs: list[list[tuple[int, Wish]]] = []
    for index, wish in asked:
        fits = joins and runs and runs[-1][-1][0] < index
        if fits and sum(other.llr.size for _, other in runs[-1]) + wish.llr.size <= MAX_RUN_BITS:
            runs[-1].append((index, wish))
        else:
            runs.append([(index, wish)])
    return runs


def _by_frames(runs: Sequence[_Run]) -> dict[int, list[list[Decoded]]]:
    """Return the decoded bits of each frame."""
    found: dict[int, list[list[Decoded]]] = {}
    for run in runs:
        for (index, _), decoded in zip(run.wishes, run.decoded, strict=True):
            found.setdefault(index, []).append(decoded)
    return found


def _costs(runs: Sequence[_Run], check: slepian_wolf.FrameCheck, frames: Sequence[int]) -> NDArray[np.int64]:
    """Return requests, check bits and parity of each frame, in whole numbers that add up to all."""
    costs = np.zeros((len(frames), 3), np.int64)
    total = np.array([check.num_requests, check.crc_bits, 0])
    costs += _shares(total, np.ones(len(frames)))
    for run in runs:
        assert run.result is not None
        paid = dict.fromkeys(frames, 0.0)
        for (index, _), decoded in zip(run.wishes, run.decoded, strict=True):
            paid[index] += sum(one.paid_bits for one in decoded)
        total = np.array([run.result.num_requests, run.result.crc_bits, run.result.parity_bits])
        costs += _shares(total, np.array([*paid.values()]))
    return costs


def _shares(totals: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Divide whole numbers in some proportion; shape (weights, totals)."""
    ends = np.cumsum(weights)
    ends = ends / ends[-1] if ends[-1] > 0.0 else np.arange(1, weights.size + 1) / weights.size
    rounded = np.rint(np.outer(ends, totals)).astype(np.int64)
    rounded[1:] -= rounded[:-1].copy()
    return rounded
