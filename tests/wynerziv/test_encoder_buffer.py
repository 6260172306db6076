"""Answers to many requests at once are those to each of them by itself."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc._jit import python_twin
from dvc.config import CODERS, CascadeConfig
from dvc.errors import BitstreamError
from dvc.slepian_wolf import ParityRequest, RequestTable, Run, crc
from dvc.slepian_wolf.cascade.coder import CascadeCoder
from dvc.slepian_wolf.cascade.orders import bit_order
from dvc.slepian_wolf.requests import SLOT
from dvc.slepian_wolf.turbo.codes import CLASSICAL
from dvc.slepian_wolf.turbo.encoder import encode_planes
from dvc.wynerziv import _kernels, encoder_buffer
from dvc.wynerziv.areas import SIDE, Areas
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout
from tests.coders import coder_of
from tests.wynerziv.test_payloads import MATRICES, encoded_frame, layout_of, layouts, uncoded_planes

SLOTS = (2, 0)
MORE_AREAS = st.builds(layout_of, st.integers(20, 48), st.integers(20, 48), st.sampled_from(MATRICES))
NUM_CODES = coder_of("cascade").num_codes
Flags = NDArray[np.bool_]


class PlainFrame:
    """A frame whose runs are made bit by bit."""

    def __init__(self, frame: EncodedFrame) -> None:
        self.frame, self.planes = frame, uncoded_planes(frame)
        self.areas = Areas(frame.layout.band_shape)
        self.runs: dict[int, NDArray[np.uint8]] = {}
        self.taken: dict[int, Flags] = {}  # areas, by planes

    def begin(self, planes: Sequence[int], chosen: Flags) -> Run:
        """Make a run, and say which it is."""
        quantization, bits = self.frame.quantization, []
        firsts = {quantization.first_plane[band] for band in quantization.bands}
        rows, columns = self.frame.layout.band_shape
        for plane in planes:
            before = self.taken.get(plane - 1, np.zeros(self.areas.count, bool))
            self.taken[plane] = chosen if plane in firsts else chosen & before
            for row in range(rows):
                for column in range(columns):
                    area = row // SIDE * self.areas.shape[1] + column // SIDE
                    if self.taken[plane][area]:
                        bits.append(self.planes[plane, row * columns + column])
        self.runs[planes[0]] = np.array(bits, np.uint8)
        return Run(tuple(planes), self.areas.coded(chosen))

    def begin_any(self, data: st.DataObject) -> Run | None:
        """Make a run of some planes that are in none."""
        left = sorted(set(range(len(self.planes))) - set(self.taken))
        if not left:
            return None
        planes = data.draw(st.sets(st.sampled_from(left), min_size=1, max_size=4))
        share = data.draw(st.sampled_from([0.0, 0.5, 0.8, 1.0]))
        seed = data.draw(st.integers(0, 2**32 - 1))
        return self.begin(sorted(planes), np.random.default_rng(seed).random(self.areas.count) < share)

    def answer(self, request: ParityRequest, coder: str) -> NDArray[np.uint8]:
        """Return the bits that a request asks for, computed for its runs alone."""
        crc_bits = self.frame.layout.crc_bits
        if request.kind == "joint":
            checks = np.concatenate([self.check(plane) for plane in request.positions])
            return crc(checks, crc_bits)[: request.count]
        bits = self.runs[request.plane]
        if request.kind == "crc":
            bits = self.check(request.plane)
        elif request.kind == "parity" and coder == "turbo":
            bits = encode_planes(bits[None], CLASSICAL, 1)[0]
        elif request.kind == "parity":
            orders = [bit_order(number, bits.size, 1) for number in range(request.code, NUM_CODES)]
            bits = np.concatenate([np.cumsum(bits[order]) % 2 for order in orders])
        chosen = request.positions or range(request.start, request.start + request.count)
        return bits[list(chosen)].astype(np.uint8)

    def check(self, plane: int) -> NDArray[np.uint8]:
        """Return the check bits of a run; those of no bits are zeros."""
        bits, crc_bits = self.runs[plane], self.frame.layout.crc_bits
        return crc(bits, crc_bits) if bits.size else np.zeros(crc_bits, np.uint8)


def drawn_request(plain: PlainFrame, number: int, coder: str, data: st.DataObject) -> ParityRequest:
    """Return a request for bits that a run of a frame has."""
    run = None if plain.runs and data.draw(st.booleans()) else plain.begin_any(data)
    plane = data.draw(st.sampled_from(sorted(plain.runs))) if run is None else run.planes[0]
    num_bits = plain.runs[plane].size
    code = data.draw(st.integers(0, min(3, coder_of(coder).num_codes - 1)))
    kinds = ["crc"] + ["uncoded", "parity"] * (num_bits > 0) + ["joint"] * (coder == "cascade")
    kind = data.draw(st.sampled_from(kinds))
    positions: tuple[int, ...] = ()
    size = num_bits if kind in ("parity", "uncoded") else plain.frame.layout.crc_bits
    start = data.draw(st.integers(0, size - 1))
    count = data.draw(st.integers(1, size - start))
    if kind == "joint":
        others = [other for other in plain.runs if other > plane]
        chosen = {plane} | (data.draw(st.sets(st.sampled_from(others))) if others else set())
        positions = tuple(sorted(chosen))
    elif kind == "parity" and coder == "cascade":
        last = num_bits * (NUM_CODES - code) - 1
        chosen = data.draw(st.sets(st.integers(0, last), min_size=1))
        positions, count = tuple(sorted(chosen)), len(chosen)
    return ParityRequest(number, plane, kind, code, start, count, positions, run)


def table_of(requests: list[ParityRequest], slots: Sequence[int] = SLOTS) -> RequestTable:
    table = RequestTable.of(requests)
    table.rows[:, SLOT] = [slots[request.frame] for request in requests]
    return table


def answer_of(opened: EncoderBuffer, table: RequestTable) -> NDArray[np.uint8]:
    """Return the bits of an answer, which end in less than a byte of zeros."""
    bits = np.unpackbits(np.frombuffer(opened.answer(table), np.uint8))
    assert bits.size - table.num_bits < 8
    assert not bits[table.num_bits :].any()
    return bits[: table.num_bits]


@pytest.mark.parametrize("max_held_bytes", [1, 1000, encoder_buffer.MAX_HELD_BYTES])
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(layouts, MORE_AREAS), st.sampled_from(list(CODERS)), st.integers(0, 2**32 - 1), st.data())
def test_many_answers_are_those_of_the_runs_alone(
    monkeypatch: pytest.MonkeyPatch,
    max_held_bytes: int,
    layout: FrameLayout,
    coder: str,
    seed: int,
    data: st.DataObject,
) -> None:
    """Any requests for two frames, together, get the bits of each; so they do of a frame that was read."""
    monkeypatch.setattr(encoder_buffer, "MAX_HELD_BYTES", max_held_bytes)
    frames = [encoded_frame(layout, seed + number) for number in range(2)]
    plain = [PlainFrame(frame) for frame in frames]
    opened = EncoderBuffer(layout, coder_of(coder), 3)
    for slot, frame in zip(SLOTS, frames, strict=True):
        opened.enter(slot, frame)
    coded = [number for number, frame in enumerate(frames) if frame.quantization.num_planes]
    read = [EncodedFrame.read(layout, frame.buffered_payload()) for frame in frames]
    alone = [EncoderBuffer.of(frame, coder_of(coder)) for frame in read]
    for _ in range(3 if coded else 0):
        numbers = data.draw(st.lists(st.sampled_from(coded), min_size=1, max_size=5))
        requests = [drawn_request(plain[number], number, coder, data) for number in numbers]
        answers = [plain[request.frame].answer(request, coder) for request in requests]
        found = answer_of(opened, table_of(requests))
        np.testing.assert_array_equal(found, np.concatenate(answers))
        for number in range(2):
            own = [request for request in requests if request.frame == number]
            for request, found in zip(own, alone[number].answer_round(own), strict=True):
                np.testing.assert_array_equal(found, plain[number].answer(request, coder))


def test_a_slot_holds_one_frame_after_the_other() -> None:
    """Nothing of the frame before is left: parity that was computed of it is not that of the next."""
    layout = layout_of(16, 20, MATRICES[7])
    opened = EncoderBuffer(layout, coder_of("cascade"), 3)
    left = np.array([True, False])
    found = []
    for seed, planes, chosen in ((0, (0, 1), left), (1, (0, 1), left), (2, (1, 2), ~left)):
        plain = PlainFrame(encoded_frame(layout, seed))
        opened.enter(SLOTS[0], plain.frame)
        first = ParityRequest(0, 0, "crc", 0, 0, 16, (), plain.begin((0,), chosen | left))
        if planes[0]:
            answer = answer_of(opened, table_of([first]))
            np.testing.assert_array_equal(answer, plain.answer(first, "cascade"))
        run = plain.begin(planes, chosen)
        count = plain.runs[planes[0]].size
        request = ParityRequest(0, planes[0], "parity", 2, 0, count, tuple(range(count)), run)
        found.append(answer_of(opened, table_of([request])).tolist())
        assert found[-1] == plain.answer(request, "cascade").tolist()
    assert found[0] != found[1]
    assert len(found[2]) == 8


def whole_plane(number: int, plane: int, begins: bool = True) -> ParityRequest:
    """Return a request for all parities of a plane of twenty bits, the first of its band."""
    everything = tuple(range(NUM_CODES * 20))
    run = Run((plane,)) if begins else None
    return ParityRequest(number, plane, "parity", 0, 0, len(everything), everything, run)


WHOLE_BYTES = 8 * 20 * (1 + NUM_CODES)


@pytest.mark.parametrize("room", [1, 3, 8])
def test_what_is_held_stays_within_its_room(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    """Requests for all frames, in one message, are answered where there is room for a few of them."""
    layout = layout_of(16, 20, MATRICES[7])
    monkeypatch.setattr(encoder_buffer, "MAX_HELD_BYTES", room * WHOLE_BYTES)
    held: list[int] = []

    class Counting(CascadeCoder):
        def encode(self, code: int, words: NDArray[np.uint64], parity: NDArray[np.uint64]) -> None:
            arrays = [array for run in opened._held.values() for array in (run.bits, *run.parity.values())]
            held.append(sum(array.nbytes for array in arrays))
            super().encode(code, words, parity)

    opened = EncoderBuffer(layout, Counting(CascadeConfig(), 1), 8)
    plain = [PlainFrame(encoded_frame(layout, seed)) for seed in range(8)]
    for slot, own in enumerate(plain):
        opened.enter(slot, own.frame)
        own.begin((0,), np.ones(2, bool))
    begun = [ParityRequest(number, 0, "crc", 0, 0, 1, (), Run((0,))) for number in range(8)]
    answer_of(opened, table_of(begun, range(8)))  # bits alone, which give way to parity
    for order in (range(8), range(7, -1, -1), [0, 1, 0, 2, 0, 3, 0, 4, 0, 5]):
        requests = [whole_plane(number, 0, begins=False) for number in order]
        expected = [plain[request.frame].answer(request, "cascade") for request in requests]
        found = answer_of(opened, table_of(requests, range(8)))
        np.testing.assert_array_equal(found, np.concatenate(expected))
        assert opened._num_bytes == room * WHOLE_BYTES
    assert max(held) <= room * WHOLE_BYTES + 8 * 20  # that of the parity that is about to be computed
    assert sum(run.num_bytes for run in opened._held.values()) == opened._num_bytes
    for slot in range(8):
        opened.enter(slot, encoded_frame(layout, 9))
    assert opened._num_bytes == len(opened._held) == 0


def test_parity_of_runs_asked_for_longest_ago_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no room, it is computed again for these alone; it is not for others."""
    layout = layout_of(16, 20, MATRICES[7])
    monkeypatch.setattr(encoder_buffer, "MAX_HELD_BYTES", 2 * WHOLE_BYTES)
    computed: list[int] = []

    class Counting(CascadeCoder):
        def encode(self, code: int, words: NDArray[np.uint64], parity: NDArray[np.uint64]) -> None:
            computed[-1] += 1
            super().encode(code, words, parity)

    opened = EncoderBuffer(layout, Counting(CascadeConfig(), 1), 3)
    for slot in range(3):
        opened.enter(slot, encoded_frame(layout, slot))
    known: set[int] = set()
    for slot in [0, 1, 0, 2, 0, 1, 1]:
        computed.append(0)
        opened.answer(table_of([whole_plane(slot, 0, slot not in known)], range(3)))
        known.add(slot)
    assert computed == [NUM_CODES, NUM_CODES, 0, NUM_CODES, 0, NUM_CODES, 0]


