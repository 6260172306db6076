"""The two ends of the feedback channel, connected in memory."""

import re
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.config import DiscoverMatrix, TurboConfig, VideoConfig, codec_config, encode_config
from dvc.errors import FeedbackError
from dvc.feedback import (
    MAX_OPEN_GOPS,
    DecoderEndpoint,
    EncoderEndpoint,
    Event,
    Failure,
    Gop,
    GopDone,
    Hello,
    ParityAnswer,
)
from dvc.feedback.messages import (
    PROTOCOL_VERSION,
    TYPES,
    End,
    Finished,
    Message,
    NextGop,
    ParityAnswers,
    ParityRequests,
    Welcome,
    encode_message,
    max_payload_bytes,
)
from dvc.slepian_wolf import ParityRequest, Part, RequestTable, Run
from dvc.slepian_wolf.requests import Kind
from dvc.stream import GopRecord

CONFIG = codec_config(
    VideoConfig(176, 144, 15, 1),
    "2d",
    DiscoverMatrix(4),
    gop={"length": 4},
    key={"intra_period": 16},
    coder=TurboConfig(),
)
ID = bytes(range(16))
NUM_BITS = 1584
NUM_CRC_BITS = 16
MAX_AREAS_BYTES = 64 + NUM_BITS
SEVERAL: Run = (Part(0, (0, 3, 11), b"some areas"),)
RECORDS = [
    GopRecord(1, b"first key"),
    GopRecord(4, b"key" * 100, True, b"", (b"header 1", b"", b"header 3")),
    GopRecord(2, b"another key", False, b"tracks", (b"header 5",)),
    GopRecord(3, b"last key", True, b"", (b"header 7", b"header 8")),
]


ALL_BITS = np.random.default_rng(1).integers(0, 2, (12, 30, 3 * NUM_BITS), np.uint8)


def run_bits(frame: int, run: int, start: int, count: int) -> NDArray[np.uint8]:
    """Return bits of a run that both ends know."""
    return ALL_BITS[frame, run, start : start + count]


def answers(table: RequestTable) -> bytes:
    """Return the bits that requests ask for."""
    bits = [run_bits(one.frame, one.run, one.start, one.count) for one in table.requests()]
    return np.packbits(np.concatenate(bits)).tobytes()


def of_planes(*planes: int, areas: bytes = b"") -> Run:
    """Return a run of the frame that names it."""
    return (Part(0, planes, areas),)


def first(frame: int, run: int, kind: Kind, code: int, start: int, count: int) -> ParityRequest:
    """Return the first request for a run of the plane of its number."""
    return ParityRequest(frame, run, kind, code, start, count, begun=of_planes(run))


def asking(*requests: ParityRequest) -> ParityRequests:
    """Return a message of requests."""
    return ParityRequests(RequestTable.of(requests))


def asked(events: list[Event]) -> list[ParityRequest]:
    """Return the requests among events."""
    return [one for event in events if isinstance(event, RequestTable) for one in event.requests()]


@dataclass
class Encoder:
    """An encoder that sends `RECORDS` as it is asked to, and answers at once."""

    endpoint: EncoderEndpoint = field(default_factory=lambda: EncoderEndpoint(CONFIG))
    records: deque[GopRecord] = field(default_factory=lambda: deque(RECORDS))

    def react(self, data: bytes) -> None:
        for event in self.endpoint.receive(data):
            match event:
                case Hello():
                    self.endpoint.send_welcome()
                case RequestTable():
                    self.endpoint.send_answers(answers(event))
                case NextGop() if self.records:
                    self.endpoint.send_gop(self.records.popleft())
                    if not self.records:
                        self.endpoint.send_end()


