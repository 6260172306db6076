"""Serving a decoder: what it may cost, and what another one gets that comes in its place."""

import pytest

from dvc.config import Live, VideoConfig, codec_config
from dvc.errors import FeedbackError
from dvc.feedback import DecoderEndpoint, EncoderEndpoint
from dvc.video import Frame
from encoder import live
from encoder.live import serve
from encoder.session import EncoderSession
from tests.clips import moving_texture

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")
HELLO = DecoderEndpoint().bytes_to_send()


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
