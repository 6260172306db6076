"""TCP transport: addresses, timeouts, peers that misbehave."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from benchmarks.loopback import accept_connection
from dvc.errors import ConfigError, ConnectionLostError, FeedbackError, NobodyListensError
from dvc.feedback import Connection, DecoderEndpoint, Dialler, Failure, listen, parse_address, transport
from dvc.feedback.messages import encode_message


@contextmanager
def pair(timeout_s: float = 5.0) -> Iterator[tuple[Connection, Connection]]:
    """Yield two connected ends."""
    with listen() as listener:
        far = Dialler(listener.host, listener.port, timeout_s=timeout_s).connect(5.0)
        near = accept_connection(listener, timeout_s)
    yield near, far
    for end in (near, far):
        end.close(0.0)


@contextmanager
def background(action: Callable[[], object]) -> Iterator[None]:
    """Run an action beside a block, and wait for it."""
    thread = threading.Thread(target=action)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def receive_all(connection: Connection, size: int) -> bytes:
    """Receive bytes up to a size."""
    received = bytearray()
    while len(received) < size:
        received += connection.receive()
    return bytes(received)


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
    """Names, numbers and bracketed IPv6 hosts with a port are addresses; anything else is refused by name."""
    assert parse_address(text) == address
    wrong = "|host|host:|host:x|host:-1|host:65536|::1:5000|host:\u0663|h:000080|a:b:1|[::1]"
    for other in wrong.split("|"):
        with pytest.raises(ConfigError, match="must be HOST:PORT"):
            parse_address(other)


def test_bytes_arrive_in_both_directions_at_once() -> None:
    data = bytes(range(256)) * 30000
    received: list[bytes] = []

    def _far() -> None:
        far.send(data)
        received.append(receive_all(far, len(data)))

    with pair() as (near, far), background(_far):
        near.send(data)
        assert receive_all(near, len(data)) == data
    assert received == [data]


def test_waiting_ends_in_time_or_with_bytes() -> None:
    """Nothing came in time is no error; other objects may be waited for together with the connection."""
    with pair() as (near, far):
        assert near.receive(0.05) == b""
        assert near.wait(within_s=0.05) == []
        stop, stopping = socket.socketpair()
        with stop, stopping:
            far.send(b"x")
            assert near.wait([stop], 5.0) == [near]
            stopping.send(b"x")
            assert near.wait([stop], 5.0) == [near, stop]
        assert near.receive() == b"x"


def test_waiting_ends_with_a_stop() -> None:
    with listen() as listener:
        stop, stopping = socket.socketpair()
        with stop, stopping:
            far = Dialler(listener.host, listener.port).connect(5.0, stop)
            near = accept_connection(listener, 5.0)
            stopping.send(b"x")
            for action in (far.receive, lambda: far.send(bytes(2**26))):
                with pytest.raises(KeyboardInterrupt):
                    action()
            for end in (near, far):
                end.close(0.0)


def test_a_peer_that_takes_nothing_is_lost() -> None:
    """Sending to a peer that never reads ends after the timeout, however much there is to send."""
    with pair(0.2) as (near, _), pytest.raises(ConnectionLostError, match=r"takes nothing for 0.2 s"):
        near.send(bytes(2**26))


def test_a_slow_peer_that_takes_a_little_is_waited_for() -> None:
    data = bytes(2**24)
    with pair(1.0) as (near, far):

        def read_slowly() -> None:
            left = len(data)
            while left:
                left -= len(far.receive())
                time.sleep(0.02)

        with background(read_slowly):
            near.send(data)


def test_a_dead_peer_is_left_to_the_system() -> None:
    """The system probes a silent peer, so that it is lost after the timeout even while a process is busy."""
    with pair(8.0) as (near, _):
        options = {"TCP_KEEPIDLE": 2, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3, "TCP_USER_TIMEOUT": 8000}
        peer = near._socket
        assert peer.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        for name, value in options.items():
            assert peer.getsockopt(socket.IPPROTO_TCP, getattr(socket, name)) == value


def test_another_thread_breaks_a_connection_off() -> None:
    with pair() as (near, _):
        timer = threading.Timer(0.1, near.break_off, ["enough"])
        timer.start()
        with pytest.raises(ConnectionLostError, match="enough"):
            near.receive()
        near.break_off("a second reason")
        with pytest.raises(ConnectionLostError, match="enough"):
            near.send(b"x")
        assert near.wait() == [near]


def test_a_peer_that_goes_away_is_noticed() -> None:
    """A closed connection is an error, in the middle of a message or not, reading or writing."""
    with pair() as (near, far):
        near.send(b"half a mess")
        near.close(0.0)
        assert far.receive() == b"half a mess"
        with pytest.raises(ConnectionLostError, match="closed the connection"):
            far.receive()
    with pair() as (near, far):
        far.close(0.0)
        with pytest.raises(ConnectionLostError, match=r"went away|closed the connection"):
            near.send(bytes(2**25))


def test_last_words_arrive_though_bytes_wait() -> None:
    with pair() as (near, far):
        far.send(bytes(100000))
        near.send(encode_message(Failure("enough")))
        with background(near.close):
            time.sleep(0.1)
            with pytest.raises(FeedbackError, match="ended the run: enough"):
                DecoderEndpoint(bytes(16)).receive(far.receive())
            far.close(0.0)


def test_closing_does_not_wait_for_a_peer_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair() as (near, _):
        started_s = time.monotonic()
        near.close(0.2)
        near.close(60.0)
        assert 0.1 < time.monotonic() - started_s < 30.0


def test_nobody_listens() -> None:
    with listen() as listener:
        port = listener.port
    with pytest.raises(NobodyListensError, match=r"no program listens on 127.0.0.1"):
        Dialler("127.0.0.1", port).connect(0.3)


def test_addresses_that_cannot_be_had() -> None:
    """A port in use, a foreign address and what is no name of a host end with one line.

    Without a host only this machine can connect; port 0 takes a free one.
    """
    with pytest.raises(ConnectionLostError, match="went away"):
        Connection(socket.socket())
    with listen() as listener:
        assert listener.host in ("127.0.0.1", "::1")
        assert listener.name.endswith(f":{listener.port}")
    with listen() as listener, pytest.raises(FeedbackError, match=r"cannot listen on .*in use"):
        listen(listener.host, listener.port)
    with pytest.raises(FeedbackError, match=r"cannot listen on 192.0.2.1:0"):
        listen("192.0.2.1")
    for host in ("a..b", "x" * 100, "line\nnul\0"):
        with pytest.raises(FeedbackError, match="cannot connect to") as caught:
            Dialler(host, 5000).connect(0.2)
        assert "\n" not in str(caught.value)


def test_data_that_come_while_data_are_sent_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "_MAX_INBOX_BYTES", 2**20)
    with pair(0.3) as (near, far):

        def _flood() -> None:
            with pytest.raises(ConnectionLostError):
                far.send(bytes(2**27))

        with background(_flood), pytest.raises(ConnectionLostError, match="takes nothing"):
            near.send(bytes(2**26))
        assert sum(map(len, near._inbox)) < 2**20 + 2**18
