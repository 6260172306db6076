"""A bad link: it cuts, flips, drops, repeats, moves and trickles bytes.

``python -m benchmarks.hostile.bad_link HOST:PORT`` relays a free port, which it prints.
"""

import sys
import threading
import time
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.slow_link import SlowLink, link_parser, serve_until_interrupted
from dvc.feedback import parse_address

FAULTS = ("cut", "flip", "drop", "repeat", "move", "trickle")
DELAY_S, BITS_PER_SECOND = 0.001, 1e9
_MAX_PAUSE_S = 0.02
_NUM_TRICKLED = 16


class Faults:
    """Makes a fault about every `bytes_apart` bytes; half of the faults affect only a part of a chunk."""

    def __init__(self, bytes_apart: float, seed: int, kinds: Sequence[str] = FAULTS) -> None:
        self.counts = dict.fromkeys(kinds, 0)
        self._bytes_apart = bytes_apart
        self._rng = np.random.default_rng(seed)
        self._lock = threading.Lock()

    def __call__(self, data: bytes) -> Iterator[bytes]:
        """Yield the bytes that replace a chunk; a `ConnectionError` is a cut."""
        with self._lock:
            rng = np.random.default_rng(int(self._rng.integers(2**63)))
        if rng.random() * self._bytes_apart > len(data):
            yield data
            return
        kind = str(rng.choice(list(self.counts)))
        self.counts[kind] += 1
        start, end = (
            sorted(rng.integers(0, len(data) + 1, 2).tolist()) if rng.random() < 0.5 else (0, len(data))
        )
        yield from _pieces(kind, data[:start], data[start:end], data[end:], rng)


def _pieces(kind: str, before: bytes, data: bytes, after: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """Yield the bytes that replace three pieces, with a fault in the middle one."""
    if kind == "flip" and data:
        changed = bytearray(data)
        changed[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        data = bytes(changed)
    elif kind == "drop":
        data = b""
    elif kind == "repeat":
        data += data
    elif kind == "move":
        before, data = data, before
    yield from filter(None, (before,))
    if kind == "cut":
        raise ConnectionError("cut")
    if kind == "trickle":
        for byte in data[:_NUM_TRICKLED]:
            time.sleep(rng.random() * _MAX_PAUSE_S)
            yield bytes([byte])
        data = data[_NUM_TRICKLED:]
    yield from filter(None, (data, after))


def main() -> int:
    """Run the command."""
    parser = link_parser("python -m benchmarks.hostile.bad_link", __doc__)
    parser.set_defaults(delay=DELAY_S, bandwidth=BITS_PER_SECOND)
    parser.add_argument("--bytes-apart", type=float, default=1e5, metavar="N", help="of faults")
    parser.add_argument("--kinds", nargs="+", choices=FAULTS, default=FAULTS, help="of faults; default: all")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    faults = Faults(arguments.bytes_apart, arguments.seed, arguments.kinds)
    link = SlowLink(*parse_address(arguments.address), arguments.delay, arguments.bandwidth, faults)
    serve_until_interrupted(link)
    sys.stdout.write(f"{link.num_connections} connections, {faults.counts}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
