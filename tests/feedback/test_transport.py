"""TCP transport: addresses, patience, peers that misbehave."""

import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from dvc.config import VideoConfig, codec_config
from dvc.errors import ConfigError, FeedbackError, PeerClosedError
from dvc.feedback import (
    Connection,
    DecoderEndpoint,
    EncoderEndpoint,
    Failure,
    connect,
    listen,
    parse_address,
)
from dvc.feedback.messages import encode_message


@contextmanager
def pair(timeout_s: float = 5.0) -> Iterator[tuple[Connection, Connection]]:
    """Yield two connected ends."""
    with listen() as listener:
        far = connect(listener.host, listener.port, timeout_s)
        near = listener.accept(5.0, timeout_s)
    with socket_closer(near), socket_closer(far):
        yield near, far


@contextmanager
def socket_closer(connection: Connection) -> Iterator[None]:
    """Close a connection at once, whatever its peer does."""
    yield
    connection._socket.close()


@contextmanager
def background(action: Callable[[], object]) -> Iterator[None]:
    """Run an action beside a block, and wait for it."""
    thread = threading.Thread(target=action)
    thread.start()
    try:
        yield
    finally:
        thread.join()


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:5000", ("127.0.0.1", 5000)),
        ("camera.local:0", ("camera.local", 0)),
        ("[::1]:65535", ("::1", 65535)),
        (":80", ("localhost", 80)),
        ("[]:80", ("localhost", 80)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    """Names, numbers and bracketed IPv6 hosts with a port are addresses."""
    assert parse_address(text) == address


@pytest.mark.parametrize(
    "text",
    [
        "",
        "host",
        "host:",
        "host:x",
        "host:-1",
        "host:65536",
        "::1:5000",
        "host:٣",
        "h:000080",
        "a:b:1",
        "[::1]",
    ],
)
def test_wrong_addresses_are_refused(text: str) -> None:
    """Anything else is refused in one line that shows it."""
    with pytest.raises(ConfigError, match="must be HOST:PORT"):
        parse_address(text)


def readable(connection: Connection, timeout_s: float = 0.0) -> bool:
    """Say whether there is anything to receive."""
    return bool(select.select([connection._socket], [], [], timeout_s)[0])


def test_bytes_arrive_in_both_directions() -> None:
    """What one end sends the other receives, in as many pieces as it takes."""
    data = bytes(range(256)) * 20000
    with pair() as (near, far):
        received = bytearray()
        with background(lambda: near.send(data)):
            while len(received) < len(data):
                received += far.receive()
        assert received == data
        assert not readable(near)
        far.send(b"thanks")
        assert near.receive() == b"thanks"


def test_endpoints_talk_over_the_loopback() -> None:
    """A greeting goes through a real connection."""
    config = codec_config(VideoConfig(176, 144, 15, 1))
    encoder, decoder = EncoderEndpoint(config), DecoderEndpoint()
    with pair() as (near, far):
        far.send(decoder.bytes_to_send())
        while not encoder.receive(near.receive()):
            continue
        near.send(encoder.bytes_to_send())
        while not decoder.receive(far.receive()):
            continue
    assert decoder.config == config


def test_silence_ends_in_time() -> None:
    """A peer that connects and says nothing is given up after the timeout."""
    words = r"the other side \(.*:\d+\) is silent for 0.2 s"
    with pair(0.2) as (near, _), pytest.raises(FeedbackError, match=words):
        near.receive()


def test_a_peer_that_takes_nothing_is_given_up() -> None:
    """Sending to a peer that never reads ends after the timeout, however much there is to send."""
    with pair(0.2) as (near, _), pytest.raises(FeedbackError, match=r"takes nothing for 0.2 s"):
        near.send(bytes(2**26))


def test_a_slow_peer_that_takes_a_little_is_waited_for() -> None:
    """The timeout is for silence, not for the whole of a long message."""
    data = bytes(2**24)
    with pair(1.0) as (near, far):

        def read_slowly() -> None:
            left = len(data)
            while left:
                left -= len(far.receive())
                time.sleep(0.02)

        with background(read_slowly):
            near.send(data)


def test_a_broken_connection_still_gives_what_came() -> None:
    """Then the reason why it was broken off."""
    with pair() as (near, far):
        far.send(b"last words")
        assert readable(near, 5.0)
        near.break_off(FeedbackError("enough"))
        near.break_off(FeedbackError("a second reason"))
        assert near.is_broken
        assert near.receive() == b"last words"
        with pytest.raises(FeedbackError, match="enough"):
            near.receive()
        with pytest.raises(FeedbackError, match="enough"):
            near.send(b"x")


def test_a_peer_that_goes_away_is_noticed() -> None:
    """A closed connection is an error, in the middle of a message or not, reading or writing."""
    with pair() as (near, far):
        near.send(b"half a mess")
        near.close()
        assert far.receive() == b"half a mess"
        with pytest.raises(FeedbackError, match="closed the connection"):
            far.receive()
    with pair() as (near, far):
        far._socket.close()
        with pytest.raises(PeerClosedError, match="went away"):
            near.send(bytes(2**25))


def test_last_words_arrive_though_bytes_wait() -> None:
    """A failure is read by the peer even if what it sent was not read before closing."""
    with pair() as (near, far):
        far.send(bytes(100000))
        near.send(encode_message(Failure("enough")))
        with background(near.close):
            time.sleep(0.1)
            with pytest.raises(FeedbackError, match="gave up: enough"):
                DecoderEndpoint().receive(far.receive())
            far.close()


def test_closing_does_not_wait_for_a_peer_for_ever() -> None:
    """A peer that neither reads nor closes delays the end by a second at most, and only once."""
    waits_s: list[float] = []

    class Noting(socket.socket):
        def settimeout(self, value: float | None) -> None:
            waits_s.append(value or 0.0)
            super().settimeout(0.01)

    with pair() as (near, _), Connection(Noting(fileno=near._socket.detach())) as noting:
        waits_s.clear()
        noting.close()
        noting.close()
    assert len(waits_s) == 1
    assert 0 < waits_s[0] <= 1


def test_second_peer_is_refused() -> None:
    """Nobody listens any more once the peer is there."""
    with listen() as listener:
        first = connect(listener.host, listener.port)
        accepted = listener.accept(5.0)
    with (
        socket_closer(accepted),
        socket_closer(first),
        pytest.raises(FeedbackError, match=r"nobody listens on 127.0.0.1"),
    ):
        connect("127.0.0.1", listener.port, 0.3)


def test_another_peer_waits_while_the_port_is_open() -> None:
    """Who leaves at once is nobody; the next one is accepted by the same listener."""
    with listen() as listener:
        with socket_closer(connect(listener.host, listener.port)), socket_closer(listener.accept(5.0)):
            pass
        with socket_closer(connect(listener.host, listener.port)), socket_closer(listener.accept(5.0)):
            pass


def test_nobody_comes() -> None:
    """Waiting for a peer ends after its timeout, and with a closed listener."""
    with listen() as open_one, pytest.raises(FeedbackError, match=r"nobody connected .*:\d+ within 0.1 s"):
        open_one.accept(0.1)
    listener = listen()
    listener.close()
    with pytest.raises(FeedbackError, match="cannot accept"):
        listener.accept(0.1)


def test_connecting_waits_for_the_listener() -> None:
    """The decoder may be started before the encoder."""
    with listen() as listener:
        port = listener.port
    accepted: list[Connection] = []

    def listen_late() -> None:
        time.sleep(0.3)
        with listen("127.0.0.1", port) as late:
            accepted.append(late.accept(5.0))

    with background(listen_late):
        connection = connect("127.0.0.1", port, 10.0)
    with socket_closer(connection), socket_closer(accepted[0]):
        connection.send(b"x")
        assert accepted[0].receive() == b"x"


def test_addresses_that_cannot_be_had() -> None:
    """A port in use, a foreign address and what is no name of a host end with one line."""
    with listen() as listener, pytest.raises(FeedbackError, match=r"cannot listen on .*in use"):
        listen(listener.host, listener.port)
    with pytest.raises(FeedbackError, match=r"cannot listen on 192.0.2.1:0"):
        listen("192.0.2.1")
    for host in ("a..b", "x" * 100):
        with pytest.raises(FeedbackError, match="not the name of a host"):
            connect(host, 5000, 0.2)
    with pytest.raises(FeedbackError, match="cannot connect to") as caught:
        connect("line\nnul\0", 5000, 0.2)
    assert "\n" not in str(caught.value)


def test_ports_are_private_by_default() -> None:
    """Without a host only this machine can connect; port 0 takes a free one, which is told."""
    with listen() as listener:
        assert listener.host in ("127.0.0.1", "::1")
        assert listener.port > 0
        assert listener.name.endswith(f":{listener.port}")


def test_a_dead_socket_is_a_feedback_error() -> None:
    """A connection that broke before it was wrapped is an error like any other."""
    unconnected = socket.socket()
    with pytest.raises(FeedbackError, match="went away"):
        Connection(unconnected)
