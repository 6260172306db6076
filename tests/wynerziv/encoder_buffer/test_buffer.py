"""Answers to many requests at once are those to each of them by itself."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.config import CODERS, CascadeConfig
from dvc.slepian_wolf import ParityRequest, RequestTable, crc
from dvc.slepian_wolf.cascade.coder import CascadeCoder
from dvc.slepian_wolf.cascade.orders import bit_orders
from dvc.slepian_wolf.requests import SLOT
from dvc.slepian_wolf.turbo.codes import CLASSICAL
from dvc.slepian_wolf.turbo.encoder import encode_planes
from dvc.wynerziv.encoder_buffer import buffer
from dvc.wynerziv.encoder_buffer.buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout
from tests.coders import coder_of
from tests.wynerziv.test_payloads import MATRICES, encoded_frame, layout_of, layouts, uncoded_planes

SLOTS = (2, 0)


def drawn_request(frame: EncodedFrame, number: int, coder: str, data: st.DataObject) -> ParityRequest:
    """Return a request for bits that a frame has."""
    layout, num_planes = frame.layout, frame.quantization.num_planes
    plane = data.draw(st.integers(0, num_planes - 1))
    code = data.draw(st.integers(0, min(3, coder_of(coder).num_codes - 1)))
    kinds = ["crc", "uncoded", "parity"] + ["joint"] * (coder == "cascade")
    kind = data.draw(st.sampled_from(kinds))
    positions: tuple[int, ...] = ()
    size = layout.num_bits if kind in ("parity", "uncoded") else layout.crc_bits
    start = data.draw(st.integers(0, size - 1))
    count = data.draw(st.integers(1, size - start))
    if kind == "joint":
        chosen = data.draw(st.sets(st.integers(plane, num_planes - 1))) | {plane}
        positions = tuple(sorted(chosen))
    elif kind == "parity" and coder == "cascade":
        last = layout.num_bits * (coder_of(coder).num_codes - code) - 1
        chosen = data.draw(st.sets(st.integers(0, last), min_size=1))
        positions, count = tuple(sorted(chosen)), len(chosen)
    return ParityRequest(number, plane, kind, code, start, count, positions)


def plain_answer(frame: EncodedFrame, request: ParityRequest, coder: str) -> NDArray[np.uint8]:
    """Return the bits that a request asks for, computed for its planes alone."""
    planes, crc_bits = uncoded_planes(frame), frame.layout.crc_bits
    bits = planes[request.plane]
    if request.kind == "joint":
        checks = np.concatenate([crc(planes[plane], crc_bits) for plane in request.positions])
        return crc(checks, crc_bits)[: request.count]
    if request.kind == "crc":
        bits = crc(bits, crc_bits)
    elif request.kind == "parity" and coder == "turbo":
        bits = encode_planes(bits[None], CLASSICAL, 1)[0]
    elif request.kind == "parity":
        orders = bit_orders(bits.size, 1)[request.code :]
        bits = np.concatenate([np.cumsum(bits[order]) % 2 for order in orders])
    chosen = request.positions or range(request.start, request.start + request.count)
    return bits[list(chosen)].astype(np.uint8)


def table_of(requests: list[ParityRequest]) -> RequestTable:
    table = RequestTable.of(requests)
    table.rows[:, SLOT] = [SLOTS[request.frame] for request in requests]
    return table


@pytest.mark.parametrize("max_parity_bytes", [1, buffer.MAX_PARITY_BYTES])
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(layouts, st.sampled_from(list(CODERS)), st.integers(0, 2**32 - 1), st.data())
def test_many_answers_are_those_of_the_planes_alone(
    monkeypatch: pytest.MonkeyPatch,
    max_parity_bytes: int,
    layout: FrameLayout,
    coder: str,
    seed: int,
    data: st.DataObject,
) -> None:
    """Any requests for two frames, together, get the bits of each; so they do of a frame that was read."""
    monkeypatch.setattr(buffer, "MAX_PARITY_BYTES", max_parity_bytes)
    frames = [encoded_frame(layout, seed + number) for number in range(2)]
    opened = EncoderBuffer(layout, coder_of(coder), 3)
    for slot, frame in zip(SLOTS, frames, strict=True):
        opened.enter(slot, frame)
    coded = [number for number, frame in enumerate(frames) if frame.quantization.num_planes]
    for _ in range(2 if coded else 0):
        numbers = data.draw(st.lists(st.sampled_from(coded), min_size=1, max_size=5))
        requests = [drawn_request(frames[number], number, coder, data) for number in numbers]
        bits = np.unpackbits(np.frombuffer(opened.answer(table_of(requests)), np.uint8))
        answers = [plain_answer(frames[request.frame], request, coder) for request in requests]
        expected = np.concatenate(answers)
        np.testing.assert_array_equal(bits[: expected.size], expected)
        assert bits.size - expected.size < 8
        assert not bits[expected.size :].any()
        number = numbers[0]
        read = EncoderBuffer.of(EncodedFrame.read(layout, frames[number].buffered_payload()), coder_of(coder))
        own = [request for request in requests if request.frame == number]
        for request, found in zip(own, read.answer_round(own), strict=True):
            np.testing.assert_array_equal(found, plain_answer(frames[number], request, coder))


def test_a_slot_holds_one_frame_after_the_other() -> None:
    """Nothing of the frame before is left: parity that was computed of it is not that of the next."""
    layout = layout_of(16, 20, MATRICES[7])
    opened = EncoderBuffer(layout, coder_of("cascade"), 3)
    table = table_of([ParityRequest(0, 3, "parity", 2, 0, 20, tuple(range(20)))])
    found = []
    for seed in range(2):
        frame = encoded_frame(layout, seed)
        opened.enter(SLOTS[0], frame)
        found.append(opened.answer(table))
        expected = plain_answer(frame, table.requests()[0], "cascade")
        np.testing.assert_array_equal(np.unpackbits(np.frombuffer(found[-1], np.uint8))[:20], expected)
    assert found[0] != found[1]


def test_parity_of_frames_that_are_out_of_use_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes as many places as frames are asked for at a time, and comes back where it is needed again."""
    monkeypatch.setattr(buffer, "PATIENCE", 2)
    layout = layout_of(16, 20, MATRICES[7])
    opened = EncoderBuffer(layout, coder_of("cascade"), 8)
    frames = [encoded_frame(layout, seed) for seed in range(8)]
    for slot, frame in enumerate(frames):
        opened.enter(slot, frame)
    for slot in [0, 1, 2, 3, 4, 5, 6, 7, 0, 7, 6, 0, 1]:
        request = ParityRequest(0, 3, "parity", 2, 0, 20, tuple(range(20)))
        table = RequestTable.of([request])
        table.rows[:, SLOT] = slot
        bits = np.unpackbits(np.frombuffer(opened.answer(table), np.uint8))[:20]
        np.testing.assert_array_equal(bits, plain_answer(frames[slot], request, "cascade"))
        assert np.sum(opened._frames.places >= 0) <= 4


