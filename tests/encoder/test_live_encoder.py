"""Serving a decoder: lost connections, and peers that ask for what there is not."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, cast

import numpy as np
import pytest

from dvc.config import Live, VideoConfig, codec_config
from dvc.errors import ConnectionLostError, FeedbackError
from dvc.feedback import Connection, DecoderEndpoint, EncoderEndpoint, Gop
from dvc.feedback.messages import Finished, encode_message
from dvc.slepian_wolf import ParityRequest, Part
from dvc.video import Frame
from dvc.wynerziv.areas import Areas
from encoder import live_encoder
from encoder.acceptor import AcceptedPeer, PeerAcceptor
from encoder.encoder_session import EncoderSession
from encoder.live_encoder import DecoderPace, serve
from encoder.rate_limits import RateLimits
from tests.clips import moving_texture
from tests.waiting import Clock

LAST = encode_message(Finished())
CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")
NO_AREAS = np.zeros(Areas((6, 8)).count, np.bool_)


class Decoder:
    """A connection to a decoder that takes one group after the other, and is lost after some."""

    def __init__(
        self, lasts: int = 10**6, num_groups: int = 0, num_frames: int = 0, done: bool = True
    ) -> None:
        self._endpoint = DecoderEndpoint(bytes(16), num_groups, num_frames)
        self._lasts, self._done = lasts, done
        self.records: list[Gop] = []

    def accepted(
        self, session: EncoderSession, first_frame: Callable[[int], int | None] = {0: 0}.get
    ) -> AcceptedPeer:
        """Exchange the hello and the welcome."""
        encoder = EncoderEndpoint(session.config)
        encoder.receive(self._endpoint.bytes_to_send())
        assert encoder.hello is not None
        encoder.send_welcome(first_frame(encoder.hello.num_groups) or 0)
        self.send(encoder.bytes_to_send())
        return AcceptedPeer(cast(Connection, self), encoder)

    def send(self, data: bytes) -> None:
        for event in self._endpoint.receive(data):
            if isinstance(event, Gop):
                self.records.append(event)
                self.take(event)
        flow = self._endpoint.flow
        if not flow.num_credits and len(flow.open) < 3:
            self._endpoint.send_next_gop()

    def take(self, gop: Gop) -> None:
        if self._done:
            self._endpoint.send_gop_done(gop.number)

    def receive(self, within_s: float | None = None) -> bytes:
        if len(self.records) > self._lasts:
            raise ConnectionLostError("the connection broke")
        return self._endpoint.bytes_to_send()

    def close(self) -> None:
        """Do nothing."""


class Asking(Decoder):
    """Asks for bits, whether it may or not, as soon as it has got a group with a Wyner-Ziv frame."""

    def __init__(self, requests: list[ParityRequest], **options: Any) -> None:
        super().__init__(**options)
        self._requests = requests

    def take(self, gop: Gop) -> None:
        if gop.record.num_frames > 1:
            self._endpoint.send_requests(self._requests)
            self._requests = []

    def receive(self, within_s: float | None = None) -> bytes:
        return self._endpoint.bytes_to_send() or super().receive(within_s)


class Peers(PeerAcceptor):
    """Connections that come one after the other; each continues where the one before says."""

    def __init__(self, session: EncoderSession, decoders: Sequence[Decoder]) -> None:
        self.first_frame: Callable[[int], int | None] = {0: 0}.get
        self._session, self._decoders = session, list(decoders)

    def next_peer(self, within_s: float | None = None) -> AcceptedPeer | None:
        if not self._decoders or within_s == 0.0:
            return None
        return self._decoders.pop(0).accepted(self._session, self.first_frame)


def served(
    session: EncoderSession, frames: Sequence[Frame], *decoders: Decoder, **options: Any
) -> dict[str, Any]:
    """Serve a decoder on some connections."""
    peers = Peers(session, decoders[1:])
    return serve(session, frames, peers, decoders[0].accepted(session), lambda _: None, **options)


def test_a_decoder_without_progress_is_lost_by_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0

    class Idle(Decoder):
        """Is at work, and takes 600 s for each step."""

        def receive(self, within_s: float | None = None) -> bytes:
            nonlocal now_s
            now_s += 600.0
            return super().receive(within_s) if len(self.records) < 2 else b""

    monkeypatch.setattr(live_encoder.time, "monotonic", lambda: now_s)
    frames = [Frame(frame.luma) for frame in moving_texture(9, 24, 32)]
    with pytest.raises(FeedbackError, match="connected, but does nothing for 3600 s"):
        served(EncoderSession(CONFIG, Live()), frames, Idle(done=False))
    assert 4000.0 < now_s < 8000.0


LAST_PLANE = sum(CONFIG.wyner_ziv.max_planes) - 1


def asking(plane: int, areas: bytes = b"") -> ParityRequest:
    """Return the first request of frame 1, for check bits of a plane."""
    return ParityRequest(1, 0, "crc", 0, 0, 8, (), (Part(0, (plane,), areas),))


@pytest.mark.parametrize(
    ("requests", "text"),
    [
        ([asking(0, b"\xff" * 20)], "range-coded data are damaged"),
        ([asking(LAST_PLANE)], "plane 191 of a frame"),
        ([replace(asking(0), begun=(Part(0, (0, LAST_PLANE)),))], "plane 191 of a frame"),
        ([replace(asking(0), begun=None)], "run 0 of frame 1: this run, or another"),
        (
            [
                replace(asking(0), kind="joint", positions=(0, 1)),
                replace(asking(1), run=1),
            ],
            "joint bits of run 0 of frame 1: this run, or another",
        ),
        (
            [replace(asking(0, Areas((6, 8)).coded(NO_AREAS)), kind="uncoded", count=48)],
            "bit 47 of a run of 0 in frame 1",
        ),
    ],
)
def test_bits_that_a_frame_does_not_have_end_the_run(requests: list[ParityRequest], text: str) -> None:
    """A decoder that asks for planes or areas of no frame, or for no run, is told off in one line."""
    frames = [Frame(frame.luma) for frame in moving_texture(9, 24, 32)]
    session = EncoderSession(CONFIG, Live())
    with pytest.raises(
        FeedbackError, match=f"the other side broke the feedback protocol: .*{text}"
    ) as caught:
        served(session, frames, Asking(requests))
    assert "\n" not in str(caught.value)


def first_bits(frame: int, count: int) -> ParityRequest:
    """Return a request for check bits of a frame."""
    return ParityRequest(frame, 0, "crc", 0, 0, count, (), (Part(0, (0,)),))


def test_a_decoder_that_comes_back_gets_what_it_has_not_written() -> None:
    """The same records with the same numbers; what it had asked for of them is counted."""
    frames = [Frame(frame.luma) for frame in moving_texture(13, 24, 32)]
    session = EncoderSession(CONFIG, Live())
    whole = Decoder()
    served(EncoderSession(CONFIG, Live()), frames, whole)
    before = Decoder(lasts=2)
    asking_one = Asking([first_bits(5, 8)], num_groups=3, num_frames=5, lasts=0, done=False)
    after = Decoder(num_groups=3, num_frames=5)
    done: list[int] = []
    peers = Peers(session, [asking_one, after])
    report = serve(session, frames, peers, before.accepted(session), done.append, None, 1.0)
    assert [gop.number for gop in before.records] == [0, 1, 2]
    assert [gop.number for gop in after.records] == [3, 4, 5, 6]
    assert [gop.record for gop in whole.records] == [gop.record for gop in (*before.records, *after.records)]
    assert asking_one.records[0].record == after.records[0].record
    assert sum(done) == 13
    assert report["num_reconnections"] == 2
    assert report["bits_asked_again"] == 8
    assert report["groups_sent_again"] == len(asking_one.records)


def test_a_decoder_that_does_not_come_back_ends_the_run() -> None:
    """The error names the frames that may not be written; without patience it does not wait."""
    frames = [Frame(frame.luma) for frame in moving_texture(13, 24, 32)]
    for patience_s, words in (
        (0.0, "the connection broke; frames 1 to"),
        (0.5, "not come back for 0.5 s; frames"),
    ):
        with pytest.raises(FeedbackError, match=words):
            served(EncoderSession(CONFIG, Live()), frames, Decoder(lasts=1), patience_s=patience_s)


def test_a_connection_that_is_lost_after_all_is_written_is_no_error() -> None:

    class Lost(Decoder):
        """Is lost once all is done."""

        def receive(self, within_s: float | None = None) -> bytes:
            if self._endpoint.flow.all_done:
                data = super().receive(within_s)
                if not data.endswith(LAST):
                    raise ConnectionLostError("the connection broke")
                return data.removesuffix(LAST)
            return super().receive(within_s)

    frames = [Frame(frame.luma) for frame in moving_texture(5, 24, 32)]
    report = served(EncoderSession(CONFIG, Live()), frames, Lost(), patience_s=0.1)
    assert report["num_reconnections"] == 0


def test_bits_of_groups_that_are_sent_again_are_settled_once() -> None:
    frames = [Frame(frame.luma) for frame in moving_texture(13, 24, 32)]
    session = EncoderSession(CONFIG, Live(), limits=RateLimits(bits_per_s=20_000))
    served(session, frames, Decoder(lasts=0, done=False), Decoder(), patience_s=1.0)
    assert session.limiter is not None
    assert not session.limiter._bucket._open  # type: ignore[union-attr]


def test_requests_are_answered_while_frames_are_awaited() -> None:
    frames = [Frame(frame.luma) for frame in moving_texture(5, 24, 32)]
    asked: list[bool] = []

    def _has_frames() -> bool:
        asked.append(len(decoder.records) > 0)
        return asked.count(True) % 5 == 0

    decoder = Decoder()
    served(EncoderSession(CONFIG, Live()), frames, decoder, has_frames=_has_frames)
    assert sum(gop.record.num_frames for gop in decoder.records) == 5
    assert len(asked) > 10


def test_a_late_decoder_is_logged_less_and_less_often() -> None:
    """It is said when the decoder is a second late, and when it is four times as late as was said last."""
    clock, said = Clock(), list[str]()
    pace = DecoderPace(Fraction(4), said.append, clock=clock)
    pace.waits()
    for _ in range(3):
        pace.sent(8)
    pace.done(8)
    for now_s in range(40):
        clock.now_s = float(now_s)
        pace.waits()
    assert [line.split(" s behind")[0] for line in said] == [
        f"the decoder is {late}.0" for late in (1, 4, 16)
    ]
    assert "16 frames up to number 23" in said[0]
    assert "more frames wait; none left out" in said[0]
    assert (pace.behind_s, pace.most_frames_open) == (33.0, 24)


def test_a_decoder_in_time_is_not_logged() -> None:
    clock, said = Clock(), list[str]()
    pace = DecoderPace(Fraction(4), said.append, clock=clock)
    for number in range(50):
        clock.now_s = 0.25 * number
        pace.sent(1)
        pace.waits()
        pace.done(1)
    assert (said, pace.behind_s, pace.most_frames_open) == ([], 0.0, 1)