def test_only_parity_that_is_asked_for_is_computed() -> None:
    """Of the codes that positions name, and of no other."""
    computed: list[int] = []

    class Noting(CascadeCoder):
        def encode(self, code: int, words: NDArray[np.uint64], parity: NDArray[np.uint64]) -> None:
            computed.append(code)
            super().encode(code, words, parity)

    frame = encoded_frame(layout_of(16, 20, MATRICES[7]), 0)
    opened = EncoderBuffer.of(frame, Noting(CascadeConfig(), 1))
    opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, 20, (), Run((0,)))])
    opened.answer_round([ParityRequest(0, 0, "crc", 0, 0, 3)])
    assert not computed
    opened.answer_round([ParityRequest(0, 0, "parity", 1, 0, 3, (0, 19, 45))])
    assert computed == [1, 3]
    opened.answer_round([ParityRequest(0, 0, "parity", 1, 0, 2, (7, 39))])
    assert computed == [1, 3, 2]


def test_planes_of_a_band_have_bits_in_areas_of_those_before() -> None:
    """In one run and from run to run; the first plane of a band has them wherever they are asked for."""
    layout = layout_of(32, 48, MATRICES[7])
    frame = encoded_frame(layout, 3)
    first, second = frame.quantization.first_plane[:2]
    planes, areas = uncoded_planes(frame), Areas(layout.band_shape)
    assert second - first > 4
    assert areas.count == 6
    left, top = np.array([1, 0, 0] * 2, bool), np.array([1] * 3 + [0] * 3, bool)
    opened = EncoderBuffer.of(frame, coder_of("cascade"))

    def asked(*run: tuple[int, Flags], chosen: Flags) -> None:
        """Ask for a run in some areas, and expect bits of each plane in others."""
        inside = [planes[plane][expected[areas.of_blocks]] for plane, expected in run]
        bits = np.concatenate(inside)
        begun = Run(tuple(plane for plane, _ in run), areas.coded(chosen))
        request = ParityRequest(0, begun.planes[0], "uncoded", 0, 0, bits.size, (), begun)
        np.testing.assert_array_equal(opened.answer_round([request])[0], bits)
        with pytest.raises(ValueError, match=f"bit {bits.size} of a run of {bits.size}"):
            opened.answer_round([replace(request, start=bits.size, count=1, run=None)])

    everywhere, corner = np.ones(6, bool), left & top
    asked((0, left), chosen=left)
    asked((1, left), (second, everywhere), chosen=everywhere)
    asked((2, corner), (second + 1, top), chosen=top)
    asked((3, corner), (4, corner), chosen=everywhere)
    asked((second + 2, corner), chosen=left)


