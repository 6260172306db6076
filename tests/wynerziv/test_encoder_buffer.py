"""Answers to many requests at once are those to each of them by itself."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.config import CODERS, CascadeConfig
from dvc.errors import BitstreamError
from dvc.slepian_wolf import MAX_RUN_BITS, ParityRequest, Part, PlaneCoder, RequestTable, Run, crc
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.cascade.posterior import bit_order
from dvc.slepian_wolf.requests import FRAME, SLOT, Kind
from dvc.wynerziv import _kernels, encoder_buffer
from dvc.wynerziv.areas import SIDE, Areas
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout
from tests.coders import coder_of, encode_planes
from tests.twins import Choose
from tests.wynerziv.test_payloads import MATRICES, encoded_frame, layout_of, layouts, uncoded_planes

FIRST_SLOT = 2
MORE_AREAS = st.builds(layout_of, st.integers(20, 48), st.integers(20, 48), st.sampled_from(MATRICES))
NUM_CODES = coder_of("cascade").num_codes
Flags = NDArray[np.bool_]


class PlainFrame:
    """A frame whose bits are picked one by one."""

    def __init__(self, frame: EncodedFrame) -> None:
        self.frame, self.planes = frame, uncoded_planes(frame)
        self.areas = Areas(frame.layout.band_shape)
        self.taken: dict[int, Flags] = {}  # areas, by planes

    def pick(self, planes: Sequence[int], chosen: Flags) -> list[int]:
        """Return the bits of planes in some areas."""
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
                        bits.append(int(self.planes[plane, row * columns + column]))
        return bits

    @property
    def left(self) -> list[int]:
        """Planes that are in no run."""
        return sorted(set(range(len(self.planes))) - set(self.taken))


class PlainRuns:
    """Runs of a few frames, by the frame that names them and their number, and the answers to requests."""

    def __init__(self, frames: Sequence[EncodedFrame], coder: str = "cascade") -> None:
        self.frames, self.coder = [PlainFrame(frame) for frame in frames], coder
        self.bits: dict[int, list[NDArray[np.uint8]]] = {number: [] for number in range(len(frames))}

    def begin(self, named: int, *parts: tuple[int, Sequence[int], Flags]) -> Run:
        """Make a run of planes of some frames, in areas of each, and say which it is."""
        bits = [bit for frame, planes, chosen in parts for bit in self.frames[frame].pick(planes, chosen)]
        self.bits[named].append(np.array(bits, np.uint8))
        areas = self.frames[0].areas
        return tuple(Part(frame - named, tuple(planes), areas.coded(own)) for frame, planes, own in parts)

    def begin_any(self, named: int, data: st.DataObject) -> Run | None:
        """Make a run of some planes that are in none, of one frame or of those after it as well."""
        parts = []
        for frame in range(named, len(self.frames)):
            own = self.frames[frame]
            if not own.left or data.draw(st.booleans()):
                continue
            planes = data.draw(st.sets(st.sampled_from(own.left), min_size=1, max_size=4))
            share = data.draw(st.sampled_from([0.0, 0.5, 0.8, 1.0]))
            seed = data.draw(st.integers(0, 2**32 - 1))
            chosen = np.random.default_rng(seed).random(own.areas.count) < share
            parts.append((frame, sorted(planes), chosen))
        return self.begin(named, *parts) if parts else None

    def answer(self, request: ParityRequest) -> NDArray[np.uint8]:
        """Return the bits that a request asks for, computed for its runs alone."""
        crc_bits = self.frames[0].frame.layout.crc_bits
        if request.kind == "joint":
            checks = np.concatenate([self.check(request.frame, run) for run in request.positions])
            return crc(checks, crc_bits)[: request.count]
        bits = self.bits[request.frame][request.run]
        if request.kind == "crc":
            bits = self.check(request.frame, request.run)
        elif request.kind == "parity" and self.coder == "turbo":
            bits = encode_planes(bits[None], 1)[0]
        elif request.kind == "parity":
            orders = [bit_order(number, bits.size, 1) for number in range(request.code, NUM_CODES)]
            bits = np.concatenate([np.cumsum(bits[order]) % 2 for order in orders])
        chosen = request.positions or range(request.start, request.start + request.count)
        return bits[list(chosen)].astype(np.uint8)

    def check(self, named: int, run: int) -> NDArray[np.uint8]:
        """Return the check bits of a run; those of no bits are zeros."""
        bits, crc_bits = self.bits[named][run], self.frames[0].frame.layout.crc_bits
        return crc(bits, crc_bits) if bits.size else np.zeros(crc_bits, np.uint8)


def drawn_request(plain: PlainRuns, named: int, data: st.DataObject) -> ParityRequest | None:
    """Return a request for bits that a run has, if a frame can name one."""
    runs, coder = plain.bits[named], coder_of(plain.coder)
    begun = None if runs and data.draw(st.booleans()) else plain.begin_any(named, data)
    if not runs:
        return None
    run = data.draw(st.integers(0, len(runs) - 1)) if begun is None else len(runs) - 1
    num_bits = runs[run].size
    code = data.draw(st.integers(0, min(3, coder.num_codes - 1)))
    kinds = ["crc"] + ["uncoded", "parity"] * (num_bits > 0) + ["joint"] * coder.by_positions
    kind = data.draw(st.sampled_from(kinds))
    positions: tuple[int, ...] = ()
    size = num_bits if kind in ("parity", "uncoded") else plain.frames[0].frame.layout.crc_bits
    start = data.draw(st.integers(0, size - 1))
    count = data.draw(st.integers(1, size - start))
    if kind == "joint":
        others = range(run + 1, len(runs))
        chosen = {run} | (data.draw(st.sets(st.sampled_from(others))) if others else set())
        positions = tuple(sorted(chosen))
    elif kind == "parity" and coder.by_positions:
        last = num_bits * (NUM_CODES - code) - 1
        chosen = data.draw(st.sets(st.integers(0, last), min_size=1))
        positions, count = tuple(sorted(chosen)), len(chosen)
    return ParityRequest(named, run, kind, code, start, count, positions, begun)


def table_of(requests: Sequence[ParityRequest], first_slot: int = 0) -> RequestTable:
    """Return requests, where slots from the first one on hold frames from the first one on."""
    table = RequestTable.of(requests)
    table.rows[:, SLOT] = table.rows[:, FRAME] + first_slot
    return table


def beginning(
    frame: int, run: int, kind: Kind, count: int, *planes: int, areas: bytes = b""
) -> ParityRequest:
    """Return the first request for a run of planes of the frame that names it."""
    return ParityRequest(frame, run, kind, 0, 0, count, (), (Part(0, planes, areas),))


def opened_of(*frames: EncodedFrame, coder: PlaneCoder | None = None) -> EncoderBuffer:
    """Return what answers for some frames of one layout."""
    opened = EncoderBuffer(frames[0].layout, coder or coder_of("cascade"), len(frames))
    for slot, frame in enumerate(frames):
        opened.enter(slot, frame)
    return opened


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
    """Any requests for two frames, together, get the bits of each run; so do frames that were read."""
    monkeypatch.setattr(encoder_buffer, "MAX_HELD_BYTES", max_held_bytes)
    frames = [encoded_frame(layout, seed + number) for number in range(2)]
    plain = PlainRuns(frames, coder)
    opened = EncoderBuffer(layout, coder_of(coder), FIRST_SLOT + 2)
    for number, frame in enumerate(frames):
        opened.enter(FIRST_SLOT + number, frame)
    read = [EncodedFrame.read(layout, frame.buffered_payload()) for frame in frames]
    from_stream = opened_of(*read, coder=coder_of(coder))
    for _ in range(3):
        named = data.draw(st.lists(st.integers(0, 1), min_size=1, max_size=5))
        drawn = [drawn_request(plain, number, data) for number in named]
        requests = [request for request in drawn if request is not None]
        if not requests:
            continue
        answers = [plain.answer(request) for request in requests]
        found = answer_of(opened, table_of(requests, FIRST_SLOT))
        np.testing.assert_array_equal(found, np.concatenate(answers))
        moved = [replace(request, frame=request.frame + 7) for request in requests]
        for own, expected in zip(from_stream.answer_round(moved, 7), answers, strict=True):
            np.testing.assert_array_equal(own, expected)


def test_a_run_has_bits_of_one_frame_after_the_other() -> None:
    """In order of display, of other planes and areas of each, named by a frame of which it has none."""
    layout = layout_of(32, 48, MATRICES[7])
    plain = PlainRuns([encoded_frame(layout, seed) for seed in range(3)])
    opened = opened_of(*(own.frame for own in plain.frames))
    left, top = np.array([1, 0, 0] * 2, bool), np.array([1] * 3 + [0] * 3, bool)
    begun = plain.begin(0, (1, (0, 1), left), (2, (0,), top))
    assert [(part.offset, part.planes) for part in begun] == [(1, (0, 1)), (2, (0,))]
    size = plain.bits[0][0].size
    assert size == 2 * 32 + 48
    (bits,) = opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, size, (), begun)], 0)
    np.testing.assert_array_equal(bits, plain.bits[0][0])
    second = plain.begin(0, (0, (0,), top), (1, (1, 2), top))  # in areas where the plane before was taken
    assert plain.bits[0][1].size == 48 + 16 + 16
    requests = [
        ParityRequest(0, 1, "parity", 0, 0, 3, (0, 79, 80 * NUM_CODES - 1), second),
        ParityRequest(0, 0, "joint", 0, 0, 16, (0, 1)),
        ParityRequest(0, 1, "crc", 0, 0, 16),
    ]
    for request, found in zip(requests, opened.answer_round(requests, 0), strict=True):
        np.testing.assert_array_equal(found, plain.answer(request))


def test_runs_that_are_too_long_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_RUN_BITS == encoder_buffer.MAX_RUN_BITS
    monkeypatch.setattr(encoder_buffer, "MAX_RUN_BITS", 60)
    layout = layout_of(16, 20, MATRICES[7])
    opened = opened_of(*(encoded_frame(layout, seed) for seed in range(2)))
    longest = Part(0, (0, 1)), Part(1, (0,))
    assert opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, 60, (), longest)], 0)[0].size == 60
    kinds: tuple[Kind, ...] = ("crc", "uncoded", "parity", "joint")
    too_long = Part(0, (0, 1)), Part(1, (0, 1))
    for number, kind in enumerate(kinds, 1):
        positions = {"parity": (0,), "joint": (number,)}.get(kind, ())
        request = ParityRequest(0, number, kind, 0, 0, 1, positions, too_long)
        with pytest.raises(ValueError, match="a run of 80 bits, at most 60 are allowed"):
            opened.answer_round([request], 0)
    assert opened.answer_round([ParityRequest(0, 0, "crc", 0, 0, 16)], 0)[0].size == 16


def test_a_slot_holds_one_frame_after_the_other() -> None:
    """Nothing of the frame before is left: parity that was computed of it is not that of the next."""
    layout = layout_of(16, 20, MATRICES[7])
    opened = EncoderBuffer(layout, coder_of("cascade"), FIRST_SLOT + 1)
    left = np.array([True, False])
    found = []
    for seed, planes, chosen in ((0, (0, 1), left), (1, (0, 1), left), (2, (1, 2), ~left)):
        plain = PlainRuns([encoded_frame(layout, seed)])
        opened.enter(FIRST_SLOT, plain.frames[0].frame)
        if planes[0]:
            before = ParityRequest(0, 0, "crc", 0, 0, 16, (), plain.begin(0, (0, (0,), chosen | left)))
            answer = answer_of(opened, table_of([before], FIRST_SLOT))
            np.testing.assert_array_equal(answer, plain.answer(before))
        begun = plain.begin(0, (0, planes, chosen))
        run = len(plain.bits[0]) - 1
        count = plain.bits[0][run].size
        request = ParityRequest(0, run, "parity", 2, 0, count, tuple(range(count)), begun)
        found.append(answer_of(opened, table_of([request], FIRST_SLOT)).tolist())
        assert found[-1] == plain.answer(request).tolist()
    assert found[0] != found[1]
    assert len(found[2]) == 8


class Noting(CascadeCoder):
    """Calls a function with the number of each code before its parity is computed."""

    def __init__(self, note: Callable[[int], None]) -> None:
        super().__init__(CascadeConfig(), 1)
        self._note = note

    def encode(self, code: int, words: NDArray[np.uint64], parity: NDArray[np.uint64]) -> None:
        self._note(code)
        super().encode(code, words, parity)


def whole_plane(frame: int, begins: bool = True) -> ParityRequest:
    """Return a request for all parities of a run of twenty bits, the first plane of a frame."""
    everything = tuple(range(NUM_CODES * 20))
    begun = (Part(0, (0,)),) if begins else None
    return ParityRequest(frame, 0, "parity", 0, 0, len(everything), everything, begun)


WHOLE_BYTES = 20 * (8 + NUM_CODES)


@pytest.mark.parametrize("room", [1, 3, 8])
def test_what_is_held_stays_within_its_room(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    layout = layout_of(16, 20, MATRICES[7])
    monkeypatch.setattr(encoder_buffer, "MAX_HELD_BYTES", room * WHOLE_BYTES)
    held: list[int] = []

    def note(_: int) -> None:
        held.append(sum(run.bits.nbytes + run.parity.nbytes for run in opened._held.values()))

    plain = PlainRuns([encoded_frame(layout, seed) for seed in range(8)])
    opened = opened_of(*(own.frame for own in plain.frames), coder=Noting(note))
    for number in range(8):
        plain.begin(number, (number, (0,), np.ones(2, bool)))
    answer_of(opened, table_of([beginning(number, 0, "crc", 1, 0) for number in range(8)]))  # bits alone
    for order in (range(8), range(7, -1, -1), [0, 1, 0, 2, 0, 3, 0, 4, 0, 5]):
        requests = [whole_plane(number, begins=False) for number in order]
        expected = [plain.answer(request) for request in requests]
        found = answer_of(opened, table_of(requests))
        np.testing.assert_array_equal(found, np.concatenate(expected))
        assert opened._num_bytes <= room * WHOLE_BYTES
        assert sum(run.num_bytes for run in opened._held.values()) == opened._num_bytes > 0
    assert max(held) <= room * WHOLE_BYTES
    for slot in range(8):
        opened.enter(slot, encoded_frame(layout, 9))
    assert opened._num_bytes == len(opened._held) == 0


def test_parity_of_runs_that_were_begun_first_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no room, it is computed again for these alone; it is not for others."""
    layout = layout_of(16, 20, MATRICES[7])
    monkeypatch.setattr(encoder_buffer, "MAX_HELD_BYTES", 2 * WHOLE_BYTES)
    codes: list[int] = []
    opened = opened_of(*(encoded_frame(layout, seed) for seed in range(3)), coder=Noting(codes.append))
    computed, known = [], set[int]()
    for frame in [0, 1, 0, 2, 1, 0, 0]:
        before = len(codes)
        opened.answer(table_of([whole_plane(frame, frame not in known)]))
        computed.append(len(codes) - before)
        known.add(frame)
    assert computed == [NUM_CODES, NUM_CODES, 0, NUM_CODES, 0, NUM_CODES, 0]


