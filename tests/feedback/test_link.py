"""Links over the loopback: signs of life, patience, and connections that are lost."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from typing import cast

import pytest

from benchmarks.loopback import accepted
from benchmarks.slow_link import SlowLink, slow_link
from dvc.errors import FeedbackError, PeerClosedError, RefusedError, SupersededError, UntrustedError
from dvc.feedback import (
    Connection,
    Link,
    Listener,
    Protection,
    authentication,
    connect,
    dial,
    link,
    listen,
)
from dvc.feedback.opening import NEW, Opening, read_opening, refuse
from tests.raw_links import RawLink
from tests.waiting import wait_until

PROTECTIONS = {"plain": None, "token": b"a token of some length"}


def answering(listener: Listener, near: Link, token: bytes | None = None) -> None:
    """Let a decoder come back as often as it likes."""
    with suppress(FeedbackError):
        while True:
            connection = listener.accept(None, 5.0)
            try:
                connection.protect(Protection(True, token), 5.0)
                asked = connection.talk(lambda peer: read_opening(peer, time.monotonic() + 5.0))
                near.resume(connection, asked)
            except FeedbackError:
                connection.close_within(0.0)


@contextmanager
def pair(
    timeout_s: float = 5.0, patience_s: float = 0.0, token: bytes | None = None
) -> Iterator[tuple[Link, Link, SlowLink]]:
    """Yield an encoder's end and a decoder's, and what is between them."""
    ends: list[Link] = []

    def welcome_first() -> None:
        connection = listener.accept(5.0, timeout_s)
        connection.protect(Protection(True, token), 5.0)
        asked = connection.talk(lambda peer: read_opening(peer, time.monotonic() + 5.0))
        ends.append(link.welcome(connection, asked, timeout_s, patience_s))

    with ExitStack() as stack:
        listener = stack.enter_context(listen("127.0.0.1"))
        between = stack.enter_context(slow_link(listener.host, listener.port, 0.0, 1e9))
        first = threading.Thread(target=welcome_first)
        first.start()
        host, _, port = between.address.rpartition(":")
        far = stack.enter_context(dial(host, int(port), timeout_s, Protection(False, token), patience_s))
        first.join()
        near = stack.enter_context(ends[0])
        near.keep_alive()
        far.keep_alive()
        threading.Thread(target=answering, args=(listener, near, token), daemon=True).start()
        yield near, far, between
        stack.callback(between.cut)


def got(end: Link, num_bytes: int) -> bytes:
    """Receive so many bytes."""
    data = b""
    while len(data) < num_bytes:
        data += end.receive()
    return data


def until_it_fails(end: Link) -> None:
    """Receive until there is nothing more to be received."""
    while True:
        end.receive()


def test_bytes_arrive_in_both_directions() -> None:
    """As many as are sent, and what can be received at once is told."""
    data = bytes(range(256)) * 4000
    with pair() as (near, far, _):
        sending = threading.Thread(target=near.send, args=(data,))
        sending.start()
        assert got(far, len(data)) == data
        sending.join()
        far.send(b"thanks")
        assert near.wait(at_most_s=5.0) == [near]
        assert got(near, 6) == b"thanks"


@pytest.mark.parametrize("token", PROTECTIONS.values(), ids=PROTECTIONS)
def test_bytes_arrive_once_whatever_is_cut(token: bytes | None) -> None:
    """Each end sends while the connection is cut again and again; the other gets it all in order."""
    data = bytes(range(256)) * 400
    with pair(patience_s=20.0, token=token) as (near, far, between):
        found: dict[str, bytes] = {}

        def receive(name: str, end: Link) -> None:
            found[name] = got(end, 12 * len(data))
            while len(found) < 2:  # whoever has all must come back for the other
                if end.wait(at_most_s=0.05):  # that the connection is lost shows in what is received
                    end.receive()

        def send(end: Link) -> None:
            for _ in range(12):
                end.send(data)
                time.sleep(0.05)

        threads = [
            *(threading.Thread(target=receive, args=each) for each in (("near", near), ("far", far))),
            *(threading.Thread(target=send, args=(end,)) for end in (near, far)),
        ]
        for thread in threads:
            thread.start()
        num_bytes = 0
        while any(thread.is_alive() for thread in threads):
            time.sleep(0.11)
            if (passed := between.forth.num_bytes + between.back.num_bytes) > num_bytes:
                between.cut()
                num_bytes = passed + len(data)  # on a slow machine, too, something arrives in between
        assert found == {"near": 12 * data, "far": 12 * data}
        assert far.counts.num_reconnections > 0
        assert far.counts.away_s > 0.0


def test_without_patience_a_cut_ends_the_link() -> None:
    """At both ends, as ever."""
    with pair() as (near, far, between):
        between.cut()
        for end in (near, far):
            with pytest.raises(FeedbackError, match=r"closed the connection|went away"):
                until_it_fails(end)


def test_damage_behind_what_is_good_is_noticed_at_once() -> None:
    """Though the other side says nothing more."""

    def say(peer: socket.socket) -> None:
        raw = RawLink.of_encoder(peer)
        raw.stream.keep(b"good")
        peer.sendall(raw.stream.pieces() + bytes(10))
        while peer.recv(2**12):
            continue

    def serve() -> None:
        with listener.accept(5.0) as connection:
            connection.talk(lambda peer: say(cast(socket.socket, peer)))

    with listen("127.0.0.1") as listener, ThreadPoolExecutor(1) as work:
        serving = work.submit(serve)
        with dial(listener.host, listener.port, 20.0) as far:
            assert got(far, 4) == b"good"
            with pytest.raises(FeedbackError, match="changed on the way"):
                until_it_fails(far)
        serving.result()


def test_patience_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nobody comes back; what is sent meanwhile is kept."""
    with listen("127.0.0.1") as listener:
        ends: list[Link] = []
        thread = threading.Thread(target=lambda: ends.append(accepted(listener, 5.0, 0.5)))
        thread.start()
        far = dial(listener.host, listener.port, 5.0, patience_s=0.5)
        thread.join()
    with ends[0] as near, far:
        assert far._connection is not None
        far._connection.break_off(FeedbackError("cut"))
        started_s = time.monotonic()
        far.send(b"kept")
        for end in (near, far):
            with pytest.raises(FeedbackError, match=r"it has not come back for 0.5 s"):
                until_it_fails(end)
        assert time.monotonic() - started_s >= 0.45


