"""A link with delay and little bandwidth between two processes.

``python -m benchmarks.slow_link HOST:PORT`` listens on any free port, which it prints, and relays
it to HOST:PORT and back, until it is interrupted.
"""

import argparse
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field

from dvc.feedback import parse_address

DELAY_S = 0.1
BITS_PER_SECOND = 1e6
_CHUNK_BYTES = 1024
_MAX_QUEUED_BYTES = 2**16
_WAIT_S = 0.5


@dataclass
class Direction:
    """One way of the link; bytes leave it in order, at the bandwidth, each after the delay."""

    delay_s: float  # from the last bit in to the last bit out, in seconds
    bits_per_second: float  # bandwidth
    num_bytes: int = 0  # bytes that entered, without headers of transport and network
    _free_s: float = 0.0
    _chunks: deque[tuple[float, bytes]] = field(default_factory=deque)
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def renewed(self) -> "Direction":
        """Return the same way for another connection, with the count of bytes."""
        return Direction(self.delay_s, self.bits_per_second, self.num_bytes)

    def enter(self, data: bytes) -> None:
        """Send bytes; return when the line is free again."""
        now = time.monotonic()
        self._free_s = max(self._free_s, now) + 8 * len(data) / self.bits_per_second
        self.num_bytes += len(data)
        with self._changed:
            self._chunks.append((self._free_s + self.delay_s, data))
            self._changed.notify()
        time.sleep(self._free_s - now)

    def leave(self) -> bytes:
        """Wait for the next bytes, and return them."""
        with self._changed:
            while not self._chunks:
                self._changed.wait(_WAIT_S)
            due_s, data = self._chunks.popleft()
        time.sleep(max(0.0, due_s - time.monotonic()))
        return data


Change = Callable[[bytes], Iterable[bytes]]
"""Function that replaces received bytes."""


class SlowLink:
    """Relays connections to another port, slowly both ways, with changes if `change` is given."""

    def __init__(
        self,
        host: str,
        port: int,
        delay_s: float = DELAY_S,
        bits_per_second: float = BITS_PER_SECOND,
        change: Change = lambda data: (data,),
    ) -> None:
        self.forth = Direction(delay_s, bits_per_second)  # from the far end to the last peer
        self.back = Direction(delay_s, bits_per_second)
        self.num_connections = 0
        self.is_down = False  # new connections are closed at once
        self._change = change
        self._far = host, port
        self._ends: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listening.getsockname()[1]}"

    def serve(self) -> None:
        """Relay connections until the link is closed."""
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            if self.is_down:
                near.close()
                continue
            self.num_connections += 1
            self.forth, self.back = self.forth.renewed(), self.back.renewed()
            work = self._pass_on, (near, self.forth, self.back)
            threading.Thread(target=work[0], args=work[1], daemon=True).start()

    def close(self) -> None:
        """Take no further connections."""
        _shut(self._listening)
        self._listening.close()

    def cut(self) -> None:
        """End all connections."""
        for end in tuple(self._ends):
            _shut(end)

    def go_down(self) -> None:
        """End all connections, and take none until it is up again."""
        self.is_down = True
        self.cut()

    def _pass_on(self, near: socket.socket, forth: Direction, back: Direction) -> None:
        """Relay one connection until both ends have closed it."""
        with near, suppress(OSError), socket.create_connection(self._far) as far:
            ends = {near, far}
            self._ends |= ends
            for end in ends:
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _MAX_QUEUED_BYTES)
            threads = [
                threading.Thread(target=work, args=arguments, daemon=True)
                for direction, first, last in ((back, near, far), (forth, far, near))
                for work, arguments in (
                    (self._take_in, (direction, first, last)),
                    (_give_out, (direction, last)),
                )
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            self._ends -= ends

    def _take_in(self, direction: Direction, end: socket.socket, other: socket.socket) -> None:
        data = b"."
        while data:
            data = b""
            with suppress(OSError):
                data = end.recv(_CHUNK_BYTES)
            try:
                for changed in self._change(data) if data else (b"",):
                    direction.enter(changed)
            except ConnectionError:
                direction.enter(b"")
                _shut(end)
                _shut(other)
                return


def _shut(end: socket.socket) -> None:
    with suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)


def _give_out(direction: Direction, end: socket.socket) -> None:
    with suppress(OSError):
        while data := direction.leave():
            end.sendall(data)
        end.shutdown(socket.SHUT_WR)


@contextmanager
def slow_link(
    host: str,
    port: int,
    delay_s: float = DELAY_S,
    bits_per_second: float = BITS_PER_SECOND,
    change: Change = lambda data: (data,),
) -> Iterator[SlowLink]:
    """Run a link during a block."""
    link = SlowLink(host, port, delay_s, bits_per_second, change)
    threading.Thread(target=link.serve, daemon=True).start()
    with closing(link):
        yield link


def link_parser(prog: str, description: str | None) -> argparse.ArgumentParser:
    """Return a parser of the options of a link."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("address", metavar="HOST:PORT")
    parser.add_argument("--delay", type=float, default=DELAY_S, metavar="S", help="of each way")
    parser.add_argument("--bandwidth", type=float, default=BITS_PER_SECOND, metavar="BITS_PER_SECOND")
    return parser


def serve_until_interrupted(link: SlowLink) -> None:
    """Print the address of the link, and relay connections."""
    sys.stdout.write(f"{link.address}\n")
    sys.stdout.flush()
    with suppress(KeyboardInterrupt):
        link.serve()


def main() -> int:
    """Run the command."""
    arguments = link_parser("python -m benchmarks.slow_link", __doc__).parse_args()
    link = SlowLink(*parse_address(arguments.address), arguments.delay, arguments.bandwidth)
    serve_until_interrupted(link)
    sys.stdout.write(f"{link.forth.num_bytes} bytes forth, {link.back.num_bytes} back\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