def test_only_parity_that_is_asked_for_is_computed() -> None:
    computed: list[int] = []
    opened = opened_of(encoded_frame(layout_of(16, 20, MATRICES[7]), 0), coder=Noting(computed.append))
    opened.answer_round([beginning(0, 0, "uncoded", 20, 0)], 0)
    opened.answer_round([ParityRequest(0, 0, "crc", 0, 0, 3)], 0)
    assert not computed
    opened.answer_round([ParityRequest(0, 0, "parity", 1, 0, 3, (0, 19, 45))], 0)
    assert {1, 3} <= set(computed) <= {0, 1, 2, 3}
    opened.answer_round([ParityRequest(0, 0, "parity", 1, 0, 2, (7, 39))], 0)
    assert {1, 2, 3} <= set(computed) <= {0, 1, 2, 3}
    assert len(computed) == len({*computed})


def test_planes_of_a_band_have_bits_in_areas_of_those_before() -> None:
    layout = layout_of(32, 48, MATRICES[7])
    frame = encoded_frame(layout, 3)
    first, second = frame.quantization.first_plane[:2]
    planes, areas = uncoded_planes(frame), Areas(layout.band_shape)
    assert second - first > 4
    assert areas.count == 6
    left, top = np.array([1, 0, 0] * 2, bool), np.array([1] * 3 + [0] * 3, bool)
    opened, number = opened_of(frame), count()

    def asked(*run: tuple[int, Flags], chosen: Flags) -> None:
        """Ask for a run in some areas, and expect bits of each plane in others."""
        inside = [planes[plane][expected[areas.of_blocks]] for plane, expected in run]
        bits = np.concatenate(inside)
        own = tuple(plane for plane, _ in run)
        request = beginning(0, next(number), "uncoded", bits.size, *own, areas=areas.coded(chosen))
        np.testing.assert_array_equal(opened.answer_round([request], 0)[0], bits)
        with pytest.raises(ValueError, match=f"bit {bits.size} of a run of {bits.size}"):
            opened.answer_round([replace(request, start=bits.size, count=1, begun=None)], 0)

    everywhere, corner = np.ones(6, bool), left & top
    asked((0, left), chosen=left)
    asked((1, left), (second, everywhere), chosen=everywhere)
    asked((2, corner), (second + 1, top), chosen=top)
    asked((3, corner), (4, corner), chosen=everywhere)
    asked((second + 2, corner), chosen=left)


