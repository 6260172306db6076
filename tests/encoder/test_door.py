"""Who is let in, beside whom, and who is turned away."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from dvc.config import VideoConfig, codec_config
from dvc.errors import FeedbackError, RefusedError, SupersededError
from dvc.feedback import (
    DecoderEndpoint,
    EncoderEndpoint,
    Link,
    Protection,
    connect,
    dial,
    listen,
    transport,
)
from dvc.feedback.opening import NEW, Opening, open_stream
from encoder import door
from encoder.door import MAX_GREETINGS, MAX_TOLD, Door
from tests.waiting import wait_until

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")


@pytest.fixture(autouse=True)
def _ends_close_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one thread closes both ends, the first would wait for the second."""
    monkeypatch.setattr(transport, "_LINGER_S", 0.1)


@contextmanager
def opened(patience_s: float = 20.0) -> Iterator[tuple[Door, str, int, list[str]]]:
    """Yield a door, its address, and what it says."""
    said: list[str] = []
    with (
        listen("127.0.0.1") as listener,
        Door(listener, CONFIG, Protection(True), 5.0, patience_s, said.append) as opened_door,
    ):
        yield opened_door, listener.host, listener.port, said


def greeting(link: Link) -> Link:
    """Say hello as a decoder does."""
    link.send(DecoderEndpoint().bytes_to_send())
    return link


def until_it_fails(link: Link, endpoint: DecoderEndpoint | EncoderEndpoint) -> None:
    """Receive until there is nothing more to be received."""
    while True:
        endpoint.receive(link.receive())


def trickle(peer: socket.socket, data: bytes) -> None:
    """Say a little all the time until the other side has enough."""
    try:
        for byte in data:
            peer.sendall(bytes([byte]))
            time.sleep(0.02)
    except OSError:
        return


OPENING = Opening(NEW).encode()


@pytest.mark.parametrize("words", [b"", OPENING[:20], OPENING, OPENING + bytes(4000), b"\x01\x01\x06"])
def test_strangers_hold_up_nobody(words: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Silent, or trickling, they are turned away in time; a decoder is let in beside them."""
    monkeypatch.setattr(door, "HELLO_S", 2.0)
    with opened() as (entrance, host, port, said), socket.create_connection((host, port)) as first:
        slow = threading.Thread(target=trickle, args=(first, words))
        slow.start()
        time.sleep(0.05)
        with greeting(dial(host, port, 5.0)):
            link, endpoint = entrance.decoder()
            assert not said  # the stranger is still there
            with link:
                assert endpoint.greeted
                wait_until(lambda: said)
        first.close()
        slow.join()
    assert len(said) == 1
    assert said[0].startswith("not a decoder: ")


def test_only_so_many_strangers_are_talked_to_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever comes after them has a turn when they have been turned away."""
    monkeypatch.setattr(door, "HELLO_S", 0.5)
    monkeypatch.setattr(door, "MAX_TOLD", MAX_GREETINGS)
    with opened() as (entrance, host, port, said):
        strangers = [socket.create_connection((host, port)) for _ in range(MAX_GREETINGS)]
        with greeting(dial(host, port, 5.0)), entrance.decoder()[0]:
            wait_until(lambda: len(said) == MAX_GREETINGS)
        for stranger in strangers:
            stranger.close()


def test_strangers_are_counted_where_there_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first are told of one by one; of others there is a line now and then."""
    monkeypatch.setattr(door, "TOLD_APART_S", 1e9)
    with opened() as (entrance, host, port, said):
        for _ in range(MAX_TOLD + 3):
            with dial(host, port, 5.0) as far:
                far.send(b"\x01\x01\x06")
                with pytest.raises(FeedbackError, match="gave up"):
                    until_it_fails(far, DecoderEndpoint())
        wait_until(lambda: entrance._num_untold == 3)
        assert len(said) == MAX_TOLD
        monkeypatch.setattr(door, "TOLD_APART_S", 0.01)
        time.sleep(0.02)
        with dial(host, port, 5.0) as far:
            far.send(b"\x01\x01\x06")
            wait_until(lambda: len(said) > MAX_TOLD)
    assert said[-1].endswith("still waiting (3 others since the last line)")


def test_a_hello_in_pieces_is_taken() -> None:
    """As long as it is whole in time."""
    hello = DecoderEndpoint().bytes_to_send()
    with opened() as (entrance, host, port, said), dial(host, port, 5.0) as far:
        far.send(hello[:2])
        time.sleep(0.1)
        far.send(hello[2:])
        link, endpoint = entrance.decoder()
        with link:
            assert endpoint.greeted
    assert said == []


def test_a_decoder_of_another_version_is_told_so() -> None:
    """In the failure that it receives."""
    with opened() as (_, host, port, said), dial(host, port, 5.0) as far:
        far.send(b"\x01\x01\x06")
        with pytest.raises(FeedbackError, match=r"gave up: .*version 6; this program speaks"):
            until_it_fails(far, DecoderEndpoint())
        wait_until(lambda: said)
    assert "version 6" in said[0]


def test_a_second_decoder_is_refused_while_one_is_connected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first goes on unharmed."""
    monkeypatch.setattr(door, "NOTICING_S", 0.1)
    with opened() as (entrance, host, port, said), greeting(dial(host, port, 5.0)) as far:
        link, _ = entrance.decoder()
        with link:
            with pytest.raises(RefusedError, match="a decoder is connected already"):
                dial(host, port, 5.0)
            link.send(b"unharmed")
            data = b""
            while data != b"unharmed":
                data += far.receive()
            wait_until(lambda: said)
    assert "a decoder is connected already" in said[0]


def test_a_stream_that_is_not_served_is_refused() -> None:
    """A decoder of an encoder that was killed learns that another stream has begun."""
    with opened() as (_, host, port, said):
        with connect(host, port, 5.0) as connection, pytest.raises(RefusedError, match="another stream"):
            connection.talk(lambda peer: open_stream(peer, Opening(bytes(range(16)), 7), 5.0))
        wait_until(lambda: said)


def test_another_decoder_comes_in_place_of_one_that_is_gone() -> None:
    """It does not wait for the end of patience; who comes back late is refused."""
    with opened() as (entrance, host, port, _), greeting(dial(host, port, 5.0, None, 20.0)) as far:
        link, _ = entrance.decoder()
        with link:
            lost = far._connection
            assert lost is not None
            far._reconnect = None  # dies
            lost.break_off(FeedbackError("killed"))
            others: list[Link] = []
            coming = threading.Thread(target=lambda: others.append(greeting(dial(host, port, 5.0))))
            coming.start()
            with pytest.raises(SupersededError):
                until_it_fails(link, EncoderEndpoint(CONFIG))
            second, endpoint = entrance.decoder()
            coming.join()
            with second, others[0], connect(host, port, 5.0) as late:
                assert endpoint.greeted
                assert second.session != link.session
                with pytest.raises(RefusedError, match="another stream"):
                    late.talk(lambda peer: open_stream(peer, Opening(link.session), 5.0))


def test_without_patience_the_port_is_closed_after_the_first() -> None:
    """As ever."""
    with (
        opened(0.0) as (entrance, host, port, _),
        greeting(dial(host, port, 5.0)),
        entrance.decoder()[0],
        pytest.raises(FeedbackError, match="nobody listens"),
    ):
        dial(host, port, 0.3)
