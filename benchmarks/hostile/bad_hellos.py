"""Bad hellos while a good decoder works: whether it gets the same frames, and how much later.

``python -m benchmarks.hostile.bad_hellos`` runs an encoder and a decoder inside TLS, first without and then
with another process that sends bad hellos, spread over the time of the first run. It prints the ratios of
wall time, processor time of both ends, and processor time of the encoder's coding. The encoder gets all other
options. ``--send HOST:PORT`` only sends hellos.
"""

import argparse
import os
import resource
import secrets
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from benchmarks.hostile.lost_links import Decoded, Ends, Files, check_end, source_of
from benchmarks.results.encoder import looped
from benchmarks.results.harness import report_of
from dvc.environment import child_environment, python_module
from dvc.errors import FeedbackError
from dvc.feedback import DecoderEndpoint, Dialler, Protection, parse_address
from dvc.feedback.protection import decoder_context

_CLIENT_HELLO = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"
SILENT_EVERY = 200
"""Period of hellos that are cut and followed by silence."""
_ANSWER_S = 2.0
_HELLO_S = 10.0

Send = Callable[[socket.socket, np.random.Generator], None]


def _words(make: Callable[[np.random.Generator], bytes]) -> Send:
    return lambda peer, rng: peer.sendall(make(rng))


def _no_token(peer: socket.socket, rng: np.random.Generator) -> None:
    """Send a good hello, inside TLS if the encoder uses it, without the token."""
    host, port = peer.getpeername()
    dialler = Dialler(host, port, Protection(decoder_context(None)), _ANSWER_S)
    with dialler.connect(_ANSWER_S) as own:
        own.send(DecoderEndpoint(rng.bytes(16)).bytes_to_send())
        own.receive(_ANSWER_S)


HELLOS: dict[str, Send] = {
    "nothing": _words(lambda _: b""),
    "random bytes": _words(lambda rng: rng.bytes(int(rng.integers(1, 2000)))),
    "another protocol": _words(lambda _: b"GET / HTTP/1.1\r\nHost: camera\r\n\r\n"),
    "TLS": _words(lambda rng: _CLIENT_HELLO + rng.bytes(505)),
    "no TLS": _words(lambda rng: DecoderEndpoint(rng.bytes(16)).bytes_to_send()),
    "half a hello": _words(lambda rng: _CLIENT_HELLO[: int(rng.integers(1, len(_CLIENT_HELLO)))]),
    "no token": _no_token,
}


def send_hellos(address: tuple[str, int], count: int, seconds: float, seed: int) -> dict[str, int]:
    """Send hellos, spread over some time, until the port is closed; return the number of each kind."""
    rng, started_s = np.random.default_rng(seed), time.monotonic()
    sent, silent = dict.fromkeys((*HELLOS, "silence"), 0), list[socket.socket]()
    for number in range(count):
        time.sleep(max(started_s + seconds * number / count - time.monotonic(), 0.0))
        try:
            peer = socket.create_connection(address, _ANSWER_S)
        except OSError:
            break
        if number % SILENT_EVERY == SILENT_EVERY - 1:
            peer.sendall(_CLIENT_HELLO[:5])
            silent.append(peer)
            sent["silence"] += 1
            continue
        kind = list(HELLOS)[number % len(HELLOS)]
        with peer, suppress(OSError, FeedbackError):
            HELLOS[kind](peer, rng)
            peer.shutdown(socket.SHUT_WR)
            while peer.recv(2**16):
                pass
        sent[kind] += 1
    for peer in silent:
        peer.close()
    return sent


class Taken(NamedTuple):
    """What a run takes, in seconds."""

    wall: float
    ends: float  # processor time of both ends, start-up included
    coding: float  # processor time of the encoder's thread


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def good_run(
    ends: Ends, files: Files, token: Sequence[object], hellos: Sequence[object]
) -> tuple[Decoded, Taken]:
    """Run both ends, while hellos are sent if options for them are given."""
    before_s, sender = _children_s(), None
    with ends.encoder() as (_, address):
        started_s = time.monotonic()
        decoder = ends.decoder(address, files, *token)
        if hellos:
            command = python_module(__spec__.name, "--send", address, *hellos)
            sender = subprocess.Popen(command, env=child_environment())
        check_end(decoder, 0)
        wall_s = time.monotonic() - started_s
    taken = Taken(wall_s, _children_s() - before_s, report_of(ends.encoder_report)["coding_cpu_s"])
    if sender is not None and sender.wait():
        raise SystemExit("hellos were not sent")
    return Decoded.read(files), taken


def main(words: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser("python -m benchmarks.hostile.bad_hellos", description=__doc__)
    parser.add_argument("--clip", default="box", help="name of a clip, or a video file; default: box")
    parser.add_argument("--frames", type=int, default=100, help="it is played forwards and backwards")
    parser.add_argument("--count", type=int, default=10_000, help="of hellos; default: %(default)s")
    parser.add_argument(
        "--pairs", type=int, default=3, help="pairs of runs without and with hellos; default: %(default)s"
    )
    parser.add_argument("--send", type=parse_address, metavar="HOST:PORT", help="send hellos, no more")
    parser.add_argument("--seconds", type=float, default=0.0, help="over which hellos are spread")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/bad_hellos"), help="folder of what is written")
    arguments, options = parser.parse_known_args(words)
    if arguments.send is not None:
        os.nice(19)  # other machines would not take time of this one
        sent = send_hellos(arguments.send, arguments.count, arguments.seconds, arguments.seed)
        print(f"{sum(sent.values())} hellos: {sent}", flush=True)
        return 0
    return _compare(arguments, options)


def _compare(arguments: argparse.Namespace, options: Sequence[str]) -> int:
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    video = looped(source_of(arguments.clip), folder / "video.mkv", arguments.frames)
    (folder / "token").write_text(secrets.token_hex(16))
    token = ["--token-file", folder / "token"]
    ends = Ends(video, folder, [*options, *token], tls=True)
    ratios, same = list[Taken](), True
    for pair in range(arguments.pairs):
        expected, alone = good_run(ends, Files.named(folder, "alone"), token, [])
        hellos = ["--count", arguments.count, "--seconds", alone.wall, "--seed", arguments.seed + pair]
        found, beside = good_run(ends, Files.named(folder, "beside"), token, hellos)
        same = same and found == expected
        ratios.append(Taken(*(b / a for a, b in zip(alone, beside, strict=True))))
        print(f"alone {_text(alone)}; with hellos {_text(beside)}; ratio {_text(ratios[-1])}", flush=True)
    middle = Taken(*map(median, zip(*ratios, strict=True)))
    print(f"same frames and bits: {'yes' if same else 'no'}; median ratio {_text(middle)}", flush=True)
    return 0 if same else 1


def _text(taken: Taken) -> str:
    return f"wall {taken.wall:.3f}, processor {taken.ends:.3f}, coding {taken.coding:.3f}"


if __name__ == "__main__":
    sys.exit(main())