def test_planes_whose_band_was_not_asked_for_before_have_no_bits() -> None:
    """Whatever areas are chosen; their check bits are those of nothing."""
    frame = encoded_frame(layout_of(16, 20, MATRICES[7]), 0)
    opened = EncoderBuffer.of(frame, coder_of("cascade"))
    check = ParityRequest(0, 2, "crc", 0, 0, 16, (), Run((2, 3)))
    assert not opened.answer_round([check])[0].any()
    assert not opened.answer_round([ParityRequest(0, 2, "joint", 0, 0, 16, (2,))])[0].any()
    with pytest.raises(ValueError, match="bit 0 of a run of 0"):
        opened.answer_round([ParityRequest(0, 2, "uncoded", 0, 0, 1)])


@pytest.mark.parametrize(
    ("coder", "request_", "text"),
    [
        ("cascade", ParityRequest(0, 0, "uncoded", 0, 3, 38), "bit 40 of a run of 40"),
        ("cascade", ParityRequest(0, 0, "parity", 0, 0, 1, (8 * 40,)), "bit 320 of a run of 40"),
        ("cascade", ParityRequest(0, 0, "parity", 7, 0, 2, (3, 40)), "bit 40 of a run of 40"),
        ("turbo", ParityRequest(0, 0, "uncoded", 0, 0, 41), "bit 40 of a run of 40"),
        ("turbo", ParityRequest(0, 0, "parity", 0, 40, 1), "bit 40 of a run of 40"),
    ],
)
def test_bits_beyond_a_run_are_refused(coder: str, request_: ParityRequest, text: str) -> None:
    """Runs of two planes have bits of both, and no more; one bit less is answered."""
    frame = encoded_frame(layout_of(16, 20, MATRICES[7]), 0)
    opened = EncoderBuffer.of(frame, coder_of(coder))
    opened.answer_round([ParityRequest(0, 0, "crc", 0, 0, 1, (), Run((0, 1)))])
    with pytest.raises(ValueError, match=text):
        opened.answer_round([request_])
    positions = tuple(position - 1 for position in request_.positions)
    fewer = replace(request_, start=max(request_.start - 1, 0), positions=positions)
    fewer = replace(fewer, count=min(fewer.count, 40 - fewer.start))
    assert opened.answer_round([fewer])[0].size == fewer.count


