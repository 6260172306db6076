"""Live decoding with many groups in flight: the same as from a file, and clean ends where the peer is bad."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from benchmarks.loopback import accepted, accepting
from benchmarks.slow_link import slow_link
from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.live import HELD_SHARE, HeldRequests, LiveGroups, LiveSource
from decoder.session import decode_live
from dvc.config import CascadeConfig, CodecConfig, Live, Qp, VideoConfig, codec_config
from dvc.errors import BitstreamError, ConnectionLostError, FeedbackError
from dvc.feedback import MAX_OPEN_GOPS, Dialler, max_open_gops
from dvc.limits import Limits
from dvc.slepian_wolf import ParityRequest, RequestTable
from dvc.stream import GopRecord
from dvc.video import Frame
from encoder.acceptor import AcceptedPeer, PeerAcceptor
from encoder.encoder_session import EncoderSession
from encoder.live_encoder import DecoderPace, serve
from tests import streams
from tests.clips import moving_texture

PATIENCE_S = 20.0


def configuration(intra_period: int) -> CodecConfig:
    return codec_config(
        VideoConfig(32, 24, 25, 1, luma_only=True),
        "2d",
        Qp(32),
        gop={"length": 4, "references": "hierarchical"},
        key={"qp": 36, "intra_period": intra_period},
        coder=CascadeConfig(20),
    )


CONFIG, CHAINED = configuration(0), configuration(12)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [Frame(frame.luma) for frame in moving_texture(22, 24, 32)]


@pytest.fixture(scope="module")
def offline(frames: list[Frame]) -> list[DecodedGroup]:
    """Return what a file of the same video decodes to."""
    return streams.decoded(streams.encoded(CONFIG, frames))


Work = Callable[[PeerAcceptor, AcceptedPeer], object]


@contextmanager
def serving(work: Work, config: CodecConfig = CONFIG, patience_s: float = 0.0) -> Iterator[str]:
    """Serve a decoder in another thread; yield the address."""

    def _serve() -> None:
        peer = accepted(acceptor)
        try:
            work(acceptor, peer)
        finally:
            peer.connection.close(0.1)

    config = EncoderSession(config, Live()).config
    with accepting(config, PATIENCE_S, patience_s) as (listener, acceptor):
        thread = threading.Thread(target=_serve)
        thread.start()
        yield listener.name
        thread.join()


def source_at(address: str, timeout_s: float = PATIENCE_S, patience_s: float = 0.0) -> LiveSource:
    host, _, port = address.rpartition(":")
    return LiveSource(Dialler(host, int(port), timeout_s=timeout_s), patience_s)


def decoded(
    address: str, jobs: int = 1, timeout_s: float = PATIENCE_S, limits: Limits | None = None
) -> Iterator[DecodedGroup]:
    with closing(source_at(address, timeout_s)) as source:
        yield from decode_live(source.config, source, jobs, limits=limits)


def encoding(frames: list[Frame], pace: DecoderPace | None = None, config: CodecConfig = CONFIG) -> Work:
    return lambda acceptor, peer: serve(
        EncoderSession(config, Live()), frames, acceptor, peer, lambda _: None, pace
    )


def assert_same(found: list[DecodedGroup], wanted: list[DecodedGroup]) -> None:
    assert [group.first_index for group in found] == [group.first_index for group in wanted]
    for ours, theirs in zip(found, wanted, strict=True):
        assert ours.record == theirs.record
        for frame, other in zip(ours.frames, theirs.frames, strict=True):
            np.testing.assert_array_equal(frame.luma, other.luma)


@pytest.mark.parametrize("jobs", [1, 2])
def test_many_groups_in_flight_give_the_frames_and_bits_of_a_file(
    frames: list[Frame], offline: list[DecodedGroup], jobs: int
) -> None:
    pace = DecoderPace(Fraction(25), lambda _: None)
    with serving(encoding(frames, pace)) as address:
        assert_same(list(decoded(address, jobs)), offline)
    assert 4 < pace.most_frames_open <= len(frames)


def test_a_slow_link_changes_neither_frames_nor_bits() -> None:
    config = replace(CONFIG, video=replace(CONFIG.video, width=176, height=144))
    video = [Frame(frame.luma) for frame in moving_texture(14, 144, 176)]
    wanted = streams.decoded(streams.encoded(config, video))
    with serving(encoding(video, None, config), config) as address:
        host, _, port = address.rpartition(":")
        with slow_link(host, int(port), delay_s=0.004, bits_per_second=5e5) as link:
            started = time.monotonic()
            groups = list(decoded(link.address))
            taken_s = time.monotonic() - started
    assert_same(groups, wanted)
    needed = sum(len(group.record.key) + sum(map(len, group.record.wyner_ziv)) for group in wanted)
    assert needed < link.forth.num_bytes < 2 * needed
    assert taken_s > 8 * link.forth.num_bytes / 5e5
    num_requests = sum(frame.num_requests for group in groups for frame in group.wyner_ziv)
    assert 0 < sum(group.num_messages for group in groups) < num_requests
    assert all(group.delay_s is not None and 0.0 < group.delay_s < taken_s for group in groups)


@pytest.mark.parametrize("config", [CONFIG, CHAINED], ids=["intra", "predicted"])
def test_lost_connections_change_neither_frames_nor_bits(frames: list[Frame], config: CodecConfig) -> None:
    reports: list[dict[str, Any]] = []

    def _serve(acceptor: PeerAcceptor, peer: AcceptedPeer) -> None:
        own = EncoderSession(config, Live())
        reports.append(serve(own, frames, acceptor, peer, lambda _: None, None, PATIENCE_S))

    found: list[DecodedGroup] = []
    with (
        serving(_serve, config, PATIENCE_S) as address,
        closing(source_at(address, patience_s=PATIENCE_S)) as source,
    ):
        for number, group in enumerate(decode_live(source.config, source)):
            found.append(group)
            if number in (0, 2, 3):
                source.connection.break_off("the cable was pulled")
    assert_same(found, streams.decoded(streams.encoded(config, frames)))
    assert source.report.num_reconnections >= 3
    assert source.report.groups_sent_again > 0
    assert reports[0]["num_reconnections"] == source.report.num_reconnections
    assert reports[0]["bits_asked_again"] > 0


def test_a_connection_that_is_lost_at_the_very_end_is_no_error(frames: list[Frame]) -> None:
    with (
        serving(encoding(frames), patience_s=PATIENCE_S) as address,
        closing(source_at(address, patience_s=PATIENCE_S)) as source,
    ):
        found = list(decode_live(source.config, source))
    assert sum(len(group.frames) for group in found) == len(frames)
    assert not source.reconnect(ConnectionLostError("the connection broke"))


@pytest.mark.parametrize(
    ("other", "words"),
    [(CHAINED, "serves another sequence"), (CONFIG, "differs from the one that came before")],
)
def test_another_sequence_is_not_continued(frames: list[Frame], other: CodecConfig, words: str) -> None:
    """Another encoder that has come to the same address before any group was written is noticed."""

    def _other(acceptor: PeerAcceptor, peer: AcceptedPeer) -> None:
        with suppress(FeedbackError):
            serve(EncoderSession(other, Live()), frames[::-1], acceptor, peer, lambda _: None)

    with serving(until_left(frames, []), patience_s=PATIENCE_S) as first, serving(_other, other) as second:
        host, _, port = second.rpartition(":")
        source = source_at(first, patience_s=PATIENCE_S)
        groups = LiveGroups(source, lambda gop: cast(GroupTask, SimpleNamespace(record=gop.record)))
        while not source.tasks:
            list(groups.wait([]))
            list(groups.poll())
        source._dialler = Dialler(host, int(port), timeout_s=PATIENCE_S)
        with closing(source), pytest.raises((FeedbackError, BitstreamError), match=words):
            _receive_again(source)


def _receive_again(source: LiveSource) -> None:
    """Connect again, and receive groups until one is refused."""
    source.reconnect(ConnectionLostError("the connection broke"))
    groups = LiveGroups(source, lambda gop: cast(GroupTask, None))
    while True:
        list(groups.wait([]))
        for task in groups.poll():
            if isinstance(task, BitstreamError):
                raise task


def test_requests_wait_for_others_while_there_is_something_to_do() -> None:
    """They go when the rest of the work takes as long as answers do, or a little after that."""
    now_s = [0.0]
    held = HeldRequests(lambda: now_s[0])
    requests = [ParityRequest(1, run, "crc", 0, 0, 8) for run in range(3)]
    held.add(requests[:1])
    assert held.left_s(9) == 0.0
    for _ in range(200):
        held.stepped(0.01)
    assert held.left_s(9) == pytest.approx(0.09, rel=0.01)
    assert held.left_s(0) == 0.0
    held.add(requests[1:])
    assert held.take() == requests
    assert len(held) == 0
    now_s[0] += 0.08
    held.answered((1, 0))
    held.add(requests[:1])
    assert held.left_s(10) == pytest.approx(0.02, rel=0.1)
    assert held.left_s(8) == pytest.approx(0.08 * HELD_SHARE)
    now_s[0] += 0.08 * HELD_SHARE
    assert held.left_s(8) == pytest.approx(0.0, abs=1e-3)
    assert held.left_s(10) == pytest.approx(0.02, rel=0.1)


class Liar:
    """An encoder that goes on well until it has got some requests, then behaves as it is told to."""

    def __init__(self, frames: list[Frame], num_requests: int, behave: Callable[["Liar"], None]) -> None:
        self._frames, self._left, self._behave = frames, num_requests, behave
        self.waiting: list[RequestTable] = []

    def __call__(self, acceptor: PeerAcceptor, peer: AcceptedPeer) -> None:
        self.link, self.endpoint = peer
        link, own = self.link, EncoderSession(CONFIG, Live())
        groups = own.groups(self._frames)
        number = 0
        while sum(len(table.rows) for table in self.waiting) < self._left:
            for _ in range(self.endpoint.flow.num_credits):
                group = next(groups, None)
                if group is None:
                    break
                encoded = own.encode(group)
                number, _ = self.endpoint.send_gop(encoded.record)
            link.send(self.endpoint.bytes_to_send())
            events = self.endpoint.receive(link.receive())
            self.waiting += [event for event in events if isinstance(event, RequestTable)]
        assert number >= 2
        try:
            self._behave(self)
        except FeedbackError:
            return


def stall(liar: Liar) -> None:
    while True:
        liar.link.receive()


def die(liar: Liar) -> None:
    liar.endpoint.send_answers(bytes(-(-liar.waiting[0].num_bits // 8)))
    liar.link.send(liar.endpoint.bytes_to_send()[:-1])


def answer_twice(liar: Liar) -> None:
    """Answer all requests, the last of them a second time."""
    for table in liar.waiting:
        liar.endpoint.send_answers(bytes(-(-table.num_bits // 8)))
    data = liar.endpoint.bytes_to_send()
    liar.link.send(data + data)
    stall(liar)


def send_more_groups(liar: Liar) -> None:
    """Send a group of pictures that was not asked for, though many others are open."""
    while liar.endpoint.flow.num_credits:
        liar.endpoint.send_gop(GopRecord(1, b"x"))
    data = liar.endpoint.bytes_to_send()
    liar.link.send(data * 2)
    stall(liar)


@pytest.mark.parametrize(
    ("behave", "error", "words"),
    [
        (stall, FeedbackError, "is silent for 2 s"),
        (die, FeedbackError, "closed the connection|went away"),
        (answer_twice, FeedbackError, "not requested"),
        (send_more_groups, (FeedbackError, BitstreamError), "group of pictures"),
    ],
)
def test_bad_peers_end_many_requests_in_flight(
    frames: list[Frame], behave: Callable[[Liar], None], error: type[Exception], words: str
) -> None:
    with serving(Liar(frames, 5, behave)) as address, pytest.raises(error, match=words):
        list(decoded(address, timeout_s=2.0))


@pytest.mark.parametrize("share", [0.5, 0.05, 1.0])
def test_lies_do_not_hang(frames: list[Frame], offline: list[DecodedGroup], share: float) -> None:
    rng = np.random.default_rng(1)

    def _lie(liar: Liar) -> None:
        while True:
            for table in liar.waiting:
                bits = np.packbits(rng.random(table.num_bits) < share)
                liar.endpoint.send_answers(bits.tobytes())
            liar.link.send(liar.endpoint.bytes_to_send())
            if not (data := liar.link.receive(1.0)):
                return  # all that was sent is decoded
            events = liar.endpoint.receive(data)
            liar.waiting = [event for event in events if isinstance(event, RequestTable)]

    found: list[DecodedGroup] = []
    with serving(Liar(frames, 5, _lie)) as address:
        try:
            for group in decoded(address, timeout_s=2.0):
                found.append(group)
        except (FeedbackError, BitstreamError):
            pass
    assert [group.record for group in found] != [group.record for group in offline]


def test_the_window_is_bounded_by_frames_and_by_their_size() -> None:
    assert max_open_gops(CONFIG) == MAX_OPEN_GOPS
    large = replace(CONFIG, video=replace(CONFIG.video, width=3840, height=2160))
    assert max_open_gops(large) == 2
    assert (
        2 < max_open_gops(replace(large, video=replace(large.video, width=1280, height=720))) < MAX_OPEN_GOPS
    )


def until_left(frames: list[Frame], ended: list[FeedbackError]) -> Work:
    def _serve(acceptor: PeerAcceptor, peer: AcceptedPeer) -> None:
        try:
            encoding(frames)(acceptor, peer)
        except FeedbackError as err:
            ended.append(err)

    return _serve


def test_leaving_early_stops_what_is_in_flight(frames: list[Frame]) -> None:
    ended: list[FeedbackError] = []
    with serving(until_left(frames, ended)) as address:
        groups = decoded(address)
        assert next(groups).first_index == 0
        groups.close()
    assert len(ended) == 1


def test_no_more_frames_are_decoded_than_are_allowed(
    frames: list[Frame], offline: list[DecodedGroup]
) -> None:
    found, ended = list[DecodedGroup](), list[FeedbackError]()
    most = offline[3].first_index

    def _decode(address: str) -> None:
        for group in decoded(address, limits=Limits(max_frames=most)):
            found.append(group)

    words = f"{offline[4].first_index} frames, more than the {most} that are allowed; --max-frames"
    with serving(until_left(frames, ended)) as address, pytest.raises(BitstreamError, match=words):
        _decode(address)
    assert len(ended) == 1
    assert_same(found, offline[:3])
