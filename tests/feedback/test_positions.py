"""Requests for runs, parities of ranges, and check bits of several runs, over the feedback channel."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.bits import decode_bytes, decode_varint, encode_varint
from dvc.config import CodecConfig, DiscoverMatrix, TurboConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError, FeedbackError
from dvc.feedback.endpoints import DecoderEndpoint, EncoderEndpoint
from dvc.feedback.flow_control import MAX_RUNS, RequestAccount
from dvc.feedback.messages import (
    ParityRequests,
    decode_payload,
    encode_message,
    max_payload_bytes,
)
from dvc.slepian_wolf import KINDS, MAX_RUN_BITS, ParityRequest, Part, RequestTable, Run
from dvc.slepian_wolf.requests import Kind
from dvc.stream import GopRecord

VIDEO = VideoConfig(176, 144, 15, 1)
CONFIG = codec_config(VIDEO, "2d", DiscoverMatrix(4), gop={"length": 4})
TURBO = codec_config(VIDEO, "2d", DiscoverMatrix(4), coder=TurboConfig())
NUM_BITS = VIDEO.num_blocks
NUM_PLANES = sum(CONFIG.wyner_ziv.max_planes)
MAX_RUN_PLANES = len(CONFIG.wyner_ziv.max_planes)
MAX_AREAS_BYTES = 64 + NUM_BITS


def payload_of(message: bytes) -> bytes:
    """Return the payload of an encoded message."""
    size, start = decode_varint(message, 1)
    assert len(message) == start + size
    return message[start:]


def written(*requests: ParityRequest) -> bytes:
    return encode_message(ParityRequests(RequestTable.of(requests)))


def read(payload: bytes) -> list[ParityRequest]:
    message = decode_payload(ParityRequests, payload)
    assert isinstance(message, ParityRequests)
    requests = message.table.requests()
    assert message.table.num_bits == sum(request.count for request in requests)
    return requests


def enter(account: RequestAccount, *requests: ParityRequest) -> None:
    account.request(RequestTable.of(requests))


def opened(config: CodecConfig, num_frames: int = 2) -> RequestAccount:
    """Return an account with frame 1 open, or more frames between it and the key frame."""
    account = RequestAccount(config)
    account.open_gop(0, 0, 0)
    account.open_gop(1, 1, num_frames - 1)
    return account


def ranges(*positions: int, start: int = 0, order: int = 0, begun: Run | None = None) -> ParityRequest:
    return ParityRequest(1, 0, "parity", order, start, len(positions), positions, begun)


def of_planes(*planes: int, areas: bytes = b"") -> Run:
    """Return a run of the frame that names it."""
    return (Part(0, planes, areas),)


def beginning(run: int, *planes: int, frame: int = 1, areas: bytes = b"") -> ParityRequest:
    """Return a request for a check bit, with which a run begins."""
    return ParityRequest(frame, run, "crc", 0, 0, 1, begun=of_planes(*planes, areas=areas))


def together(*runs: int, start: int = 0, count: int = 8) -> ParityRequest:
    """Return a request for joint check bits of runs."""
    return ParityRequest(1, runs[0], "joint", 0, start, count, runs)


places = st.sets(st.integers(0, NUM_BITS - 1), min_size=1)
numbers = st.sets(st.integers(0, 40), max_size=15).map(lambda drawn: tuple(sorted(drawn)))
descriptions = st.none() | st.dictionaries(
    st.integers(0, 2**34), st.tuples(numbers, st.binary(max_size=200)), max_size=3
)
entries = st.tuples(
    st.integers(0, 2**30),
    st.integers(0, 300),
    st.sampled_from(KINDS),
    st.integers(0, 7),
    places,
    descriptions,
)
Entry = tuple[int, int, Kind, int, set[int], dict[int, tuple[tuple[int, ...], bytes]] | None]


@given(st.lists(entries, min_size=1, max_size=5))
def test_requests_survive_the_wire(drawn: list[Entry]) -> None:
    requests = []
    for frame, run, kind, code, chosen, described in sorted(drawn, key=lambda entry: entry[0]):
        positions = tuple(sorted(chosen)) if kind in ("parity", "joint") else ()
        count = 3 if kind == "joint" else len(chosen)
        begun = None
        if described is not None:
            begun = tuple(Part(offset, *described[offset]) for offset in sorted(described))
        requests.append(ParityRequest(frame, run, kind, code, 0, count, positions, begun))
    payload = payload_of(written(*requests))
    assert read(payload) == plain_requests(payload) == requests
    assert len(payload) <= max_payload_bytes(ParityRequests, CONFIG)


payloads = st.binary(max_size=60) | st.lists(st.integers(0, 15), max_size=60).map(bytes)


@given(payloads)
def test_any_bytes_are_requests_or_refused(payload: bytes) -> None:
    try:
        expected = plain_requests(payload)
    except BitstreamError:
        with pytest.raises(BitstreamError):
            read(payload)
        return
    requests = read(payload)
    assert requests == expected
    for request in requests:
        assert list(request.positions) == sorted(set(request.positions))
        offsets = [part.offset for part in request.begun or ()]
        assert offsets == sorted(set(offsets))
        for part in request.begun or ():
            assert list(part.planes) == sorted(set(part.planes))
            assert part.offset >= 0
    assert read(payload_of(written(*requests))) == requests


def plain_requests(payload: bytes) -> list[ParityRequest]:
    at, frame, requests = 0, 0, []
    while at < len(payload):
        numbers = []
        for _ in range(4):
            value, at = decode_varint(payload, at)
            numbers.append(value)
        first, step, run, count = numbers
        frame, num_positions, kind = frame + step, 0, KINDS[first % 4]
        if first & 4:
            num_positions = count
            if kind == "joint":
                num_positions, at = decode_varint(payload, at)
        positions, at = plain_increasing(payload, at, num_positions, -1)
        begun = None
        if first & 8:
            begun, at = plain_run(payload, at)
        requests.append(ParityRequest(frame, run, kind, first // 16, 0, count, positions, begun))
    return requests


def plain_run(payload: bytes, at: int) -> tuple[Run, int]:
    num_parts, at = decode_varint(payload, at)
    parts, offset = [], -1
    for _ in range(num_parts):
        (offset,), at = plain_increasing(payload, at, 1, offset)
        num_planes, at = decode_varint(payload, at)
        planes, at = plain_increasing(payload, at, num_planes, -1)
        areas, at = decode_bytes(payload, at)
        parts.append(Part(offset, planes, areas))
    return tuple(parts), at


def plain_increasing(payload: bytes, at: int, count: int, before: int) -> tuple[tuple[int, ...], int]:
    numbers = [before]
    for _ in range(count):
        step, at = decode_varint(payload, at)
        if step == 0:
            raise BitstreamError("standing")
        numbers.append(numbers[-1] + step)
    return tuple(numbers[1:]), at


FIRST = of_planes(0)


def test_orders_may_change_and_requests_go_on() -> None:
    """Ranges of several orders, then check bits of runs together, are entered one after the other."""
    account = opened(CONFIG)
    for request in (
        ranges(5, 80, NUM_BITS - 1, begun=FIRST),
        ranges(9, start=3, order=7),
        ranges(6, start=4),
        ranges(7, NUM_BITS, 6 * NUM_BITS - 1, start=5, order=2),
        ParityRequest(1, 0, "crc", 0, 0, 5),
        beginning(1, 3, 5),
        beginning(2, NUM_PLANES - 1),
        together(0, 1, 2, count=16),
        together(0, 1, start=16, count=6),
        together(1, 2),
    ):
        enter(account, request)
        assert account.answer().requests() == [request]


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (ranges(5, 5, order=7), "positions must increase and lie within"),
        (ranges(5, 4), "positions must increase and lie within"),
        (ranges(-1, 4), "positions must increase and lie within"),
        (ranges(3, NUM_BITS, order=7), "positions must increase and lie within"),
        (ranges(3, 2 * NUM_BITS, order=6), "positions must increase and lie within"),
        (ranges(3, 2 * NUM_BITS, order=7, begun=of_planes(1, 9)), "positions must increase and lie within"),
        (ranges(*range(NUM_BITS + 1)), "1585 parity bits"),
        (ranges(*range(2 * NUM_BITS + 1), begun=of_planes(1, 9)), "3169 parity bits"),
        (ranges(5, order=8), "no such code"),
        (
            ParityRequest(1, 0, "parity", 0, 0, 3),
            "3 parity bits of run 0 of frame 1: as many positions as bits",
        ),
        (ParityRequest(1, 0, "parity", 0, 0, 3, (1, 2)), "as many positions as bits"),
        (ParityRequest(1, 0, "crc", 0, 1, 1, (1,)), "1 crc bits .*: this kind has no positions"),
        (ParityRequest(1, 0, "uncoded", 0, 0, 1, (1,)), "1 uncoded bits .*: this kind has no positions"),
        (ParityRequest(1, 0, "joint", 0, 0, 8), "first run of joint bits must be its own"),
        (replace(together(1, 2), run=0), "first run of joint bits must be its own"),
        (together(0, 1, count=17), "too many joint bits at once"),
        (together(0, MAX_RUNS), "positions must increase and lie within"),
        (together(0, 1, 1), "positions must increase and lie within"),
    ],
)
def test_hostile_positions_are_refused(request_: ParityRequest, text: str) -> None:
    account = opened(CONFIG)
    enter(account, beginning(0, 0), beginning(1, 3))
    account.answer()
    with pytest.raises(ValueError, match=text):
        enter(account, replace(request_, run=2) if request_.begun else request_)


@pytest.mark.parametrize("kind", ["parity", "joint"])
def test_turbo_codes_have_no_positions(kind: Kind) -> None:
    with pytest.raises(ValueError, match=r"no positions|joint bits"):
        enter(opened(TURBO), ParityRequest(1, 0, kind, 0, 0, 1, (0,), FIRST))


@pytest.mark.parametrize("planes", [(0,), (0, 7, NUM_PLANES - 1)])
def test_what_a_run_may_cost_is_bounded(planes: tuple[int, ...]) -> None:
    """No more parities or uncoded bits than its planes have, nor joint bits than all runs of the frame."""
    account, num_bits = opened(CONFIG), len(planes) * NUM_BITS
    for request in (
        ranges(*range(num_bits - 5), begun=of_planes(*planes)),
        ranges(*range(5), start=num_bits - 5),
        ParityRequest(1, 0, "uncoded", 0, 0, num_bits),
        ParityRequest(1, 0, "crc", 0, 0, 16),
    ):
        enter(account, request)
        account.answer()
    for refused, text in (
        (ranges(0, start=num_bits), "1 parity bits"),
        (ParityRequest(1, 0, "uncoded", 0, num_bits, 1), "1 uncoded bits"),
        (ParityRequest(1, 0, "crc", 0, 16, 1), "1 crc bits"),
    ):
        with pytest.raises(ValueError, match=text):
            enter(account, refused)
    for number in range(MAX_RUNS):
        enter(account, together(0, start=16 * number, count=16))
        account.answer()
    with pytest.raises(ValueError, match="1 joint bits"):
        enter(account, together(0, start=16 * MAX_RUNS, count=1))


@pytest.mark.parametrize(
    ("before", "requests"),
    [
        ([], [together(0, 1)]),
        ([], [together(3)]),
        ([beginning(0, 0)], [together(0, 1)]),
        ([beginning(0, 0)], [together(1)]),
        ([beginning(0, 0, 3)], [together(0, 3)]),
        ([beginning(0, 0), beginning(1, 3, 5)], [together(0, 1, 2)]),
        ([beginning(0, 0), beginning(0, 3, frame=2)], [together(0, 1)]),
        ([], [replace(together(0, 3), begun=of_planes(0, 3))]),
        ([], [replace(together(0, 1), begun=FIRST), beginning(1, 3)]),
        ([beginning(0, 0)], [together(0, 1), beginning(1, 3)]),
    ],
)
def test_joint_bits_are_of_runs_that_have_begun(
    before: list[ParityRequest], requests: list[ParityRequest]
) -> None:
    """A request for check bits of several runs does not go ahead of the first request for one of them."""
    account = opened(CONFIG, 3)
    if before:
        enter(account, *before)
        account.answer()
    with pytest.raises(
        ValueError, match=r"joint bits of run \d of frame 1: this run, or another one that it names, has not"
    ):
        enter(account, *requests)


def test_a_run_may_begin_in_the_same_message() -> None:
    """Joint check bits may be asked for right behind the first request for another run, or as the first."""
    account = opened(CONFIG)
    requests = [beginning(0, 3, 5), ParityRequest(1, 1, "joint", 0, 0, 8, (1,), FIRST)]
    enter(account, *requests)
    assert account.answer().requests() == requests
    requests = [beginning(2, 7), together(0, 1, 2)]
    enter(account, *requests)
    assert account.answer().requests() == requests


@pytest.mark.parametrize("number", [-1, 0, 1, 3, MAX_RUNS, 2**34])
@pytest.mark.parametrize("begun", [FIRST, of_planes(0, 1), of_planes(1, 2), (Part(1, (0,)),)])
def test_runs_begin_in_turn(number: int, begun: Run) -> None:
    """A number that was given to a run, or is not the next, begins none; the next one does."""
    account = opened(CONFIG, 3)
    enter(account, beginning(0, 20, 23), beginning(1, 21))
    account.answer()
    with pytest.raises(ValueError, match=f"run {number} of frame 1 begins, expected 2 of at most 256"):
        enter(account, ParityRequest(1, number, "crc", 0, 1, 1, begun=begun))
    enter(account, ParityRequest(1, 2, "crc", 0, 0, 1, begun=begun))


def test_a_frame_names_so_many_runs_and_no_more() -> None:
    config = codec_config(VIDEO, "2d", gop={"length": 4})
    account, num_planes = opened(config, 4), sum(config.wyner_ziv.max_planes)
    planes = [divmod(number, num_planes) for number in range(2 * MAX_RUNS)]
    for frame, own in ((1, planes[:MAX_RUNS]), (2, planes[MAX_RUNS:])):
        runs = enumerate((Part(offset + 1 - frame, (plane,)),) for offset, plane in own)
        enter(account, *(ParityRequest(frame, number, "crc", 0, 0, 1, (), run) for number, run in runs))
        account.answer()
    for frame in (1, 2):
        with pytest.raises(ValueError, match=f"run 256 of frame {frame} begins, expected 256 of at most 256"):
            enter(account, beginning(MAX_RUNS, 0, frame=frame))
    last = ParityRequest(1, MAX_RUNS - 1, "joint", 0, 0, 16, (MAX_RUNS - 1,))
    enter(account, last)
    assert account.answer().requests() == [last]


@pytest.mark.parametrize(
    ("begun", "offsets"),
    [
        ((), r"\[\]"),
        ((Part(-1, (0,)), Part(0, (0,))), r"\[-1, 0\]"),
        ((Part(3, (0,)),), r"\[3\]"),
        ((Part(0, (0,)), Part(3, (0,))), r"\[0, 3\]"),
        ((Part(0, (0,)), Part(2**34, (0,))), rf"\[0, {2**34}\]"),
        ((Part(0, (0,)), Part(0, (1,))), r"\[0, 0\]"),
        ((Part(1, (0,)), Part(0, (0,))), r"\[1, 0\]"),
    ],
)
def test_parts_are_of_frames_of_the_group_in_order(begun: Run, offsets: str) -> None:
    """Key frames have no bits, nor have frames of other groups; a run has some of one frame at least."""
    account = opened(CONFIG, 4)
    with pytest.raises(ValueError, match=f"run 0 of frame 1 has frames at the offsets {offsets}"):
        enter(account, ParityRequest(1, 0, "crc", 0, 0, 1, begun=begun))
    everything = tuple(Part(offset, (0,)) for offset in range(3))
    enter(account, ParityRequest(1, 0, "uncoded", 0, 0, 3 * NUM_BITS, begun=everything))
    with pytest.raises(ValueError, match=r"run 0 of frame 2 has frames at the offsets \[0, 1, 2\]"):
        enter(account, ParityRequest(2, 0, "crc", 0, 0, 1, begun=everything))


@pytest.mark.parametrize("more", [Part(0, (3,)), Part(0, (1, 2, 3)), Part(1, (5, 9)), Part(1, (0, 9))])
def test_a_plane_is_in_one_run(more: Part) -> None:
    """Whichever frame names that; what an encoder has to keep of runs is bounded by the planes."""
    account = opened(CONFIG, 3)
    enter(account, ParityRequest(1, 0, "crc", 0, 0, 1, (), (Part(0, (2, 3)), Part(1, (0, 9)))))
    account.answer()
    again = [ParityRequest(1, 1, "crc", 0, 0, 1, (), (more,))]
    if more.offset:
        again.append(ParityRequest(2, 0, "crc", 0, 0, 1, (), (more._replace(offset=0),)))
    for request in again:
        with pytest.raises(ValueError, match="some already in another run"):
            enter(account, request)
    enter(account, ParityRequest(1, 1, "crc", 0, 0, 1, (), (Part(0, (0, 9)), Part(1, (2, 3)))))


def test_bits_of_a_run_are_those_of_all_its_frames() -> None:
    account, begun = opened(CONFIG, 4), (Part(0, (0, 5)), Part(2, (1,)))
    enter(account, ParityRequest(1, 0, "uncoded", 0, 0, 3 * NUM_BITS, begun=begun))
    account.answer()
    for refused, text in (
        (ParityRequest(1, 0, "uncoded", 0, 3 * NUM_BITS, 1), "1 uncoded bits"),
        (ranges(8 * 3 * NUM_BITS), "positions must increase and lie within"),
    ):
        with pytest.raises(ValueError, match=text):
            enter(account, refused)
    large = VideoConfig(1920, 1080, 25, 1)
    account = opened(replace(CONFIG, video=large), 4)
    most = tuple(Part(offset, (*range(16),)) for offset in range(3))
    assert 3 * 16 * large.num_blocks > MAX_RUN_BITS
    enter(account, ParityRequest(1, 0, "uncoded", 0, 0, MAX_RUN_BITS, begun=most))
    account.answer()
    with pytest.raises(ValueError, match="1 uncoded bits of run 0 of frame 1: the run does not have"):
        enter(account, ParityRequest(1, 0, "uncoded", 0, MAX_RUN_BITS, 1))
    with pytest.raises(ValueError, match="positions must increase and lie within"):
        enter(account, ranges(8 * MAX_RUN_BITS))


def test_runs_end_with_their_group_of_pictures() -> None:
    """Where another group is held later, all its runs must be told again, from the first number on."""
    account = opened(CONFIG)
    enter(account, beginning(0, 0, 3))
    account.answer()
    account.close_gop(1)
    assert account.open_gop(2, 3, 1) == CONFIG.gop.length
    with pytest.raises(ValueError, match="run 0 of frame 3: this run, or another"):
        enter(account, replace(beginning(0, 0, frame=3), begun=None))
    enter(account, beginning(0, 0, 1, frame=3), beginning(1, 3, frame=3))
    account = opened(CONFIG, 3)  # a run that one frame names is no run of another
    both = ParityRequest(1, 0, "crc", 0, 0, 1, begun=(Part(0, (0,)), Part(1, (0,))))
    enter(account, both, beginning(1, 3), beginning(0, 4, frame=2))
    assert len(account.answer().runs) == 3
    with pytest.raises(ValueError, match="run 1 of frame 2: this run, or another"):
        enter(account, replace(beginning(1, 3, frame=2), begun=None))


def test_endpoint_refuses_requests_that_are_too_long() -> None:
    encoder = EncoderEndpoint(CONFIG)
    encoder.receive(DecoderEndpoint(bytes(16)).bytes_to_send())
    encoder.send_welcome()
    limit = max_payload_bytes(ParityRequests, CONFIG)
    assert limit == 2**16 + 2 * 4 * MAX_RUN_PLANES * NUM_BITS
    largest = max_payload_bytes(ParityRequests, replace(CONFIG, video=VideoConfig(1920, 1080, 25, 1)))
    assert largest == 2**16 + 2 * MAX_RUN_BITS
    too_long = b"\x05" + encode_varint(limit + 1)
    with pytest.raises(FeedbackError, match=f"at most {limit}"):
        encoder.receive(too_long)


def opened_ends(num_frames: int = 2) -> tuple[EncoderEndpoint, DecoderEndpoint]:
    """Return both ends of a sequence of which frame 1 is open, or more between it and the key frame."""
    encoder, decoder = EncoderEndpoint(CONFIG), DecoderEndpoint(bytes(16))
    encoder.receive(decoder.bytes_to_send())
    encoder.send_welcome()
    decoder.receive(encoder.bytes_to_send())
    headers = (b"header",) * (num_frames - 1)
    for record in (GopRecord(1, b"key"), GopRecord(num_frames, b"key", False, b"", headers)):
        decoder.send_next_gop()
        encoder.receive(decoder.bytes_to_send())
        encoder.send_gop(record)
        decoder.receive(encoder.bytes_to_send())
    return encoder, decoder


@pytest.mark.parametrize("kind", ["positions", "areas"])
def test_many_numbers_take_several_messages(kind: str) -> None:
    """Requests are divided into messages that the encoder takes; areas of runs count as positions do."""
    areas = [
        beginning(plane, plane, frame=frame, areas=bytes([plane]) * MAX_AREAS_BYTES)
        for frame in range(1, 4)
        for plane in range(NUM_PLANES)
    ]
    everything = tuple(range(NUM_BITS))
    positions = [
        ParityRequest(1, plane, "parity", 0, 0, NUM_BITS, everything, of_planes(plane))
        for plane in range(NUM_PLANES)
    ]
    requests = areas if kind == "areas" else positions
    encoder, decoder = opened_ends(4)
    decoder.send_requests(requests)
    tables = [event for event in encoder.receive(decoder.bytes_to_send()) if isinstance(event, RequestTable)]
    assert len(tables) > 1
    assert [request for table in tables for request in table.requests()] == requests


def test_the_largest_request_fits() -> None:
    """All bits of the largest run, at positions that take the most bytes, go in one message."""
    encoder, decoder = opened_ends(4)
    num_bits = 3 * MAX_RUN_PLANES * NUM_BITS
    num_wide = 7 * num_bits // 127
    positions = [*range(0, 128 * num_wide, 128)]
    positions += range(8 * num_bits - (num_bits - num_wide), 8 * num_bits)
    planes = 0, *range(NUM_PLANES - MAX_RUN_PLANES + 1, NUM_PLANES)
    begun = tuple(Part(offset, planes, bytes(MAX_AREAS_BYTES)) for offset in range(3))
    request = ranges(*positions, begun=begun)
    assert request.count == num_bits
    decoder.send_requests([request])
    (table,) = encoder.receive(decoder.bytes_to_send())
    assert isinstance(table, RequestTable)
    assert table.requests() == [request]


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (Part(1, (*range(MAX_RUN_PLANES + 1),)), f"has {MAX_RUN_PLANES + 1} planes, areas of 0 bytes"),
        (Part(1, ()), "has 0 planes, areas of 0 bytes"),
        (Part(1, (0,), bytes(MAX_AREAS_BYTES + 1)), f"areas of {MAX_AREAS_BYTES + 1} bytes"),
        (Part(1, (0, NUM_PLANES)), rf"\] of {NUM_PLANES}"),
        (Part(1, (2**34,)), rf"\] of {NUM_PLANES}"),
        (Part(2, (0,)), r"has frames at the offsets \[0, 2\]"),
        (Part(2**34, (0,)), rf"has frames at the offsets \[0, {2**34}\]"),
    ],
)
def test_encoder_refuses_runs_that_cannot_be(wrong: Part, text: str) -> None:
    encoder, _ = opened_ends(3)
    request = ranges(3, begun=(*FIRST, wrong))
    with pytest.raises(FeedbackError, match=f"run 0 of frame 1 .*{text}"):
        encoder.receive(written(request))
    encoder, _ = opened_ends()
    begun = tuple(Part(offset, (0,)) for offset in range(40000))  # read in time
    with pytest.raises(FeedbackError, match="run 0 of frame 1 has frames"):
        encoder.receive(written(ranges(3, begun=begun)))