@dataclass
class Decoder:
    """A decoder that keeps two GOPs open and decodes two runs of all their frames at once."""

    endpoint: DecoderEndpoint = field(default_factory=lambda: DecoderEndpoint(ID))
    runs: dict[tuple[int, int], Iterator[ParityRequest]] = field(default_factory=dict)
    gops: dict[int, set[tuple[int, int]]] = field(default_factory=dict)
    records: list[GopRecord] = field(default_factory=list)
    bits: dict[tuple[int, int], list[NDArray[np.uint8]]] = field(default_factory=dict)
    num_frames: int | None = None

    @staticmethod
    def requests(frame: int, run: int) -> Iterator[ParityRequest]:
        if run == 0:
            yield ParityRequest(frame, run, "crc", 0, 0, 8, begun=SEVERAL)
            yield ParityRequest(frame, run, "parity", 0, 0, 300)
            yield ParityRequest(frame, run, "parity", 0, 300, 3 * NUM_BITS - 300)
            yield ParityRequest(frame, run, "crc", 0, 8, NUM_CRC_BITS - 8)
        else:
            yield first(frame, run, "uncoded", 0, 0, NUM_BITS)

    def react(self, data: bytes) -> None:
        requests: list[ParityRequest] = []
        for event in self.endpoint.receive(data):
            match event:
                case Welcome():
                    if self.endpoint.config != CONFIG:
                        raise FeedbackError("these requests fit one configuration only")
                    self.endpoint.send_next_gop()
                    self.endpoint.send_next_gop()
                case Gop(number, record):
                    first = sum(record.num_frames for record in self.records)
                    self.records.append(record)
                    self.gops[number] = {(first + n, k) for n in range(record.num_frames - 1) for k in (0, 1)}
                    for key in sorted(self.gops[number]):
                        self.runs[key] = self.requests(*key)
                        requests.append(next(self.runs[key]))
                case ParityAnswer(frame, run, bits):
                    self.bits.setdefault((frame, run), []).append(bits)
                    following = next(self.runs[frame, run], None)
                    if following is not None:
                        requests.append(following)
                    else:
                        del self.runs[frame, run]
                case End(num_frames):
                    self.num_frames = num_frames
            self.close_gops()
        self.endpoint.send_requests(requests)

    def close_gops(self) -> None:
        for number, runs in list(self.gops.items()):
            if not runs & self.runs.keys():
                del self.gops[number]
                self.endpoint.send_gop_done(number)
                self.endpoint.send_next_gop()


def cut(data: bytes, size: int) -> Iterator[bytes]:
    """Yield bytes in pieces."""
    for start in range(0, len(data), size):
        yield data[start : start + size]


def run(encoder: Encoder, decoder: Decoder, to_decoder: int = 10**6, to_encoder: int = 10**6) -> None:
    """Let two ends talk in pieces of so many bytes until both are silent."""
    while (down := encoder.endpoint.bytes_to_send()) + (up := decoder.endpoint.bytes_to_send()):
        for piece in cut(down, to_decoder):
            decoder.react(piece)
        for piece in cut(up, to_encoder):
            encoder.react(piece)


def greeted() -> tuple[EncoderEndpoint, DecoderEndpoint]:
    """Return two ends that have said hello."""
    encoder, decoder = EncoderEndpoint(CONFIG), DecoderEndpoint(ID)
    assert encoder.receive(decoder.bytes_to_send()) == [Hello(PROTOCOL_VERSION, ID)]
    encoder.send_welcome()
    assert decoder.receive(encoder.bytes_to_send()) == [Welcome(PROTOCOL_VERSION, encode_config(CONFIG))]
    return encoder, decoder


def opened(num_gops: int = 2) -> tuple[EncoderEndpoint, DecoderEndpoint]:
    """Return two ends with some GOPs open, and a credit left."""
    encoder, decoder = greeted()
    open_gops(encoder, decoder, num_gops)
    return encoder, decoder


def open_gops(encoder: EncoderEndpoint, decoder: DecoderEndpoint, num_gops: int) -> None:
    """Send some GOPs, and give a credit for another."""
    for record in RECORDS[:num_gops]:
        decoder.send_next_gop()
        encoder.receive(decoder.bytes_to_send())
        encoder.send_gop(record)
        decoder.receive(encoder.bytes_to_send())
    decoder.send_next_gop()
    encoder.receive(decoder.bytes_to_send())


