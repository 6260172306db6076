"""The link with delay: bytes leave it in order, and not before their time."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from benchmarks.slow_link import Direction, SlowLink, slow_link

DELAY_S, BITS_PER_SECOND = 0.1, 4e5


@contextmanager
def linked() -> Iterator[tuple[SlowLink, socket.socket, socket.socket]]:
    """Yield a link, its near end and its far end."""
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        slow_link("127.0.0.1", listener.getsockname()[1], DELAY_S, BITS_PER_SECOND) as link,
    ):
        host, _, port = link.address.rpartition(":")
        with socket.create_connection((host, int(port)), 10) as near:
            far, _ = listener.accept()
            with far:
                yield link, near, far


def received(end: socket.socket, num_bytes: int) -> bytes:
    """Read a number of bytes."""
    data = b""
    while len(data) < num_bytes:
        piece = end.recv(2**16)
        assert piece
        data += piece
    return data


def test_bytes_take_their_time_both_ways() -> None:
    """The last byte comes after the time of all bytes and the delay; both ways are independent."""
    data = np.random.default_rng(1).integers(0, 256, 20_000, np.uint8).tobytes()
    with linked() as (link, near, far):
        for sender, receiver in ((near, far), (far, near)):
            started = time.monotonic()
            threading.Thread(target=sender.sendall, args=(data,)).start()
            assert received(receiver, len(data)) == data
            assert time.monotonic() - started >= DELAY_S + 8 * len(data) / BITS_PER_SECOND - 0.01
        assert (link.forth.num_bytes, link.back.num_bytes) == (len(data), len(data))


def test_an_answer_waits_for_both_delays() -> None:
    with linked() as (_, near, far):
        started = time.monotonic()
        near.sendall(b"?")
        assert received(far, 1) == b"?"
        far.sendall(b"!")
        assert received(near, 1) == b"!"
        assert time.monotonic() - started >= 2 * DELAY_S


def test_many_bytes_wait_for_one_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0

    class Clock:
        @staticmethod
        def monotonic() -> float:
            return now_s

        @staticmethod
        def sleep(seconds: float) -> None:
            nonlocal now_s
            now_s += seconds

    monkeypatch.setattr("benchmarks.slow_link.time", Clock)
    direction = Direction(DELAY_S, BITS_PER_SECOND)
    for _ in range(200):
        direction.enter(b"?")
    assert now_s == pytest.approx(200 * 8 / BITS_PER_SECOND)
    assert b"".join(direction.leave() for _ in range(200)) == b"?" * 200
    assert now_s == pytest.approx(200 * 8 / BITS_PER_SECOND + DELAY_S)


def test_ends_close_one_after_the_other() -> None:
    with linked() as (_, near, far):
        near.shutdown(socket.SHUT_WR)
        assert far.recv(1) == b""
        far.sendall(b"bye")
        assert received(near, 3) == b"bye"
        far.close()
        assert near.recv(1) == b""
