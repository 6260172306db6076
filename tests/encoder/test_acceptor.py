"""Acceptance of a decoder: strangers, second decoders, and the decoder that comes back."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from benchmarks.hostile.lost_links import certificate
from benchmarks.loopback import accepted, accepting
from dvc.config import VideoConfig, codec_config
from dvc.errors import ConnectionLostError, NobodyListensError, RefusedError
from dvc.feedback import Connection, DecoderEndpoint, Dialler, Protection
from dvc.feedback.protection import decoder_context, encoder_context
from encoder import acceptor
from encoder.acceptor import MAX_GREETINGS, PeerAcceptor
from tests.waiting import wait_until

CONFIG = codec_config(VideoConfig(32, 24, 25, 1, luma_only=True), "2d")
ID, TOKEN = bytes(range(16)), b"a token of some length"
HELLO = DecoderEndpoint(ID).bytes_to_send()
CLIENT_HELLO = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"


@contextmanager
def opened(
    patience_s: float = 20.0, protection: Protection | None = None
) -> Iterator[tuple[PeerAcceptor, tuple[str, int], list[str]]]:
    """Yield an acceptor, its address, and the lines that it logs."""
    lines: list[str] = []
    with accepting(CONFIG, 5.0, patience_s, protection, lines) as (listener, peers):
        yield peers, (listener.host, listener.port), lines


def welcomed(connection: Connection, endpoint: DecoderEndpoint) -> DecoderEndpoint:
    """Say hello, and wait for the welcome."""
    connection.send(endpoint.bytes_to_send())
    while not endpoint.is_welcome:
        endpoint.receive(connection.receive(10.0))
    return endpoint


def greet(
    address: tuple[str, int], endpoint: DecoderEndpoint, protection: Protection | None = None
) -> Connection:
    """Connect, and exchange the hello and the welcome."""
    connection = Dialler(*address, protection or Protection(), 5.0).connect(5.0)
    try:
        welcomed(connection, endpoint)
    except BaseException:
        connection.close(0.0)
        raise
    return connection


@pytest.fixture(scope="module")
def protections(tmp_path_factory: pytest.TempPathFactory) -> tuple[Protection, Protection]:
    """Return the protections of the encoder and of the decoder, by TLS with a token."""
    (_, chain), (_, authorities) = certificate(tmp_path_factory.mktemp("certificates"))
    assert isinstance(chain, Path)
    assert isinstance(authorities, Path)
    return Protection(encoder_context(chain), TOKEN), Protection(decoder_context(authorities), TOKEN)


def trickle(peer: socket.socket, data: bytes) -> None:
    """Say a little all the time until the other side has enough."""
    try:
        for byte in data:
            peer.sendall(bytes([byte]))
            time.sleep(0.02)
    except OSError:
        return


@pytest.mark.parametrize("tls", [False, True], ids=["plain", "TLS"])
@pytest.mark.parametrize(
    "words", [b"", HELLO[:5], HELLO[:5] + bytes(4000), CLIENT_HELLO + bytes(500), b"\x01\x01\x06"]
)
def test_strangers_hold_up_nobody(
    words: bytes, tls: bool, monkeypatch: pytest.MonkeyPatch, protections: tuple[Protection, Protection]
) -> None:
    """Silent, or dripping, they are rejected by the deadline; a decoder is accepted beside them."""
    monkeypatch.setattr(acceptor, "HELLO_S", 2.0)
    ours, theirs = protections if tls else (Protection(), Protection())
    started_s = time.monotonic()
    with opened(protection=ours) as (peers, address, lines), socket.create_connection(address) as first:
        slow = threading.Thread(target=trickle, args=(first, words))
        slow.start()
        with greet(address, DecoderEndpoint(ID, token=theirs.token), theirs), accepted(peers).connection:
            wait_until(lambda: lines)
        assert time.monotonic() - started_s < 60.0
        first.close()
        slow.join()
    assert len(lines) == 1
    assert lines[0].startswith("not a decoder: ")


def test_many_strangers_do_not_lock_a_decoder_out(protections: tuple[Protection, Protection]) -> None:
    ours, theirs = protections
    with opened(protection=ours) as (peers, address, lines):
        strangers = [socket.create_connection(address) for _ in range(MAX_GREETINGS + 8)]
        for stranger in strangers:
            stranger.send(CLIENT_HELLO[:5])
        with greet(address, DecoderEndpoint(ID, token=TOKEN), theirs), accepted(peers).connection:
            assert any("too many peers wait" in line for line in lines)
        for stranger in strangers:
            stranger.close()


def test_rejections_are_counted_if_there_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(acceptor, "MAX_LINES", 3)
    with opened() as (_, address, lines):

        def stranger() -> None:
            with Dialler(*address).connect(5.0) as connection:
                connection.send(b"\x01\x01\x06")
                with pytest.raises(RefusedError, match=r"version 6; this program speaks"):
                    welcomed(connection, DecoderEndpoint(ID))

        for _ in range(9):
            stranger()
        wait_until(lambda: len(lines) == 5)
    assert lines[2].endswith("still waiting")
    assert all(line.endswith(f" ({n} rejected)") for n, line in zip((4, 8), lines[3:], strict=True))


def test_a_hello_in_pieces_is_accepted() -> None:
    with opened() as (peers, address, lines), Dialler(*address).connect(5.0) as far:
        far.send(HELLO[:2])
        time.sleep(0.1)
        far.send(HELLO[2:])
        with accepted(peers).connection:
            assert lines == []


@pytest.mark.parametrize("token", [b"", b"another token of that length", TOKEN[:-1]])
def test_a_wrong_token_is_refused(token: bytes, protections: tuple[Protection, Protection]) -> None:
    ours, theirs = protections
    with opened(protection=ours) as (peers, address, lines):
        with pytest.raises(RefusedError, match="the token is wrong"):
            greet(address, DecoderEndpoint(ID, token=token), theirs)
        with greet(address, DecoderEndpoint(ID, token=TOKEN), theirs), accepted(peers).connection:
            assert len(lines) == 1


def test_a_second_decoder_is_refused() -> None:
    with opened() as (peers, address, lines):
        with (
            greet(address, DecoderEndpoint(ID)),
            accepted(peers).connection,
            pytest.raises(RefusedError, match="another decoder is served"),
        ):
            greet(address, DecoderEndpoint(bytes(16)))
        with pytest.raises(RefusedError, match="another decoder is served"):
            greet(address, DecoderEndpoint(bytes(16)))
        wait_until(lambda: len(lines) == 2)


def test_the_decoder_comes_back() -> None:
    """Its former connection is broken off at once, also if nothing showed that it was lost."""
    with opened() as (peers, address, lines), greet(address, DecoderEndpoint(ID)):
        first = accepted(peers)
        peers.first_frame = {3: 7}.get
        with pytest.raises(RefusedError, match="no decoder can continue here after 2 groups"):
            greet(address, DecoderEndpoint(ID, 2, 5))
        assert first.connection.receive(0.0) == b""
        with greet(address, DecoderEndpoint(ID, 3, 7)):
            second = accepted(peers)
            with pytest.raises(ConnectionLostError, match="the decoder has come back as"):
                first.connection.receive(10.0)
            assert second.endpoint.hello is not None
            assert second.endpoint.hello.num_groups == 3
            for peer in (first, second):
                peer.connection.close(0.0)
        wait_until(lambda: len(lines) == 1)


def test_without_patience_the_port_is_closed_after_the_first() -> None:
    with opened(0.0) as (peers, address, _), greet(address, DecoderEndpoint(ID)), accepted(peers).connection:
        wait_until(lambda: not peers._thread.is_alive())
        with pytest.raises(NobodyListensError):
            greet(address, DecoderEndpoint(ID))


def test_closing_ends_the_thread() -> None:
    with opened() as (peers, address, _), socket.create_connection(address) as stranger:
        stranger.send(HELLO[:3])
        peers.close()
        assert not peers._thread.is_alive()
        stranger.settimeout(10.0)
        assert stranger.recv(100) == b""