@settings(max_examples=25)
@given(st.integers(1, 400), st.integers(1, 50))
def test_a_sequence_goes_through_in_pieces_of_any_size(to_decoder: int, to_encoder: int) -> None:
    """All groups of pictures and all bits arrive, byte by byte as well as in bulk, and both ends finish."""
    encoder, decoder = Encoder(), Decoder()
    run(encoder, decoder, to_decoder, to_encoder)
    assert encoder.endpoint.finished
    assert decoder.endpoint.finished
    assert decoder.endpoint.config == CONFIG
    assert decoder.records == RECORDS
    assert decoder.num_frames == 10
    assert set(decoder.bits) == {(frame, run) for frame in (1, 2, 3, 5, 7, 8) for run in (0, 1)}
    for key, parts in decoder.bits.items():
        expected = [run_bits(*key, request.start, request.count) for request in Decoder.requests(*key)]
        assert all(np.array_equal(part, bits) for part, bits in zip(parts, expected, strict=True))


def test_empty_sequence() -> None:
    encoder, decoder = greeted()
    encoder.send_end()
    assert decoder.receive(encoder.bytes_to_send()) == [End(0)]
    finish(encoder, decoder)
    assert encoder.bytes_to_send() == b""


def finish(encoder: EncoderEndpoint, decoder: DecoderEndpoint) -> None:
    """Exchange the last messages."""
    assert encoder.receive(decoder.bytes_to_send()) == []
    assert encoder.finished
    assert decoder.receive(encoder.bytes_to_send()) == []
    assert decoder.finished


def test_a_decoder_continues_after_the_groups_that_it_names() -> None:
    encoder, decoder = EncoderEndpoint(CONFIG), DecoderEndpoint(ID, 2, 5, b"token")
    assert encoder.receive(decoder.bytes_to_send()) == [Hello(PROTOCOL_VERSION, ID, 2, b"token")]
    encoder.send_welcome(first_frame=5)
    decoder.receive(encoder.bytes_to_send())
    decoder.send_next_gop()
    encoder.receive(decoder.bytes_to_send())
    assert encoder.send_gop(RECORDS[2])[0] == 2
    encoder.send_end()
    assert decoder.receive(encoder.bytes_to_send()) == [Gop(2, RECORDS[2]), End(7)]
    request = first(5, 0, "crc", 0, 0, 8)
    decoder.send_requests([request])
    (table,) = encoder.receive(decoder.bytes_to_send())
    assert asked([table]) == [request]
    encoder.send_answers(answers(table))
    decoder.receive(encoder.bytes_to_send())
    decoder.send_gop_done(2)
    assert encoder.receive(decoder.bytes_to_send()) == [GopDone(2)]
    decoder.receive(encoder.bytes_to_send())
    assert encoder.finished
    assert decoder.finished


def test_failure_is_told_in_one_line() -> None:
    """The peer's reason comes as an error, cleaned and cut; nothing is received thereafter."""
    encoder, decoder = opened()
    decoder.send_failure("disk\nfull\x1b[31m" + "x" * 10000)
    with pytest.raises(FeedbackError, match="the other side ended the run: disk full") as caught:
        encoder.receive(decoder.bytes_to_send())
    assert len(str(caught.value)) < 600
    assert str(caught.value).isprintable()
    with pytest.raises(FeedbackError, match="failed before"):
        encoder.receive(b"")


REQUEST = first(1, 0, "parity", 0, 0, 100)
MORE = ParityRequest(1, 0, "crc", 0, 0, 8)
FETCHED = [first(2, run, "uncoded", 0, 0, NUM_BITS) for run in range(30)]


def beginning(*planes: int, kind: Kind = "parity", count: int = 9) -> ParityRequest:
    """Return the first request for a run of frame 1."""
    return ParityRequest(1, 0, kind, 0, 0, count, begun=of_planes(*planes))


