"""Waiting for a decoder: who holds up an encoder, and for how long."""

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from dvc.config import Live, VideoConfig, codec_config
from dvc.errors import FeedbackError
from dvc.feedback import KEEP_ALIVE, DecoderEndpoint, EncoderEndpoint, Protection, connect, listen
from dvc.video import Frame
from encoder import live
from encoder.live import await_decoder, greet, serve
from encoder.session import EncoderSession
from tests.clips import moving_texture

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")
HELLO = DecoderEndpoint().bytes_to_send()


def trickle(peer: socket.socket, data: Iterator[bytes]) -> None:
    """Say a little all the time until the other side has enough."""
    try:
        for piece in data:
            peer.sendall(piece)
            time.sleep(0.02)
    except OSError:
        return


@pytest.mark.parametrize("words", [b"", b"\x01\x81", HELLO[:2], b"\x01\xff\x1f" + b"x" * 4000])
def test_a_peer_without_a_hello_is_turned_away_in_time(words: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether it is silent or trickles bytes, the decoder behind it gets its turn."""
    monkeypatch.setattr(live, "HELLO_S", 0.5)
    said: list[str] = []
    with listen("127.0.0.1") as listener:
        first = socket.create_connection((listener.host, listener.port))
        slow = threading.Thread(target=trickle, args=(first, (bytes([byte]) for byte in words)))
        slow.start()
        second = connect(listener.host, listener.port)
        second.send(HELLO)
        started_s = time.monotonic()
        connection, endpoint = await_decoder(listener, CONFIG, 30.0, said.append, Protection(True))
        taken_s = time.monotonic() - started_s
        first.close()
        slow.join()
        with connection, second:
            assert endpoint.greeted
    assert 0.4 < taken_s < 5.0
    assert len(said) == 1
    assert "no hello for 0.5 s" in said[0]


def test_a_hello_in_pieces_is_taken() -> None:
    """As long as it is whole in time."""
    with listen("127.0.0.1") as listener:
        peer = connect(listener.host, listener.port)
        connection = listener.accept()
        slow = threading.Thread(target=lambda: [peer.send(HELLO[:2]), time.sleep(0.1), peer.send(HELLO[2:])])
        slow.start()
        with connection, peer:
            assert greet(connection, CONFIG).greeted
            slow.join()


def test_no_frame_is_taken_before_the_hello() -> None:
    """A camera is not read for somebody who is no decoder."""

    class Peer:
        has_received = staticmethod(lambda: False)
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
            return next(self.said, KEEP_ALIVE)

        has_received = staticmethod(lambda: False)
        send = staticmethod(lambda data: None)

    monkeypatch.setattr(live.time, "monotonic", lambda: now_s)
    frames = [Frame(frame.luma) for frame in moving_texture(3, 24, 32)]
    with pytest.raises(FeedbackError, match="alive, but does nothing for 3600 s"):
        serve(EncoderSession(CONFIG, Live()), frames, Decoder(), lambda _: None)  # type: ignore[arg-type]
    assert 4000.0 < now_s < 6000.0
