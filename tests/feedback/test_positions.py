"""Requests for parities of ranges, and for check bits of several planes, over the feedback channel."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.bits import decode_varint, encode_varint
from dvc.config import CodecConfig, DiscoverMatrix, TurboConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback.endpoints import DecoderEndpoint, EncoderEndpoint
from dvc.feedback.flow_control import FlowControl
from dvc.feedback.messages import (
    ParityRequests,
    decode_payload,
    encode_message,
    max_payload_bytes,
)
from dvc.slepian_wolf import KINDS, ParityRequest, RequestTable
from dvc.stream import GopRecord

VIDEO = VideoConfig(176, 144, 15, 1)
CONFIG = codec_config(VIDEO, "2d", DiscoverMatrix(4))
TURBO = codec_config(VIDEO, "2d", DiscoverMatrix(4), coder=TurboConfig())
NUM_BITS = VIDEO.num_blocks
NUM_PLANES = sum(CONFIG.wyner_ziv.max_planes)


def payload_of(message: bytes) -> bytes:
    """Return the payload of an encoded message, which is less than 16,384 bytes long."""
    return message[2:] if message[1] < 0x80 else message[3:]


def written(*requests: ParityRequest) -> bytes:
    return encode_message(ParityRequests(RequestTable.of(requests)))


def read(payload: bytes) -> list[ParityRequest]:
    message = decode_payload(ParityRequests, payload)
    assert isinstance(message, ParityRequests)
    requests = message.table.requests()
    assert message.table.num_bits == sum(request.count for request in requests)
    return requests


def enter(flow: FlowControl, *requests: ParityRequest) -> None:
    flow.request(RequestTable.of(requests))


def opened(config: CodecConfig) -> FlowControl:
    """Return the flow of a sequence of which frame 1 is open."""
    flow = FlowControl(config)
    for number, frames in enumerate((1, 2)):
        flow.add_credit()
        flow.open_gop(number, frames)
    return flow


def ranges(*positions: int, start: int = 0, order: int = 0) -> ParityRequest:
    return ParityRequest(1, 0, "parity", order, start, len(positions), positions)


places = st.sets(st.integers(0, NUM_BITS - 1), min_size=1)
entries = st.tuples(
    st.integers(0, 2**30), st.integers(0, 300), st.sampled_from(KINDS), st.integers(0, 7), places
)


@given(st.lists(entries, min_size=1, max_size=5))
def test_requests_survive_the_wire(drawn: list[tuple[int, int, str, int, set[int]]]) -> None:
    """Any requests with any increasing positions come back, in a message no longer than one may be."""
    requests = []
    for frame, plane, kind, code, chosen in sorted(drawn, key=lambda entry: entry[0]):
        positions = tuple(sorted(chosen)) if kind in ("parity", "joint") else ()
        count = 3 if kind == "joint" else len(chosen)
        requests.append(ParityRequest(frame, plane, kind, code, 0, count, positions))
    payload = payload_of(written(*requests))
    assert read(payload) == requests
    assert len(payload) <= max_payload_bytes(ParityRequests, CONFIG)


@given(st.binary(max_size=40))
def test_any_bytes_are_requests_or_refused(payload: bytes) -> None:
    """Whatever is read as requests has increasing positions, and stays as it is when it is written again."""
    try:
        requests = read(payload)
    except BitstreamError:
        return
    for request in requests:
        assert list(request.positions) == sorted(set(request.positions))
    assert read(payload_of(written(*requests))) == requests


@given(st.binary(max_size=60))
def test_compiled_syntax_is_that_of_its_plain_twin(payload: bytes) -> None:
    """Requests and faults of any bytes are those that reading them number by number finds."""
    try:
        expected: list[ParityRequest] | None = plain_requests(payload)
    except BitstreamError:
        expected = None
    try:
        found: list[ParityRequest] | None = read(payload)
    except BitstreamError:
        found = None
    assert found == expected


def plain_requests(payload: bytes) -> list[ParityRequest]:
    at, frame, requests = 0, 0, []
    while at < len(payload):
        numbers = []
        for _ in range(4):
            value, at = decode_varint(payload, at)
            numbers.append(value)
        first, step, plane, count = numbers
        frame, num_positions = frame + step, 0
        if first & 4:
            num_positions = count
            if KINDS[first & 3] == "joint":
                num_positions, at = decode_varint(payload, at)
        positions = [-1]
        for _ in range(num_positions):
            value, at = decode_varint(payload, at)
            if value == 0:
                raise BitstreamError("standing")
            positions.append(positions[-1] + value)
        requests.append(
            ParityRequest(frame, plane, KINDS[first & 3], first >> 3, 0, count, tuple(positions[1:]))
        )
    return requests


def test_orders_may_change_and_requests_go_on() -> None:
    """Ranges of several orders, then check bits of planes together, are entered one after the other."""
    flow = opened(CONFIG)
    for request in (
        ranges(5, 80, NUM_BITS - 1),
        ranges(9, start=3, order=7),
        ranges(6, start=4),
        ranges(7, NUM_BITS, 6 * NUM_BITS - 1, start=5, order=2),
        ParityRequest(1, 0, "crc", 0, 0, 5),
        ParityRequest(1, 0, "joint", 0, 0, 16, (0, 3, NUM_PLANES - 1)),
        ParityRequest(1, 0, "joint", 0, 16, 6, (0, 3)),
    ):
        enter(flow, request)
        assert flow.answer().requests() == [request]


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (ranges(5, 5, order=7), "must increase from 0 to 1583"),
        (ranges(5, 4), "must increase"),
        (ranges(-1, 4), "must increase"),
        (ranges(3, NUM_BITS, order=7), "must increase"),
        (ranges(3, 2 * NUM_BITS, order=6), "must increase"),
        (ranges(*range(NUM_BITS + 1)), "1585 parity bits"),
        (ranges(5, order=8), "code 8"),
        (ranges(5, start=1), "number 1 on, where 0 is the next"),
        (ParityRequest(1, 0, "parity", 0, 0, 3), "3 parity bits of plane 0 of frame 1 at 0 positions"),
        (ParityRequest(1, 0, "parity", 0, 0, 3, (1, 2)), "at 2 positions"),
        (ParityRequest(1, 0, "crc", 0, 0, 1, (1,)), "positions of crc bits"),
        (ParityRequest(1, 0, "uncoded", 0, 0, 1, (1,)), "positions of uncoded bits"),
        (ParityRequest(1, 0, "joint", 0, 0, 8), "joint bits of other planes"),
        (ParityRequest(1, 0, "joint", 0, 0, 8, (1, 2)), "joint bits of other planes"),
        (ParityRequest(1, 0, "joint", 0, 0, 17, (0, 1)), "17 joint bits of plane 0 of frame 1 at once"),
        (ParityRequest(1, 0, "joint", 0, 0, 8, (0, NUM_PLANES)), "must increase"),
    ],
)
def test_hostile_positions_are_refused(request_: ParityRequest, text: str) -> None:
    """Positions that are none, too many, out of order or out of place break the protocol."""
    with pytest.raises(ValueError, match=text):
        enter(opened(CONFIG), request_)


@pytest.mark.parametrize("kind", ["parity", "joint"])
def test_turbo_codes_have_no_positions(kind: str) -> None:
    """Where parity has an order of release, requests by position are refused."""
    with pytest.raises(ValueError, match=r"positions of parity bits|joint bits"):
        enter(opened(TURBO), ParityRequest(1, 0, kind, 0, 0, 1, (0,)))


def test_what_a_plane_may_cost_is_bounded() -> None:
    """No more parities than the plane has bits, and no more joint bits than all its planes have."""
    flow = opened(CONFIG)
    enter(flow, ranges(*range(NUM_BITS)))
    flow.answer()
    with pytest.raises(ValueError, match="1 parity bits"):
        enter(flow, ranges(0, start=NUM_BITS))
    for number in range(NUM_PLANES):
        enter(flow, ParityRequest(1, 0, "joint", 0, 16 * number, 16, (0,)))
        flow.answer()
    with pytest.raises(ValueError, match="1 joint bits"):
        enter(flow, ParityRequest(1, 0, "joint", 0, 16 * NUM_PLANES, 1, (0,)))


def test_endpoint_refuses_requests_that_are_too_long() -> None:
    """The length is judged before the bytes come."""
    encoder = EncoderEndpoint(CONFIG)
    encoder.receive(DecoderEndpoint().bytes_to_send())
    limit = max_payload_bytes(ParityRequests, CONFIG)
    assert limit == 2**16 + 2 * NUM_BITS
    too_long = b"\x04" + encode_varint(limit + 1)
    with pytest.raises(FeedbackError, match=f"at most {limit}"):
        encoder.receive(too_long)


def opened_ends() -> tuple[EncoderEndpoint, DecoderEndpoint]:
    """Return both ends of a sequence of which frame 1 is open."""
    encoder, decoder = EncoderEndpoint(CONFIG), DecoderEndpoint()
    encoder.receive(decoder.bytes_to_send())
    decoder.receive(encoder.bytes_to_send())
    for record in (GopRecord(1, b"key"), GopRecord(2, b"key", False, b"", (b"header",))):
        decoder.send_next_gop()
        encoder.receive(decoder.bytes_to_send())
        encoder.send_gop(record)
        decoder.receive(encoder.bytes_to_send())
    return encoder, decoder


def test_many_positions_take_several_messages() -> None:
    """What is asked for at once is divided into messages that the encoder takes."""
    encoder, decoder = opened_ends()
    everything = tuple(range(NUM_BITS))
    requests = [ParityRequest(1, plane, "parity", 0, 0, NUM_BITS, everything) for plane in range(NUM_PLANES)]
    decoder.send_requests(requests)
    tables = [event for event in encoder.receive(decoder.bytes_to_send()) if isinstance(event, RequestTable)]
    assert len(tables) > 1
    assert [request for table in tables for request in table.requests()] == requests


def test_endpoint_breaks_off_at_hostile_positions() -> None:
    """A request that flow control refuses ends the channel, as any breach does."""
    encoder, _ = opened_ends()
    (table,) = encoder.receive(written(ranges(3, 9)))
    assert isinstance(table, RequestTable)
    assert table.requests() == [ranges(3, 9)]
    with pytest.raises(FeedbackError, match="second request"):
        encoder.receive(written(ranges(3, 9)))