TO_ENCODER: list[tuple[list[Message], str]] = [
    ([asking(first(0, 0, "parity", 0, 0, 9))], "of frame 0: the frame is not a Wyner-Ziv frame"),
    ([asking(first(4, 0, "parity", 0, 0, 9))], "of frame 4: the frame is not a Wyner-Ziv frame"),
    ([asking(first(1, 0, "parity", 1, 0, 9))], "9 parity bits of run 0 of frame 1: no such code"),
    ([asking(first(1, 0, "parity", 0, 0, 0))], "0 parity bits"),
    ([asking(beginning(0, 7, 9, count=3 * NUM_BITS + 1))], "4753 parity bits"),
    ([asking(REQUEST), asking(MORE)], "run 0 of frame 1: the previous request"),
    ([asking(REQUEST, MORE)], "run 0 of frame 1: the previous request"),
    ([asking(MORE)], "crc bits of run 0 of frame 1: this run, or another"),
    ([asking(beginning(0)), asking(replace(MORE, run=256))], "run 256 of frame 1: this run, or another"),
    ([asking(beginning(*range(10**4)))], "has 10000 planes"),
    ([asking(first(1, 0, "crc", 0, 0, 2**30))], f"{2**30} bits requested at once"),
    ([ParityRequests(RequestTable.of(()))], "0 bits requested at once"),
    ([GopDone(0), asking(REQUEST), GopDone(1)], "done before all its requests"),
    ([GopDone(0), GopDone(0)], "group of pictures 0 is not open"),
    ([GopDone(2)], "group of pictures 2 is not open"),
    ([GopDone(1)], "group of pictures 1 is done before group 0"),
    ([Finished()], "Finished before all groups of pictures are done"),
    ([Welcome(1, b"")], "unexpected Welcome"),
    ([GopDone(0), GopDone(1), asking(REQUEST)], "of frame 1: the frame is not a Wyner-Ziv"),
    ([NextGop()] * MAX_OPEN_GOPS, "more than 32 groups of pictures"),
    ([Hello(1)], "unexpected Hello"),
    ([End(3)], "unexpected End"),
    ([ParityAnswers(bytes(3))], "unexpected ParityAnswers"),
    ([Gop(2, RECORDS[2])], "unexpected Gop"),
]
TO_DECODER: list[tuple[list[Message], str]] = [
    ([Hello(1, ID)], "unexpected Hello"),
    ([Welcome(1, encode_config(CONFIG))], "unexpected Welcome"),
    ([Finished()], "Finished before all groups of pictures are done"),
    ([NextGop()], "unexpected NextGop"),
    ([asking(REQUEST)], "unexpected ParityRequests"),
    ([ParityAnswers(bytes(2))], "2 bytes of bits, asked for 8 bits"),
    ([ParityAnswers(b"")], "0 bytes of bits, asked for 8 bits"),
    ([ParityAnswers(bytes(1))] * 2, "that were not requested"),
    ([Gop(3, RECORDS[2])], "group of pictures 3, expected 2"),
    ([Gop(2, RECORDS[2]), Gop(3, RECORDS[3])], "that was not asked for"),
    ([Gop(2, GopRecord(5, b"", False, b"", (b"",) * 4))], "5 frames in group of pictures 2, at most 4"),
    ([End(7)], "end after 7 frames, but 5 were sent"),
    ([End(5), End(5)], "a second end"),
    ([End(5), Gop(2, RECORDS[2])], "a group of pictures after the end"),
]