def test_planes_whose_band_was_not_asked_for_before_have_no_bits() -> None:
    frame = encoded_frame(layout_of(16, 20, MATRICES[7]), 0)
    opened = opened_of(frame)
    assert not opened.answer_round([beginning(0, 0, "crc", 16, 2, 3)], 0)[0].any()
    assert not opened.answer_round([ParityRequest(0, 0, "joint", 0, 0, 16, (0,))], 0)[0].any()
    with pytest.raises(ValueError, match="bit 0 of a run of 0"):
        opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, 1)], 0)


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
    frame = encoded_frame(layout_of(16, 20, MATRICES[7]), 0)
    opened = opened_of(frame, coder=coder_of(coder))
    opened.answer_round([beginning(0, 0, "crc", 1, 0, 1)], 0)
    with pytest.raises(ValueError, match=text):
        opened.answer_round([request_], 0)
    positions = tuple(position - 1 for position in request_.positions)
    fewer = replace(request_, start=max(request_.start - 1, 0), positions=positions)
    fewer = replace(fewer, count=min(fewer.count, 40 - fewer.start))
    assert opened.answer_round([fewer], 0)[0].size == fewer.count


@pytest.mark.parametrize("planes", [(41,), (0, 7, 41)])
def test_planes_that_a_frame_lacks_are_refused(planes: tuple[int, ...]) -> None:
    layout = layout_of(16, 16, None)
    whole, frame = encoded_frame(layout, 0), encoded_frame(layout, 0, step_index=40)
    assert 8 < frame.quantization.num_planes <= 41 < whole.quantization.num_planes
    opened = opened_of(whole, frame)
    for refused in (
        beginning(1, 0, "crc", 1, *planes),
        replace(beginning(0, 1, "crc", 1), begun=(Part(1, planes),)),
    ):
        with pytest.raises(ValueError, match="plane 41 of a frame"):
            opened.answer(table_of([beginning(0, 0, "crc", 8, 1), refused]))


