"""Serving a decoder: what it may cost, and what another one gets that comes in its place."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from dvc.config import Live, Qp, VideoConfig, codec_config
from dvc.errors import FeedbackError, SupersededError
from dvc.feedback import DecoderEndpoint, EncoderEndpoint, LinkCounts
from dvc.feedback.messages import Gop, ParityRequests, encode_message
from dvc.slepian_wolf import ParityRequest, Part, RequestTable
from dvc.video import Frame
from dvc.wynerziv.areas import Areas
from encoder import live
from encoder.kept_groups import KeptGroups
from encoder.leaky_bucket import RateLimits
from encoder.live import serve
from encoder.pacing import DecoderPace
from encoder.session import EncoderSession
from tests.clips import moving_texture

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")
HELLO = DecoderEndpoint().bytes_to_send()
NO_AREAS = np.zeros(Areas((6, 8)).count, np.bool_)


def test_no_frame_is_taken_before_the_hello() -> None:
    """A camera is not read for somebody who is no decoder."""

    class Peer:
        has_received = staticmethod(lambda: False)
        close = staticmethod(lambda: None)
        receive = staticmethod(iter([b"", HELLO[:2], b"\0"]).__next__)
        send = staticmethod(lambda data: None)

    frames = iter(moving_texture(3, 24, 32))
    with pytest.raises(FeedbackError, match="broke the feedback protocol"):
        serve(EncoderSession(CONFIG, Live()), frames, Peer(), lambda _: None)  # type: ignore[arg-type]
    assert len(list(frames)) == 3


def test_a_decoder_without_progress_is_given_up_by_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Signs of life count for nothing after an hour, however many or few they are."""
    now_s = 0.0

    class Decoder:
        """Asks for one group of pictures, and is at work from then on, a step of 600 s after the other."""

        def __init__(self) -> None:
            endpoint = DecoderEndpoint()
            encoder = EncoderEndpoint(EncoderSession(CONFIG, Live()).config)
            hello = endpoint.bytes_to_send()
            encoder.receive(hello)
            endpoint.receive(encoder.bytes_to_send())
            endpoint.send_next_gop()
            self.said = iter([hello, endpoint.bytes_to_send()])

        def receive(self) -> bytes:
            nonlocal now_s
            now_s += 600.0
            return next(self.said, b"")

        has_received = staticmethod(lambda: False)
        close = staticmethod(lambda: None)
        send = staticmethod(lambda data: None)

    monkeypatch.setattr(live.time, "monotonic", lambda: now_s)
    frames = [Frame(frame.luma) for frame in moving_texture(3, 24, 32)]
    with pytest.raises(FeedbackError, match="alive, but does nothing for 3600 s"):
        serve(EncoderSession(CONFIG, Live()), frames, Decoder(), lambda _: None)  # type: ignore[arg-type]
    assert 4000.0 < now_s < 6000.0


class Decoder:
    """Takes one group of pictures after the other, asks for nothing, and may be gone after some."""

    counts = LinkCounts()

    def __init__(self, lasts: float = math.inf) -> None:
        self._endpoint, self._lasts, self._answer = DecoderEndpoint(), lasts, b""
        self.records: list[Gop] = []

    def enter(self, encoder: EncoderEndpoint) -> None:
        """Exchange the hellos."""
        encoder.receive(self._endpoint.bytes_to_send())
        self.send(encoder.bytes_to_send())

    def send(self, data: bytes) -> None:
        for event in self._endpoint.receive(data):
            if isinstance(event, Gop):
                self.records.append(event)
                self._endpoint.send_gop_done(event.number)
        if not self._endpoint.num_credits:
            self._endpoint.send_next_gop()

    def receive(self) -> bytes:
        if len(self.records) > self._lasts:
            raise SupersededError
        return self._endpoint.bytes_to_send()

    def wait(self, at_most_s: float) -> bool:
        return at_most_s > 0.0

    has_received = staticmethod(lambda: False)
    close = staticmethod(lambda: None)


class Asking(Decoder):
    """Asks for bits, whether it may or not, as soon as it has got a group with a Wyner-Ziv frame."""

    def __init__(self, requests: list[ParityRequest]) -> None:
        super().__init__()
        self._says = encode_message(ParityRequests(RequestTable.of(requests)))

    def send(self, data: bytes) -> None:
        for event in self._endpoint.receive(data):
            if isinstance(event, Gop) and event.record.num_frames > 1:
                self._answer, self._says = self._says, b""
        if not self._endpoint.num_credits:
            self._endpoint.send_next_gop()

    def receive(self) -> bytes:
        said, self._answer = self._answer, b""
        return super().receive() + said


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
        ([replace(asking(0), begun=None)], "run 0 of frame 1, or another one that was not begun"),
        (
            [
                replace(asking(0), kind="joint", positions=(0, 1)),
                replace(asking(1), run=1),
            ],
            "joint bits of run 0 of frame 1, or another one that was not begun",
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
    session, decoder = EncoderSession(CONFIG, Live()), Asking(requests)
    endpoint = EncoderEndpoint(session.config)
    decoder.enter(endpoint)
    with pytest.raises(
        FeedbackError, match=f"the other side broke the feedback protocol: .*{text}"
    ) as caught:
        serve(session, frames, decoder, lambda _: None, None, endpoint)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("intra_period", "begins"), [(0, 8), (5, 6), (96, 0)])
