"""Frames decoded in step: bits that each wished for, and costs that add up to what came."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder import wyner_ziv
from decoder.group_tasks import DecodedFrame
from decoder.wyner_ziv import FrameCoroutine, Prior, Wish, decode_level
from dvc.config import CascadeConfig
from dvc.contracts.test_plane_coders import noisy
from dvc.slepian_wolf import (
    CRC_BITS,
    FrameCheck,
    NeighbourCoupling,
    ParityRequest,
    Part,
    PlaneCoder,
    PlaneCost,
    PlaneResult,
    Round,
    Run,
    ask,
    crc,
    drive,
    joint_check,
)
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.requests import Kind
from dvc.video import Frame

Bits = NDArray[np.uint8]
CASCADE = CascadeCoder(CascadeConfig(), 1)
AREAS = b"some areas"


@dataclass
class Frames:
    """Frames of so many planes each, as an encoder and a decoder know them, and what they go through."""

    planes: dict[int, list[Bits]]
    llrs: dict[int, list[NDArray[np.float64]]]
    priors: dict[int, list[Prior]] = field(default_factory=dict)  # besides LLRs
    events: list[tuple[int, str]] = field(default_factory=list)
    found: dict[int, list[Bits]] = field(default_factory=dict)  # by frames
    paid: dict[int, float] = field(default_factory=dict)
    again: dict[int, list[Bits]] = field(default_factory=dict)

    @classmethod
    def drawn(cls, num_planes: dict[int, int], num_bits: int = 400) -> "Frames":
        """Draw frames of which each plane differs from its prediction in a few bits, more in the second."""
        rng = np.random.default_rng(1)
        drawn = {
            frame: [noisy(rng, num_bits, 0.02 * (1 + plane % 2)) for plane in range(count)]
            for frame, count in num_planes.items()
        }
        return cls(
            {frame: [bits for bits, _ in own] for frame, own in drawn.items()},
            {frame: [llr for _, llr in own] for frame, own in drawn.items()},
        )

    def decode(self, steps: dict[int, list[list[tuple[int, ...]]]]) -> dict[int, FrameCoroutine]:
        """Return coroutines that wish, in each step, for some planes together, or for several of such."""
        return {frame: self._frame(frame, own) for frame, own in steps.items()}

    def _frame(self, frame: int, steps: list[list[tuple[int, ...]]]) -> FrameCoroutine:
        self.found[frame], self.paid[frame], self.again[frame] = [], 0.0, []
        for step in steps:
            wishes = []
            for planes in step:
                llrs = [self.llrs[frame][plane] for plane in planes]
                priors = [self.priors[frame][plane] for plane in planes] if self.priors else llrs
                wishes.append(Wish(planes, AREAS, np.concatenate(llrs), priors))
            decoded = yield wishes
            assert [len(own) for own in decoded] == [len(planes) for planes in step]
            everything = [one for own in decoded for one in own]
            self.found[frame] += [one.bits for one in everything]
            self.paid[frame] += sum(one.paid_bits for one in everything)
            self.events.append((frame, "step"))
        self.again[frame] += [one.bits for own in (yield ()) for one in own]
        self.events.append((frame, "end"))
        luma = np.zeros((4, 4), np.uint8)
        return DecodedFrame(frame, Frame(luma), luma, luma, "test", "")


class Encoder:
    """Answers requests for runs of frames, and counts what it answers."""

    def __init__(self, frames: Frames, coder: PlaneCoder = CASCADE) -> None:
        self._frames, self._coder = frames, coder
        self.begun: list[Run] = []
        self.runs: list[Bits] = []
        self.num_bits: dict[Kind, int] = {"crc": 0, "parity": 0, "uncoded": 0, "joint": 0}
        self.num_requests = 0

    def answer(self, requests: Round) -> list[Bits]:
        return [self._answer(request) for request in requests]

    def _answer(self, request: ParityRequest) -> Bits:
        if request.begun is not None:
            assert request.run == len(self.runs)
            planes = [self._frames.planes[request.frame + offset] for offset, _, _ in request.begun]
            parts = zip(planes, request.begun, strict=True)
            self.runs.append(np.concatenate([own[p] for own, part in parts for p in part.planes]))
            self.begun.append(request.begun)
        self.num_bits[request.kind] += request.count
        self.num_requests += 1
        if request.kind == "joint":
            checks = [crc(self.runs[run], CRC_BITS) for run in request.positions]
            return joint_check(np.stack(checks))[: request.count]
        bits = self.runs[request.run]
        if request.kind == "crc":
            bits = crc(bits, CRC_BITS)
        elif request.kind == "parity":
            bits = np.concatenate([self._parity(bits, k) for k in range(request.code, self._coder.num_codes)])
        chosen = request.positions or range(request.start, request.start + request.count)
        return bits[list(chosen)]

    def _parity(self, bits: Bits, code: int) -> Bits:
        parity = np.empty(bits.size, np.uint64)
        self._coder.encode(code, bits.astype(np.uint64), parity)
        return parity.astype(np.uint8)

    def check_costs(self, decoded: Sequence[DecodedFrame]) -> None:
        """Expect what frames paid to be what was answered, in whole numbers."""
        costs = [(frame.num_requests, frame.crc_bits, frame.parity_bits) for frame in decoded]
        assert all(type(cost) is int and cost >= 0 for own in costs for cost in own)
        paid = self.num_bits
        checks, parity = paid["crc"] + paid["joint"], paid["parity"] + paid["uncoded"]
        assert tuple(map(sum, zip(*costs, strict=True))) == (self.num_requests, checks, parity)


class Plain:
    """Decodes runs by their bits themselves, some of which it takes down wrong until it checks them."""

    cost = PlaneCost(1.0, 0.0)

    def __init__(self, wrong: Sequence[int] = (), success: bool = True) -> None:
        self._wrong, self._success = wrong, success
        self._results: dict[int, PlaneResult] = {}
        self.positions: list[tuple[int, int]] = []

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> Generator[ParityRequest, Bits, PlaneResult]:
        assert coupling is None
        self.positions.append(position)
        bits = yield from ask(ParityRequest(*position, "uncoded", 0, 0, llr_ch.size))
        result = self._results[position[1]] = PlaneResult(bits, 1, 0, bits.size, 0, 0.0, 0.0)
        flipped = PlaneResult(1 - bits, 1, 0, bits.size, 0, 0.0, 0.0)
        return flipped if position[1] in self._wrong else result

    def check(self, frame: int) -> Generator[ParityRequest, Bits, FrameCheck]:
        numbers = tuple(self._results)
        if not numbers:
            return FrameCheck()
        yield from ask(ParityRequest(frame, 0, "joint", 0, 0, 9, numbers))
        corrected = {number: self._results[number] for number in self._wrong}
        return FrameCheck(corrected, 1, 9, self._success)


def test_frames_of_a_level_share_runs_and_costs() -> None:
    steps = {7: [[(0, 1)], [(2,)]], 9: [[(0,)], [(1, 2)]], 12: [[(1,)]]}
    frames = Frames.drawn({7: 3, 9: 3, 12: 2})
    encoder = Encoder(frames)
    decoded = drive(decode_level(frames.decode(steps), CASCADE.decoder(400), True), encoder.answer)
    assert encoder.begun == [
        (Part(0, (0, 1), AREAS), Part(2, (0,), AREAS), Part(5, (1,), AREAS)),
        (Part(0, (2,), AREAS), Part(2, (1, 2), AREAS)),
    ]
    for frame, own in steps.items():
        wished = [frames.planes[frame][plane] for step in own for planes in step for plane in planes]
        known = frames.again[frame] or frames.found[frame]
        np.testing.assert_array_equal(np.concatenate(known), np.concatenate(wished))
    assert [frame.index for frame in decoded] == [7, 9, 12]
    assert not any(frame.num_failed_planes for frame in decoded)
    encoder.check_costs(decoded)
    alone = 0
    for frame, own in steps.items():
        other = Encoder(frames)
        (single,) = drive(decode_level(frames.decode({frame: own}), CASCADE.decoder(400), True), other.answer)
        other.check_costs([single])
        alone += sum(other.num_bits.values())
    assert sum(encoder.num_bits.values()) < alone


def test_a_run_is_paid_for_by_ideal_code_lengths() -> None:
    """Bits that were predicted badly bear more of it, and whoever has none in it bears nothing."""
    frames = Frames.drawn({0: 2, 1: 1, 2: 1})
    frames.llrs[1][0] *= 3.0
    encoder = Encoder(frames)
    decoded = drive(
        decode_level(frames.decode({0: [[(0,)], [(1,)]], 1: [[(0,)]], 2: []}), Plain(), True), encoder.answer
    )
    encoder.check_costs(decoded)
    assert [round(paid) for paid in frames.paid.values()] == [frame.parity_bits for frame in decoded]
    assert 400 < decoded[0].parity_bits < 1200
    assert decoded[2].parity_bits == 0
    assert sum(frame.crc_bits for frame in decoded) == 9
    assert all(frame.crc_bits == 3 for frame in decoded)


def test_a_frame_that_has_ended_waits_for_the_others() -> None:
    """It is sent nothing until the check of all; what nobody else wishes for is a run of one frame."""
    frames = Frames.drawn({3: 3, 4: 1, 5: 2})
    encoder = Encoder(frames)
    steps = {3: [[(0,)], [(1,)], [(2,)]], 4: [[(0,)]], 5: [[(0,)], [(1,)]]}
    drive(decode_level(frames.decode(steps), Plain(), True), encoder.answer)
    assert frames.events[:3] == [(3, "step"), (4, "step"), (5, "step")]
    assert frames.events[3:6] == [(3, "step"), (5, "step"), (3, "step")]
    assert frames.events[6:] == [(3, "end"), (4, "end"), (5, "end")]
    assert [[part.offset for part in run] for run in encoder.begun] == [[0, 1, 2], [0, 2], [0]]
    assert not any(frames.again.values())


@pytest.mark.parametrize("success", [True, False])
def test_wrong_runs_are_corrected_by_the_check(success: bool) -> None:
    frames = Frames.drawn({3: 3, 4: 2, 6: 0})
    encoder, plain = Encoder(frames), Plain(wrong=[1], success=success)
    steps = {3: [[(0,)], [(1, 2)]], 4: [[(1,)], [(0,)]], 6: list[list[tuple[int, ...]]]()}
    decoded = drive(decode_level(frames.decode(steps), plain, True), encoder.answer)
    assert plain.positions == [(3, 0), (3, 1)]
    for frame, order in ((3, (0, 1, 2)), (4, (1, 0))):
        right = [frames.planes[frame][plane] for plane in order]
        np.testing.assert_array_equal(frames.again[frame], right)
        np.testing.assert_array_equal(frames.found[frame], [right[0], *(1 - bits for bits in right[1:])])
    assert frames.again[6] == []
    assert [frame.num_failed_planes for frame in decoded] == [int(not success)] * 3
    encoder.check_costs(decoded)


@pytest.mark.parametrize(
    ("most", "runs"),
    [
        (1000, [[(0, (0, 1)), (1, (0,)), (2, (0, 1))], [(0, (2,))]]),
        (300, [[(0, (0, 1)), (1, (0,))], [(2, (0, 1))], [(0, (2,))]]),
        (299, [[(0, (0, 1))], [(1, (0,))], [(2, (0, 1))], [(0, (2,))]]),
        (1, [[(0, (0, 1))], [(1, (0,))], [(2, (0, 1))], [(0, (2,))]]),
    ],
)
def test_wishes_that_are_too_long_together_are_divided(
    monkeypatch: pytest.MonkeyPatch, most: int, runs: list[list[tuple[int, tuple[int, ...]]]]
) -> None:
    monkeypatch.setattr(wyner_ziv, "MAX_RUN_BITS", most)
    frames = Frames.drawn({4: 3, 5: 1, 6: 2}, 100)
    encoder, rounds = Encoder(frames), list[int]()

    def answer(requests: Round) -> list[Bits]:
        rounds.append(len(requests))
        return encoder.answer(requests)

    steps = {4: [[(0, 1)], [(2,)]], 5: [[(0,)]], 6: [[(0, 1)]]}
    decoded = drive(decode_level(frames.decode(steps), Plain(), True), answer)
    assert encoder.begun == [tuple(Part(offset, own, AREAS) for offset, own in run) for run in runs]
    assert rounds == [len(runs) - 1, 1, 1]
    encoder.check_costs(decoded)


def test_a_frame_has_one_part_in_a_run() -> None:
    frames = Frames.drawn({4: 2, 5: 2, 6: 1})
    steps = {4: [[(0,), (1,)]], 5: [[(0,), (1,)]], 6: [[(0,)]]}
    encoder = Encoder(frames)
    drive(decode_level(frames.decode(steps), Plain(), True), encoder.answer)
    offsets = [[part.offset for part in run] for run in encoder.begun]
    assert all(own == sorted(set(own)) for own in offsets)
    assert sum(map(len, offsets)) == 5
    for frame in (4, 5, 6):
        np.testing.assert_array_equal(frames.found[frame], frames.planes[frame])


def test_wishes_do_not_share_runs_unless_they_may() -> None:
    frames, plain = Frames.drawn({4: 2, 5: 1}), Plain()
    encoder = Encoder(frames)
    drive(decode_level(frames.decode({4: [[(0,)], [(1,)]], 5: [[(0,)]]}), plain, False), encoder.answer)
    assert encoder.begun == [(Part(0, (0,), AREAS),), (Part(1, (0,), AREAS),), (Part(0, (1,), AREAS),)]
    assert plain.positions == [(4, 0), (4, 1), (4, 2)]


def test_couplings_of_frames_are_those_of_each() -> None:
    rng, frames = np.random.default_rng(4), Frames.drawn({1: 1, 2: 1}, 24 * 30)
    for frame in (1, 2):
        patch = np.zeros((24, 30), np.uint8)
        patch[4:12, 5 * frame : 5 * frame + 9] = 1
        frames.planes[frame] = [patch.ravel() ^ (rng.random(720) < 0.01)]
    llr = np.full((24, 30), 1.5)
    coupling = NeighbourCoupling(
        llr, np.ones_like(llr), np.full_like(llr, -1.2), np.ones_like(llr), np.zeros_like(llr),
        np.tile([1.0, 1.0, 0.0], (24, 1)), np.arange(720),
    )  # fmt: skip
    costs = []
    frames.llrs = {1: [llr.ravel()], 2: [llr.ravel()]}
    for prior in (coupling, llr.ravel()):
        encoder, frames.priors = Encoder(frames), {1: [prior], 2: [prior]}
        steps = decode_level(frames.decode({1: [[(0,)]], 2: [[(0,)]]}), CASCADE.decoder(720), True)
        encoder.check_costs(drive(steps, encoder.answer))
        for index in (1, 2):
            decoded = frames.again[index] or frames.found[index]
            np.testing.assert_array_equal(decoded[0], frames.planes[index][0])
        costs.append(sum(encoder.num_bits.values()))
    assert costs[0] < 0.8 * costs[1]
