"""Requests for parities of ranges, and for check bits of several planes, over the feedback channel."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import CodecConfig, TurboConfig, VideoConfig, encode_config
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback.endpoints import EncoderEndpoint
from dvc.feedback.ledger import Ledger
from dvc.feedback.messages import (
    PROTOCOL_VERSION,
    Hello,
    NextGop,
    decode_payload,
    encode_message,
    max_payload_bytes,
)
from dvc.stream import GopRecord
from dvc.turbo import ParityRequest

VIDEO = VideoConfig(176, 144, 15, 1)
CONFIG = CodecConfig.preset("2d", VIDEO, turbo=TurboConfig(family="cascade"))
TURBO = CodecConfig.preset("2d", VIDEO)
NUM_BITS = VIDEO.num_blocks
NUM_PLANES = sum(CONFIG.wyner_ziv.max_planes)


def payload_of(message: bytes) -> bytes:
    """Return the payload of an encoded message, which is less than 16,384 bytes long."""
    return message[2:] if message[1] < 0x80 else message[3:]


def opened(config: CodecConfig) -> Ledger:
    """Return the ledger of a sequence of which frame 1 is open."""
    ledger = Ledger(config)
    for number, frames in enumerate((1, 2)):
        ledger.add_credit()
        ledger.open_gop(number, frames)
    return ledger


def ranges(*positions: int, start: int = 0, order: int = 0) -> ParityRequest:
    return ParityRequest(1, 0, "parity", order, start, len(positions), positions)


@given(st.sets(st.integers(0, NUM_BITS - 1)), st.sampled_from(["parity", "joint"]))
def test_positions_survive_the_wire(positions: set[int], kind: str) -> None:
    """Any increasing positions come back, in a message no longer than one may be."""
    request = ParityRequest(2**32, 70, kind, 7, 2**20, len(positions), tuple(sorted(positions)))
    message = encode_message(request)
    payload = payload_of(message)
    assert decode_payload(ParityRequest, payload) == request
    assert len(payload) <= max_payload_bytes(ParityRequest, CONFIG)


@given(st.binary(max_size=40))
def test_any_bytes_are_a_request_or_refused(payload: bytes) -> None:
    """Whatever is read as a request has increasing positions, and is written in the same bytes."""
    try:
        request = decode_payload(ParityRequest, payload)
    except BitstreamError:
        return
    assert list(request.positions) == sorted(set(request.positions))
    assert payload_of(encode_message(request)) == payload


def test_orders_may_change_and_requests_go_on() -> None:
    """Ranges of several orders, then check bits of planes together, are entered one after the other."""
    ledger = opened(CONFIG)
    for request in (
        ranges(5, 80, NUM_BITS - 1),
        ranges(9, start=3, order=7),
        ranges(6, start=4),
        ranges(7, NUM_BITS, 6 * NUM_BITS - 1, start=5, order=2),
        ParityRequest(1, 0, "crc", 0, 0, 5),
        ParityRequest(1, 0, "joint", 0, 0, 16, (0, 3, NUM_PLANES - 1)),
        ParityRequest(1, 0, "joint", 0, 16, 6, (0, 3)),
    ):
        ledger.request(request)
        ledger.answer(1, 0, request.count)


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
        opened(CONFIG).request(request_)


@pytest.mark.parametrize("kind", ["parity", "joint"])
def test_turbo_codes_have_no_positions(kind: str) -> None:
    """Where parity has an order of release, requests by position are refused."""
    with pytest.raises(ValueError, match=r"positions of parity bits|joint bits"):
        opened(TURBO).request(ParityRequest(1, 0, kind, 0, 0, 1, (0,)))


def test_what_a_plane_may_cost_is_bounded() -> None:
    """No more parities than the plane has bits, and no more joint bits than all its planes have."""
    ledger = opened(CONFIG)
    ledger.request(ranges(*range(NUM_BITS)))
    ledger.answer(1, 0, NUM_BITS)
    with pytest.raises(ValueError, match="1 parity bits"):
        ledger.request(ranges(0, start=NUM_BITS))
    for number in range(NUM_PLANES):
        ledger.request(ParityRequest(1, 0, "joint", 0, 16 * number, 16, (0,)))
        ledger.answer(1, 0, 16)
    with pytest.raises(ValueError, match="1 joint bits"):
        ledger.request(ParityRequest(1, 0, "joint", 0, 16 * NUM_PLANES, 1, (0,)))


def test_endpoint_refuses_a_request_that_is_too_long() -> None:
    """The length is judged before the bytes come."""
    encoder = EncoderEndpoint(CONFIG)
    limit = max_payload_bytes(ParityRequest, CONFIG)
    assert limit == 26 + 2 * NUM_BITS
    assert max_payload_bytes(ParityRequest, TURBO) == 26
    too_long = b"\x04" + bytes([(limit + 1) & 0x7F | 0x80, (limit + 1) >> 7])
    with pytest.raises(FeedbackError, match="at most 3194"):
        encoder.receive(too_long)


def test_endpoint_breaks_off_at_hostile_positions() -> None:
    """A request that the ledger refuses ends the channel, as any breach does."""
    encoder = EncoderEndpoint(CONFIG)
    encoder.receive(encode_message(NextGop()) * 2)
    encoder.send_gop(GopRecord(1, b"key"))
    encoder.send_gop(GopRecord(2, b"key", b"", (b"header",)))
    assert encode_message(Hello(PROTOCOL_VERSION, encode_config(CONFIG))) in encoder.bytes_to_send()
    assert encoder.receive(encode_message(ranges(3, 9))) == [ranges(3, 9)]
    with pytest.raises(FeedbackError, match="second request"):
        encoder.receive(encode_message(ranges(3, 9)))