def test_another_decoder_begins_with_an_idr_picture_before_what_may_be_lost(
    intra_period: int, begins: int
) -> None:
    """Its chain is sent again, and no frame is lost."""
    video = VideoConfig(32, 24, 25, 1, luma_only=True)
    session = EncoderSession(codec_config(video, "2d", key={"intra_period": intra_period}), Live())
    frames = [Frame(frame.luma) for frame in moving_texture(21, 24, 32)]
    decoders, endpoints = (Decoder(lasts=6), Decoder()), [EncoderEndpoint(session.config) for _ in range(2)]

    def entered(place: int) -> tuple[Decoder, EncoderEndpoint]:
        decoders[place].enter(endpoints[place])
        return decoders[place], endpoints[place]

    link, endpoint = entered(0)
    told = serve(session, frames, link, lambda _: None, None, endpoint, lambda: entered(1))  # type: ignore[arg-type, return-value]
    assert (told["num_decoders"], told["frames_lost"]) == (2, [])
    alone, *others = (gop.record for gop in decoders[1].records)
    assert (alone.num_frames, alone.predicted) == (1, False)
    assert endpoints[1].first_frame == begins
    assert begins + 1 + sum(record.num_frames for record in others) == 21


@pytest.fixture
def forgets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep so few groups that the IDR picture is forgotten that they rest on."""
    monkeypatch.setattr(live, "KeptGroups", lambda _: KeptGroups(4))


@pytest.mark.usefixtures("forgets")
def test_frames_that_no_decoder_gets_are_named_once() -> None:
    """Also where the next one goes before it has written any."""
    video = VideoConfig(32, 24, 25, 1, luma_only=True)
    session = EncoderSession(codec_config(video, "2d", Qp(30), key={"intra_period": 96}), Live())
    frames = [Frame(frame.luma) for frame in moving_texture(13, 24, 32)]
    decoders = iter([Decoder(lasts=2), Decoder(lasts=-1), Decoder()])

    def entered() -> tuple[Decoder, EncoderEndpoint]:
        decoder, endpoint = next(decoders), EncoderEndpoint(session.config)
        decoder.enter(endpoint)
        return decoder, endpoint

    link, endpoint = entered()
    told = serve(session, frames, link, lambda _: None, None, endpoint, entered)  # type: ignore[arg-type]
    assert told["num_decoders"] == 3
    lost = [number for first, last in told["frames_lost"] for number in range(first, last + 1)]
    assert lost
    assert len(set(lost)) == len(lost)


@pytest.mark.usefixtures("forgets")
def test_another_decoder_begins_with_a_group_of_which_nothing_is_known() -> None:
    """It gets the key frame alone; of the others of the group no bits are expected, and no frames missed."""
    video, limits = VideoConfig(32, 24, 25, 1, luma_only=True), RateLimits(bits_per_s=20_000)
    config = codec_config(video, "2d", Qp(30), key={"intra_period": 96})
    session = EncoderSession(config, Live(), limits=limits)
    frames = [Frame(frame.luma) for frame in moving_texture(13, 24, 32)]
    decoders = Decoder(lasts=2), Decoder()
    endpoints = EncoderEndpoint(session.config), EncoderEndpoint(session.config)
    pace = DecoderPace(Fraction(25), lambda _: None)

    def entered(place: int) -> tuple[Decoder, EncoderEndpoint]:
        decoders[place].enter(endpoints[place])
        return decoders[place], endpoints[place]

    def done(num_frames: int) -> None:
        seen.append(num_frames)

    seen: list[int] = []
    first, second = (lambda: entered(0)), (lambda: entered(1))
    link, endpoint = first()
    told = serve(session, frames, link, done, pace, endpoint, second)  # type: ignore[arg-type]
    assert told["num_decoders"] == 2
    alone, *others = decoders[1].records
    assert (alone.record.num_frames, alone.record.wyner_ziv) == (1, ())
    assert all(gop.record.num_frames == 2 for gop in others)
    assert endpoints[1].first_frame + 1 + 2 * len(others) == 13
    assert told["frames_lost"] == [[sum(seen[: -1 - len(others)]), endpoints[1].first_frame - 1]]
    assert session.limiter is not None
    assert not session.limiter._bucket._open  # type: ignore[union-attr]
    assert pace._num_sent == pace._num_done