def test_parity_of_all_frames_stays_within_its_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Requests for all frames, in one message, are answered where there is room for three of them."""
    layout, codes = layout_of(16, 20, MATRICES[7]), coder_of("cascade").num_codes
    room = 3 * codes * 8 * layout.num_bits
    monkeypatch.setattr(buffer, "MAX_PARITY_BYTES", room)
    opened = EncoderBuffer(layout, coder_of("cascade"), 8)
    frames = [encoded_frame(layout, seed) for seed in range(8)]
    for slot, frame in enumerate(frames):
        opened.enter(slot, frame)
    everything = tuple(range(codes * layout.num_bits))
    for order in (range(8), range(7, -1, -1), [0, 1, 0, 2, 0, 3, 0, 4, 0, 5]):
        requests = [ParityRequest(n, 3, "parity", 0, 0, len(everything), everything) for n in order]
        table = RequestTable.of(requests)
        table.rows[:, SLOT] = list(order)
        bits = np.unpackbits(np.frombuffer(opened.answer(table), np.uint8))
        expected = [plain_answer(frames[request.frame], request, "cascade") for request in requests]
        np.testing.assert_array_equal(bits[: table.num_bits], np.concatenate(expected))
        assert opened._frames.parity.nbytes == room


def test_parity_of_frames_asked_for_longest_ago_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no room, it is computed again for these alone; it is not for others."""
    layout, codes = layout_of(16, 20, MATRICES[7]), coder_of("cascade").num_codes
    monkeypatch.setattr(buffer, "MAX_PARITY_BYTES", 2 * codes * 8 * layout.num_bits)
    computed: list[int] = []

    class Counting(CascadeCoder):
        def encode(self, code: int, words: NDArray[np.uint64], parity: NDArray[np.uint64]) -> None:
            computed[-1] += 1
            super().encode(code, words, parity)

    opened = EncoderBuffer(layout, Counting(CascadeConfig(), 1), 3)
    for slot in range(3):
        opened.enter(slot, encoded_frame(layout, slot))
    for slot in [0, 1, 0, 2, 0, 1, 1]:
        last = codes * layout.num_bits - 1
        table = RequestTable.of([ParityRequest(0, 3, "parity", 0, 0, 2, (0, last))])
        table.rows[:, SLOT] = slot
        computed.append(0)
        opened.answer(table)
    assert computed == [codes, codes, 0, codes, 0, codes, 0]


@pytest.mark.parametrize(
    ("refused", "text"),
    [
        (ParityRequest(0, 41, "uncoded", 0, 0, 1), "plane 41 of frame 0"),
        (ParityRequest(0, 0, "joint", 0, 0, 8, (0, 7, 41)), "plane 41 of frame 0"),
    ],
)
def test_planes_that_a_frame_lacks_are_refused(refused: ParityRequest, text: str) -> None:
    """What other frames of the layout may have, but this one has not, raises `ValueError`."""
    layout = layout_of(16, 16, None)
    opened = EncoderBuffer(layout, coder_of("cascade"), 3)
    frame = encoded_frame(layout, 0, step_index=40)
    assert 8 < frame.quantization.num_planes <= 41
    opened.enter(SLOTS[0], frame)
    with pytest.raises(ValueError, match=text):
        opened.answer(table_of([ParityRequest(0, 1, "crc", 0, 0, 8), refused]))