def test_while_the_other_side_is_away_others_are_waited_for() -> None:
    """So that a decoder goes on with what it has."""
    with pair(patience_s=20.0) as (_, far, between), listen() as other:
        other_end = connect(other.host, other.port, 5.0)
        with other_end, other.accept(5.0) as waiting:
            between.close()
            between.cut()
            while far._connection is not None:
                if far.wait(at_most_s=0.1):
                    far.receive()
            assert far.wait([waiting], at_most_s=0.05) == []
            other_end.send(b"x")
            wait_until(lambda: far.wait([waiting], at_most_s=1.0) == [waiting])


def test_a_side_at_work_is_kept_alive() -> None:
    """A link that has nothing to say for long gives signs of life; one that does not is lost."""
    with pair(timeout_s=0.6) as (near, far, _):
        started_s = time.monotonic()
        while time.monotonic() - started_s < 1.5:
            assert far.receive() == b""
        near._closed.set()
        with pytest.raises(FeedbackError, match=r"is silent for 0.6 s"):
            until_it_fails(far)


def test_a_bounded_wait_is_no_silence() -> None:
    """Who waits for a moment gets nothing and goes on."""
    with pair() as (near, far, _):
        far._closed.set()
        wait_until(lambda: not near.wait(at_most_s=0.05) or near.receive())
        assert near.wait(patient=True, at_most_s=0.05) == []


def test_what_was_sent_is_delivered_before_the_end() -> None:
    """Also over another connection; and where nobody listens any more, nobody is waited for."""
    with pair(patience_s=20.0) as (near, far, between):
        far.send(b"last words")
        between.cut()
        thread = threading.Thread(target=far.deliver)
        thread.start()
        assert got(near, 10) == b"last words"
        with suppress(FeedbackError):
            while thread.is_alive():
                near.wait(at_most_s=0.1)
                near.has_received() and near.receive()
        thread.join()
        assert far._stream.num_kept == 0
        far.send(b"to nobody")
        between.close()
        near.close()
        started_s = time.monotonic()
        far.deliver()
        assert time.monotonic() - started_s < 10.0