@pytest.mark.parametrize("planes", [(41,), (0, 7, 41)])
def test_planes_that_a_frame_lacks_are_refused(planes: tuple[int, ...]) -> None:
    """What other frames of the layout may have, but this one has not, raises `ValueError`."""
    layout = layout_of(16, 16, None)
    opened = EncoderBuffer(layout, coder_of("cascade"), 3)
    frame = encoded_frame(layout, 0, step_index=40)
    assert 8 < frame.quantization.num_planes <= 41
    opened.enter(SLOTS[0], frame)
    refused = ParityRequest(0, planes[0], "crc", 0, 0, 1, (), Run(planes))
    with pytest.raises(ValueError, match="plane 41 of frame 0"):
        opened.answer(table_of([ParityRequest(0, 1, "crc", 0, 0, 8, (), Run((1,))), refused]))


def test_runs_of_slots_without_a_frame_are_refused() -> None:
    """There is no plane in them."""
    opened = EncoderBuffer(layout_of(16, 16, None), coder_of("cascade"), 3)
    with pytest.raises(ValueError, match="plane 0 of frame 1"):
        opened.answer(table_of([ParityRequest(1, 0, "crc", 0, 0, 8, (), Run((0,)))]))


@pytest.mark.parametrize("garbage", [b"\xff" * 9, b"\0\0"])
def test_areas_that_nobody_writes_are_refused(garbage: bytes) -> None:
    """What is known of other runs stays."""
    frame = encoded_frame(layout_of(16, 20, MATRICES[7]), 0)
    opened = EncoderBuffer.of(frame, coder_of("cascade"))
    bits = opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, 20, (), Run((0,)))])[0]
    with pytest.raises(BitstreamError, match="range-coded data"):
        opened.answer_round([ParityRequest(0, 1, "crc", 0, 0, 8, (), Run((1,), garbage))])
    np.testing.assert_array_equal(opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, 20)])[0], bits)


@pytest.mark.nojit
def test_picking_kernel_equals_its_twin() -> None:
    """Compiled and as Python, and both as plain indexing."""
    rng = np.random.default_rng(5)
    words, planes = rng.integers(0, 2**64, (2, 30), dtype=np.uint64), np.array([0, 3, 63, 64, 100])
    areas, chosen = rng.integers(0, 4, 30), rng.random((5, 4)) < 0.5
    expected = [
        (words[plane // 64] >> np.uint64(63 - plane % 64) & np.uint64(1))[own[areas]]
        for plane, own in zip(planes.tolist(), chosen, strict=True)
    ]
    for kernel in (_kernels.pick_bits, python_twin(_kernels.pick_bits)):
        bits = np.empty(sum(own.size for own in expected), np.uint64)
        kernel(words, planes, areas, chosen, bits)
        np.testing.assert_array_equal(bits, np.concatenate(expected))