@pytest.mark.parametrize(
    ("end", "messages", "text"),
    [*(("encoder", *case) for case in TO_ENCODER), *(("decoder", *case) for case in TO_DECODER)],
)
def test_breaches_of_the_protocol_are_refused(end: str, messages: list[Message], text: str) -> None:
    encoder, decoder = opened()
    decoder.send_requests([first(2, 0, "crc", 0, 0, 8)])
    endpoint = encoder if end == "encoder" else decoder
    with pytest.raises(FeedbackError, match=text) as caught:
        endpoint.receive(b"".join(encode_message(message) for message in messages))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("end", "data", "text"),
    [
        ("new encoder", b"GET / HTTP/1.1\r\n", "unknown message of type 71"),
        ("new encoder", b"\x16\x03\x01\x02\x00", "it uses TLS, which this side does not"),
        ("new encoder", b"\x0b\x00", "unknown message of type 11"),
        ("new encoder", encode_message(NextGop()), "unexpected NextGop"),
        ("new encoder", encode_message(Failure("")), "unexpected Failure"),
        ("new encoder", b"\x01\x01\x05", "protocol version 5; this program speaks version 11"),
        ("new encoder", b"\x01\x02\x0b\x00", "Hello: data end"),
        ("new encoder", b"\x01\xff\xff\x7f", "at most 4128 are allowed"),
        ("new decoder", b"\x04\x00", "unexpected Gop"),
        ("new decoder", b"\x15\x03\x03\x00\x02", "it uses TLS"),
        ("new decoder", b"\x00", "unknown message of type 0"),
        ("new decoder", b"\x0b", "unknown message of type 11"),
        ("new decoder", b"GET / HTTP/1.1\r\n", "unknown message of type 71"),
        ("new decoder", b"\x02\x81\x20", "Welcome of 4097 bytes, at most 4096 are allowed"),
        ("new decoder", b"\x02\xff\xff\xff\xff\xff", "integer is longer"),
        ("new decoder", b"\x02\x80\x00", "integer is longer"),
        ("new decoder", b"\x02\x00", "Welcome: data end"),
        ("new decoder", b"\x02\x01\x02", "protocol version 2; this program speaks version 11"),
        ("new decoder", b"\x02\x02\x0b\x7f", "configuration: `configuration` must be an array"),
        ("new decoder", b"\x02\x01\x0b", "configuration: .*truncated"),
        ("encoder", b"\x03\x01", "NextGop of 1 bytes, at most 0"),
        ("encoder", b"\x05\x81\xb0\x10", "ParityRequests of 268289 bytes, at most 268288"),
        ("encoder", b"\x05\x00", "0 bits requested at once"),
        ("encoder", b"\x05\x03\x01\x01\x00", "Requests: data end"),
        ("encoder", b"\x05\x04\x01\x01\x00\x80", "Requests: data end"),
        ("encoder", b"\x05\x05\x01\x01\x00\x80\x00", "Requests: integer is longer"),
        ("encoder", b"\x05\x07\x01\x01\x80\x80\x80\x80\x80", "Requests: integer is too long"),
        ("encoder", b"\x05\x06\x05\x01\x00\x02\x01\x00", "Requests: positions do not increase"),
        (
            "encoder",
            b"\x05\x0d\x09\x01\x00\x01\x01\x01\x00\xff\xff\xff\xff\x7f\x61",
            "ParityRequests: data end",
        ),
        (
            "encoder",
            b"\x05\x0a\x09\x01\x00\x01\x01\x01\x02\x01\x00\x00",
            "ParityRequests: positions do not increase",
        ),
        ("encoder", b"\x05\x09\x09\x01\x00\x01\x01\x01\x00\x80\x00", "Requests: integer is longer"),
        (
            "encoder",
            b"\x05\x0a\x09\x01\x00\x01\x80\x80\x80\x80\x80\x01",
            "ParityRequests: integer is too long",
        ),
        ("encoder", b"\x07\x00", "GopDone: data end"),
        ("encoder", b"\x0a\xf5\x03", "Failure of 501 bytes"),
        ("decoder", b"\x06\x01\x00", "1 bytes of bits"),
        ("decoder", b"\x06\x02\x00\xff", "not padded with zeros"),
    ],
)
def test_bytes_of_no_message_are_refused(end: str, data: bytes, text: str) -> None:
    """Lengths are checked before the bytes come; a stranger gets no configuration and no frame."""
    encoder, decoder = opened()
    decoder.send_requests([first(2, 0, "crc", 0, 0, 9)])
    stranger = EncoderEndpoint(CONFIG)
    ends = {
        "new encoder": stranger,
        "new decoder": DecoderEndpoint(ID),
        "encoder": encoder,
        "decoder": decoder,
    }
    with pytest.raises(FeedbackError, match=text):
        ends[end].receive(data)
    assert stranger.hello is None
    assert stranger.bytes_to_send() == b""


@pytest.mark.parametrize(("intra_period", "number"), [(0, 1), (0, 0), (16, 0)])
def test_predicted_key_frames_where_there_can_be_none_are_refused(intra_period: int, number: int) -> None:
    config = replace(CONFIG, key=replace(CONFIG.key, intra_period=intra_period))
    encoder, decoder = EncoderEndpoint(config), DecoderEndpoint(ID)
    encoder.receive(decoder.bytes_to_send())
    encoder.send_welcome()
    decoder.receive(encoder.bytes_to_send())
    open_gops(encoder, decoder, number)
    wrong = GopRecord(1, b"key", predicted=True)
    with pytest.raises(ValueError, match=f"the key frame of group of pictures {number} cannot be predicted"):
        encoder.send_gop(wrong)
    with pytest.raises(FeedbackError, match=f"the key frame of group of pictures {number} cannot be"):
        decoder.receive(encode_message(Gop(number, wrong)))