def test_what_is_kept_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who sends more waits for the other side, and gives up where that does not acknowledge anything."""
    monkeypatch.setattr(link, "MAX_KEPT_BYTES", 1000)
    with pair(timeout_s=0.6, patience_s=0.5) as (near, far, _):
        near.send(bytes(900))
        assert got(far, 900) == bytes(900)
        near.send(bytes(5000))  # once the first have been acknowledged
        with pytest.raises(FeedbackError, match=r"does not say to have what was sent|has not come back"):
            near.send(bytes(5000))  # nobody receives the ones before


def intruder(listener: Listener, said: Opening) -> Connection:
    connection = connect(listener.host, listener.port, 5.0)
    connection.talk(lambda peer: peer.sendall(said.encode()))
    return connection


@pytest.mark.parametrize("num_received", [1, 2**40])
def test_hostile_resumption_leaves_the_good_peer_unharmed(num_received: int) -> None:
    """Who knows the name of the stream, but not how far it is, is refused; the connection stays."""
    with pair(patience_s=5.0) as (near, far, _):
        with listen("127.0.0.1") as listener:
            bad = intruder(listener, Opening(near.session, num_received))
            connection = listener.accept(5.0)
            asked = connection.talk(lambda peer: read_opening(peer, time.monotonic() + 5.0))
            with bad, connection, pytest.raises(FeedbackError, match="wants to go on after"):
                near.resume(connection, asked)
        near.send(b"unharmed")
        assert got(far, 8) == b"unharmed"
        assert near.counts.num_reconnections == 0


def opening_server(work: Callable[[Connection, Opening], None], listener: Listener) -> threading.Thread:
    def serve() -> None:
        with listener.accept(5.0) as connection:
            work(connection, connection.talk(lambda peer: read_opening(peer, time.monotonic() + 5.0)))

    thread = threading.Thread(target=serve)
    thread.start()
    return thread


def test_a_refusal_tells_why() -> None:
    """In one line, however it is written."""
    with listen("127.0.0.1") as listener:
        reason = "no\nroom " * 100
        thread = opening_server(lambda c, _: c.talk(lambda peer: refuse(peer, reason)), listener)
        with pytest.raises(RefusedError, match="does not let this decoder in: no room no room") as caught:
            dial(listener.host, listener.port, 5.0)
        thread.join()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "said", [b"", b"HTTP/1.1 400 Bad Request\r\n", Opening(NEW).encode()[:20] + bytes(20)]
)
def test_what_is_no_encoder_is_noticed(said: bytes) -> None:
    """It closes, speaks another protocol, or what it says is damaged."""
    with listen("127.0.0.1") as listener:
        thread = opening_server(lambda c, _: c.talk(lambda peer: peer.sendall(said)), listener)
        with pytest.raises(FeedbackError, match=r"closed the connection|another protocol|changed on the way"):
            dial(listener.host, listener.port, 5.0)
        thread.join()


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (authentication.GREETING, "the other side wants a token, and this one has none"),
        (b"\x16\x03\x01", "the other side wants TLS, and this one has no certificate"),
        (b"DV3D view 1\n", "the other side speaks another protocol"),
        (b"DV2", "the other side speaks another protocol"),
    ],
)
def test_who_wants_what_this_side_lacks_is_told_from_strangers(said: bytes, told: str) -> None:
    """By the first byte that is another."""
    near, far = socket.socketpair()
    near.sendall(said)
    with near, far, pytest.raises(UntrustedError) as caught:
        read_opening(far, time.monotonic() + 5.0)
    assert str(caught.value) == told


def losing_server(listener: Listener, said: list[bytes], ends: list[Link]) -> threading.Thread:
    """Say something to one who connects after the other, and close; welcome the last."""

    def serve() -> None:
        for words in said:
            with listener.accept(5.0) as connection:
                connection.talk(lambda peer: read_opening(peer, time.monotonic() + 5.0))
                connection.send(words)
        ends.append(accepted(listener, 5.0, 5.0))

    thread = threading.Thread(target=serve)
    thread.start()
    return thread


def test_a_first_connection_that_is_lost_is_tried_again() -> None:
    """However much of the answer had come; it is told once."""
    told: list[FeedbackError] = []
    ends: list[Link] = []
    answer = Opening(bytes(range(16))).encode()
    damaged = answer[:-1] + bytes([answer[-1] ^ 1])
    with listen("127.0.0.1") as listener:
        thread = losing_server(listener, [b"", answer[:20], damaged], ends)
        far = dial(listener.host, listener.port, 5.0, patience_s=20.0, lost=told.append)
        thread.join()
        with far, ends[0] as near:
            near.send(b"welcome")
            assert got(far, 7) == b"welcome"
            assert far.counts.num_reconnections == 0
    assert [type(err) for err in told] == [PeerClosedError]


def test_a_first_connection_is_not_tried_for_longer_than_patience_lasts() -> None:
    """And not at all without any."""
    for patience_s, num_told in ((0.0, 0), (0.5, 1)):
        told: list[FeedbackError] = []
        with listen("127.0.0.1") as listener, slow_link(listener.host, listener.port) as between:
            between.is_down = True
            host, _, port = between.address.rpartition(":")
            with pytest.raises(FeedbackError, match=r"closed the connection|went away"):
                dial(host, int(port), 5.0, patience_s=patience_s, lost=told.append)
        assert len(told) == num_told


@pytest.mark.parametrize("said", [b"HTTP/1.1 400 Bad Request\r\n", Opening(NEW, 4).encode() + b"full"])
def test_who_is_no_encoder_or_refuses_is_asked_once(said: bytes) -> None:
    """Patience would change nothing."""
    with listen("127.0.0.1") as listener:
        thread = opening_server(lambda c, _: c.talk(lambda peer: peer.sendall(said)), listener)
        with pytest.raises(
            (UntrustedError, RefusedError), match=r"another protocol|let this decoder in: full"
        ):
            dial(listener.host, listener.port, 5.0, patience_s=20.0)
        thread.join()


def test_an_encoder_that_goes_on_with_another_stream_ends_the_link() -> None:
    """There is nothing to wait for."""
    with pair(patience_s=20.0) as (near, far, between):
        near.session = bytes(range(16))
        between.cut()
        with pytest.raises(RefusedError, match="another stream"):
            until_it_fails(far)


def test_a_link_that_is_superseded_says_so() -> None:
    """Whatever it waits for."""
    with pair(patience_s=20.0) as (near, _, _):
        threading.Timer(0.1, near.supersede).start()
        with pytest.raises(SupersededError):
            until_it_fails(near)