@pytest.mark.parametrize("begun", [(Part(0, (0,)),), (Part(-1, (0,)), Part(0, (0,)))])
def test_runs_of_slots_without_a_frame_are_refused(begun: Run) -> None:
    opened = EncoderBuffer(layout_of(16, 16, None), coder_of("cascade"), 3)
    opened.enter(0, encoded_frame(layout_of(16, 16, None), 0))
    with pytest.raises(ValueError, match="plane 0 of a frame"):
        opened.answer(table_of([ParityRequest(1, 0, "crc", 0, 0, 8, (), begun)]))


@pytest.mark.parametrize("garbage", [b"\xff" * 9, b"\0\0"])
def test_areas_that_nobody_writes_are_refused(garbage: bytes) -> None:
    opened = opened_of(encoded_frame(layout_of(16, 20, MATRICES[7]), 0))
    bits = opened.answer_round([beginning(0, 0, "uncoded", 20, 0)], 0)[0]
    with pytest.raises(BitstreamError, match="range-coded data"):
        opened.answer_round([beginning(0, 1, "crc", 8, 1, areas=garbage)], 0)
    found = opened.answer_round([ParityRequest(0, 0, "uncoded", 0, 0, 20)], 0)[0]
    np.testing.assert_array_equal(found, bits)


@pytest.mark.nojit
def test_picking_kernel_equals_its_twin(choose: Choose) -> None:
    rng = np.random.default_rng(5)
    words, planes = rng.integers(0, 2**64, (2, 30), dtype=np.uint64), np.array([0, 3, 63, 64, 100])
    areas, chosen = rng.integers(0, 4, 30), rng.random((5, 4)) < 0.5
    expected = [
        (words[plane // 64] >> np.uint64(63 - plane % 64) & np.uint64(1))[own[areas]]
        for plane, own in zip(planes.tolist(), chosen, strict=True)
    ]
    bits = np.empty(sum(own.size for own in expected), np.uint64)
    choose(_kernels.pick_bits)(words, planes, areas, chosen, bits)
    np.testing.assert_array_equal(bits, np.concatenate(expected))