def test_many_requests_take_few_messages() -> None:
    """Requests go together, in order of frames, as long as the answers fit into one message."""
    encoder, decoder = opened()
    decoder.send_requests([first(3, 0, "crc", 0, 0, 8), REQUEST])
    decoder.send_requests(FETCHED[:20])
    events = encoder.receive(decoder.bytes_to_send())
    assert [len(event.rows) for event in events if isinstance(event, RequestTable)] == [2, 20]
    assert asked(events) == [REQUEST, first(3, 0, "crc", 0, 0, 8), *FETCHED[:20]]
    for event in events:
        assert isinstance(event, RequestTable)
        encoder.send_answers(answers(event))
    found = [event for event in decoder.receive(encoder.bytes_to_send()) if isinstance(event, ParityAnswer)]
    for answer, request in zip(found, asked(events), strict=True):
        assert (answer.frame, answer.run) == (request.frame, request.run)
        np.testing.assert_array_equal(
            answer.bits, run_bits(request.frame, request.run, request.start, request.count)
        )


def test_size_of_a_gop_is_bounded_by_its_frames() -> None:
    _, decoder = opened()
    with pytest.raises(FeedbackError, match="Gop of 2097152 bytes"):
        decoder.receive(b"\x04\x80\x80\x80\x01")
    encoder, _ = opened()
    with pytest.raises(ValueError, match="more than a message may have"):
        encoder.send_gop(GopRecord(1, bytes(2**21)))


@pytest.mark.parametrize(
    ("step", "text"),
    [
        (lambda encoder, decoder: encoder.send_answers(b"x"), "not requested"),
        (lambda encoder, decoder: encoder.send_gop(GopRecord(5, b"", False, b"", (b"",) * 4)), "5 frames"),
        (lambda encoder, decoder: [encoder.send_gop(RECORDS[2]) for _ in range(2)], "not asked for"),
        (lambda encoder, decoder: [encoder.send_end() for _ in range(2)], "second end"),
        (lambda encoder, decoder: decoder.send_gop_done(2), "not open"),
        (lambda encoder, decoder: [decoder.send_next_gop() for _ in range(32)], "more than 32"),
    ],
)
def test_mistakes_of_the_caller_are_value_errors(
    step: Callable[[EncoderEndpoint, DecoderEndpoint], object], text: str
) -> None:
    """A step of one's own that the protocol does not allow is refused before a byte is sent."""
    with pytest.raises(ValueError, match=text):
        step(*opened())


def test_no_credit_is_asked_for_after_the_end() -> None:
    """A credit that crosses the end on the wire is no breach, one after it is not even sent."""
    encoder, decoder = opened()
    encoder.send_end()
    decoder.send_next_gop()
    assert encoder.receive(decoder.bytes_to_send()) == [NextGop()]
    decoder.receive(encoder.bytes_to_send())
    decoder.send_next_gop()
    assert decoder.bytes_to_send() == b""
    for number in (0, 1):
        assert not encoder.finished
        decoder.send_gop_done(number)
        encoder.receive(decoder.bytes_to_send())
    finish(encoder, decoder)


def short_encoder() -> Encoder:
    """Return an encoder with two groups of pictures."""
    return Encoder(records=deque(RECORDS[:2]))


def transcript() -> tuple[list[bytes], list[bytes]]:
    """Return what a decoder and an encoder received from each other, turn by turn."""
    encoder, decoder = short_encoder(), Decoder()
    down, up = [], [decoder.endpoint.bytes_to_send()]
    encoder.react(up[0])
    while data := encoder.endpoint.bytes_to_send():
        down.append(data)
        decoder.react(data)
        up.append(decoder.endpoint.bytes_to_send())
        encoder.react(up[-1])
    return down, up


