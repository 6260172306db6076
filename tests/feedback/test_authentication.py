"""Tokens: who is let in, what is known of what was changed on the way, and where a token is needed."""

import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import ConfigError, FeedbackError
from dvc.feedback import Protection, connect, listen, read_token
from dvc.feedback.authentication import (
    GREETING,
    MAX_PIECE_BYTES,
    NONCE_BYTES,
    PROOF_BYTES,
    SealedSocket,
    authenticate,
)

TOKEN, OTHER = b"correct horse battery", b"correct horse batterz"


def beside(action: Callable[[], object]) -> threading.Thread:
    """Do something at the same time."""
    thread = threading.Thread(target=action)
    thread.start()
    return thread


def refused_by(peer: Callable[[socket.socket], object], within_s: float = 5.0) -> str:
    """Return why an encoder turns a peer away."""
    near, far = socket.socketpair()
    with near, far:
        thread = beside(lambda: peer(far))
        with pytest.raises(FeedbackError) as refused:
            authenticate(near, TOKEN, True, within_s)
        near.close()
        thread.join()
    return str(refused.value)


def test_both_ends_talk_once_both_have_the_token() -> None:
    """Large and small pieces arrive in both directions; what has left the socket is not waited for."""
    with listen("127.0.0.1") as listener:
        far = connect(listener.host, listener.port, 5.0)
        near = listener.accept(5.0, 5.0)
    with near, far:
        thread = beside(lambda: far.protect(Protection(False, TOKEN), 5.0))
        near.protect(Protection(True, TOKEN), 5.0)
        thread.join()
        data = bytes(range(256)) * 3000  # several pieces
        thread = beside(lambda: near.send(data))
        got = b""
        while len(got) < len(data):
            got += far.receive()
        thread.join()
        assert got == data
        far.send(b"ab")
        near._socket.settimeout(5.0)
        assert near._socket.recv(1) == b"a"
        assert near.pending
        assert near.receive() == b"b"
        assert not near.pending


def test_who_has_another_token_is_turned_away() -> None:
    """The decoder learns it first, and proves nothing."""
    errors: list[str] = []

    def decoder(peer: socket.socket) -> None:
        try:
            authenticate(peer, OTHER, False, 5.0)
        except FeedbackError as err:
            errors.append(str(err))
            peer.shutdown(socket.SHUT_WR)

    assert "closed the connection" in refused_by(decoder)
    assert errors == ["the other side does not know the token"]


def test_who_has_no_token_is_turned_away_at_once() -> None:
    """By the first byte that is another; nothing is answered."""
    answers: list[bytes] = []

    def stranger(peer: socket.socket) -> None:
        peer.sendall(b"\x01\x01\x06")
        with suppress(OSError):
            answers.append(peer.recv(100))

    assert refused_by(stranger) == "the other side has no token"
    assert answers in ([], [b""])


def test_who_is_slow_is_turned_away_in_time() -> None:
    """However little it says at a time."""

    def slow(peer: socket.socket) -> None:
        with suppress(OSError):
            for byte in GREETING + bytes(NONCE_BYTES):
                peer.sendall(bytes([byte]))
                time.sleep(0.03)

    assert "too long" in refused_by(slow, within_s=0.3)


def test_what_was_said_in_a_former_run_is_worth_nothing() -> None:
    """Every byte of a decoder that was let in, said again."""
    near, far = socket.socketpair()
    said: list[bytes] = []

    class Recorded(socket.socket):
        def sendall(self, data: bytes, flags: int = 0) -> None:  # type: ignore[override]
            said.append(bytes(data))
            super().sendall(data, flags)

    recorded = Recorded(fileno=far.detach())
    thread = beside(lambda: authenticate(recorded, TOKEN, False, 5.0))
    with near, recorded:
        authenticate(near, TOKEN, True, 5.0)
        thread.join()
    assert len(b"".join(said)) == len(GREETING) + NONCE_BYTES + PROOF_BYTES

    def again(peer: socket.socket) -> None:
        with suppress(OSError):
            peer.sendall(b"".join(said))

    assert refused_by(again) == "the other side does not know the token"


class Sent:
    """Keeps what is sent."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []

    def sendall(self, data: bytes) -> None:
        self.pieces.append(data)


def received(pieces: list[bytes]) -> tuple[bytes, bool]:
    """Return what a decoder gets of sealed pieces, and whether something is wrong with the next."""
    near, far = socket.socketpair()
    found = b""
    with near, far:
        near.sendall(b"".join(pieces))
        near.shutdown(socket.SHUT_WR)
        decoder = SealedSocket(far, b"other key", b"key")
        try:
            while piece := decoder.recv(100):
                found += piece
        except FeedbackError:
            return found, True
    return found, False


@given(st.integers(0, 2), st.sampled_from(["flip", "drop", "repeat", "swap"]), st.data())
def test_what_was_changed_on_the_way_shows(at: int, change: str, data: st.DataObject) -> None:
    """Bits that flip, and pieces that are lost, come twice or in another order; what came before is right."""
    sent = Sent()
    encoder = SealedSocket(sent, b"key", b"other key")  # type: ignore[arg-type]
    for piece in (b"one", b"two", b"three"):
        encoder.send(piece)
    pieces = sent.pieces
    assert received(pieces) == (b"onetwothree", False)
    if change == "flip":
        place = data.draw(st.integers(0, 8 * len(pieces[at]) - 1))
        changed = bytearray(pieces[at])
        changed[place // 8] ^= 1 << place % 8
        pieces[at] = bytes(changed)
    elif change == "drop":
        del pieces[at]
    elif change == "repeat":
        pieces.insert(at, pieces[at])
    else:
        pieces[at], pieces[at - 1] = pieces[at - 1], pieces[at]
    found, is_wrong = received(pieces)
    assert b"onetwothree".startswith(found)
    assert is_wrong or len(found) < len(b"onetwothree")


def test_a_piece_of_any_length_takes_bounded_memory() -> None:
    """A length that no piece has is refused before the piece is waited for."""
    head = (MAX_PIECE_BYTES + 1).to_bytes(4, "big")
    assert received([head]) == (b"", True)


@pytest.mark.parametrize(
    ("content", "good"), [(b" 16 bytes or more\n", True), (b"short", False), (bytes(5000), False)]
)
def test_tokens_are_neither_short_nor_endless(content: bytes, good: bool, tmp_path: Path) -> None:
    """White space around them does not count."""
    path = tmp_path / "token"
    path.write_bytes(content)
    if good:
        assert read_token(path) == content.strip()
    else:
        with pytest.raises(ConfigError, match="from 16 to 4096 bytes"):
            read_token(path)