def mutate(turns: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """Change, cut or insert a few bytes in one or two turns."""
    turns = list(turns)
    for _ in range(rng.integers(1, 3)):
        turn = int(rng.integers(len(turns)))
        data = bytearray(turns[turn])
        first = int(rng.integers(0, len(data) + 1))
        data[first : first + int(rng.integers(0, 4))] = rng.bytes(int(rng.integers(0, 4)))
        turns[turn] = bytes(data)
    return turns


def test_mutations_raise_only_feedback_errors() -> None:
    rng = np.random.default_rng(5)
    down, up = transcript()
    ends: list[tuple[Callable[[], Encoder | Decoder], list[bytes]]] = [(short_encoder, up), (Decoder, down)]
    num_refused = 0
    for trial in range(2000):
        make, turns = ends[trial % 2]
        end = make()
        try:
            for data in mutate(turns, rng):
                end.react(data)
                end.endpoint.bytes_to_send()
        except FeedbackError:
            num_refused += 1
    assert num_refused > 600


@given(st.lists(st.binary(max_size=30), max_size=8))
def test_arbitrary_bytes_raise_only_feedback_errors(pieces: list[bytes]) -> None:
    for endpoint in (*opened(), DecoderEndpoint(ID)):
        try:
            for data in pieces:
                endpoint.receive(data)
        except FeedbackError:
            continue


@st.composite
def drawn_requests(draw: st.DrawFn) -> ParityRequests:
    """Draw a request, with a run or without."""
    run = draw(st.sampled_from([0, 0, 0, 1, 1, 2, 255, 256]))
    parts = st.dictionaries(
        st.integers(0, 3),
        st.tuples(
            st.sets(st.one_of(st.integers(0, 29), st.integers(0, 31)), max_size=17).map(sorted).map(tuple),
            st.sampled_from([0, 3, MAX_AREAS_BYTES, MAX_AREAS_BYTES + 1]).map(bytes),
        ),
        max_size=2,
    )
    kind: Kind = draw(st.sampled_from(["crc", "parity", "uncoded"]))
    numbers = (
        draw(st.sampled_from([0, 0, 0, 0, 5])),
        draw(st.sampled_from([0, 8, 100])),
        draw(st.sampled_from([0, 8, 100, NUM_BITS, 2 * NUM_BITS])),
    )
    begun = tuple(Part(offset, *own) for offset, own in sorted(draw(parts).items()))
    frame = draw(st.one_of(st.integers(1, 3), st.integers(0, 9)))
    return asking(ParityRequest(frame, run, kind, *numbers, begun=begun if draw(st.booleans()) else None))


messages: st.SearchStrategy[Message] = st.one_of(
    st.just(NextGop()), st.builds(GopDone, st.integers(0, 4)), drawn_requests(), st.just(ParityAnswers(b""))
)


@given(st.lists(messages, max_size=12))
def test_any_messages_of_a_decoder_are_taken_or_refused(steps: list[Message]) -> None:
    encoder, decoder = opened()
    waiting: list[RequestTable] = []
    for step in steps:
        if isinstance(step, ParityAnswers):  # to all that waits
            for table in waiting:
                encoder.send_answers(bytes(-(-table.num_bits // 8)))
            decoder.receive(encoder.bytes_to_send())
            waiting.clear()
            continue
        try:
            events = encoder.receive(encode_message(step))
        except FeedbackError:
            return
        if isinstance(step, ParityRequests):
            assert asked(events) == step.table.requests()
            waiting += [event for event in events if isinstance(event, RequestTable)]
            decoder.send_requests(step.table.requests())
        else:
            assert events == [step]
            assert not (isinstance(step, GopDone) and waiting and step.number == 1)


def test_all_messages_are_described() -> None:
    text = (Path(__file__).parents[2] / "docs" / "spec" / "feedback.md").read_text()
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|.*\| ([^|]+) \|$", text, re.MULTILINE)
    limits = {name: limit.replace("2^18", str(2**18)) for _, name, limit in rows}
    assert [name for _, name, _ in rows] == [kind.__name__ for kind in TYPES]
    assert [int(number) for number, _, _ in rows] == list(range(1, len(TYPES) + 1))
    assert limits.pop("Gop") == limits.pop("ParityRequests") == "by frame size"
    fixed = [kind for kind in TYPES if kind not in (Gop, ParityRequests)]
    assert limits == {kind.__name__: str(max_payload_bytes(kind, None)) for kind in fixed}
