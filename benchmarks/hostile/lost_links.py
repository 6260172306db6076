"""Live runs with lost connections: frames, bits and the punctured stream are those of an uncut run.

``python -m benchmarks.hostile.lost_links --cut-every S`` cuts a long run periodically; ``--faults N`` cuts,
flips, drops, repeats, moves and trickles about every N bytes of a run inside TLS. The encoder gets all other
options. `benchmarks.hostile.cuts` cuts many short runs once each.
"""

import argparse
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.hostile.bad_link import BITS_PER_SECOND, DELAY_S, Faults
from benchmarks.results.encoder import looped
from benchmarks.results.harness import clip_source, report_of
from benchmarks.slow_link import SlowLink, slow_link
from dvc.environment import child_environment, python_module
from dvc.feedback import parse_address

PATIENCE_S = 20
ENDING_S = 86400.0
OPENED_BYTES = 400
"""Bytes that pass before the first cut."""
_COUNTS = ("num_reconnections", "groups_sent_again", "bits_asked_again")


class Files(NamedTuple):
    """Files that a decoder writes."""

    video: Path
    punctured: Path
    report: Path

    @classmethod
    def named(cls, folder: Path, name: str) -> "Files":
        """Name them."""
        return cls(*(folder / f"{name}.{ending}" for ending in ("y4m", "dvc", "json")))


class Decoded(NamedTuple):
    """Result of a run."""

    video: bytes
    punctured: bytes
    bits: list[dict[str, int]]

    @classmethod
    def read(cls, files: Files) -> "Decoded":
        """Read the files."""
        rows = report_of(files.report)["per_frame"]
        return cls(files.video.read_bytes(), files.punctured.read_bytes(), [row["bits"] for row in rows])


def source_of(clip: str) -> Path:
    """Return the file of a clip, which may be named itself."""
    return Path(clip) if Path(clip).suffix else clip_source(clip).path


def start(
    module: str, *words: object, stdin: int | None = None, patience_s: int = PATIENCE_S
) -> "subprocess.Popen[str]":
    """Start one end."""
    command = python_module(module, *words, "--patience", patience_s, "--quiet")
    return subprocess.Popen(command, env=child_environment(), stdin=stdin, stderr=subprocess.PIPE, text=True)


def certificate(folder: Path) -> tuple[list[object], list[object]]:
    """Write a certificate for this machine; return the options of the encoder and of the decoder."""
    import trustme

    authority = trustme.CA(key_type=trustme.KeyType.ECDSA)
    chain, authorities = folder / "encoder.pem", folder / "authorities.pem"
    made = authority.issue_cert("127.0.0.1", key_type=trustme.KeyType.ECDSA)
    made.private_key_and_cert_chain_pem.write_to_path(chain)
    authority.cert_pem.write_to_path(authorities)
    return ["--tls-cert", chain], ["--tls-ca", authorities]


class Ends:
    """Encoders and decoders of a video, inside TLS if `tls` is set."""

    def __init__(
        self,
        video: Path,
        folder: Path,
        options: Sequence[object],
        ending_s: float = ENDING_S,
        tls: bool = False,
    ) -> None:
        encoder, self._decoder_options = certificate(folder) if tls else ([], [])
        self._video, self._folder, self._options = video, folder, [*options, *encoder]
        self.ending_s = ending_s  # how long they may take
        self.encoder_report = folder / "encoder.json"

    @contextmanager
    def encoder(
        self, status: int = 0, address: str = "127.0.0.1:0"
    ) -> "Iterator[tuple[subprocess.Popen[str], str]]":
        """Run an encoder during a block, which gets its address; require its exit status."""
        words = [self._video, *self._options, "--serve", address, "--json", self.encoder_report]
        with start("encoder", *words) as process, ThreadPoolExecutor(1) as listening:
            assert process.stderr is not None
            try:
                address = process.stderr.readline().split()[-1]
                # This reads its messages meanwhile.
                end = listening.submit(check_end, process, status, self.ending_s)
                yield process, address
                end.result()
            finally:
                process.kill()

    def decoder(self, address: str, files: Files, *more: object) -> "subprocess.Popen[str]":
        """Start a decoder."""
        outputs = [files.video, "--punctured", files.punctured, "--json", files.report]
        return start("decoder", "--connect", address, *more, *self._decoder_options, *outputs)


def check_end(process: "subprocess.Popen[str]", status: int, within_s: float = ENDING_S) -> str:
    """Wait for the end of a process, and require its exit status; return its messages."""
    _, messages = process.communicate(timeout=within_s)
    if process.returncode != status:
        raise SystemExit(f"an end has status {process.returncode}, not {status}: {messages.strip()[-500:]}")
    return messages


def uncut(ends: Ends, folder: Path) -> tuple[Decoded, int]:
    """Return the result of a run without losses, and the number of bytes that pass."""
    files = Files.named(folder, "uncut")
    with ends.encoder() as (_, address), _linked(address) as link:
        check_end(ends.decoder(link.address, files), 0)
        num_bytes = _passed(link)
    return Decoded.read(files), num_bytes


def _linked(address: str, faults: Faults | None = None) -> AbstractContextManager[SlowLink]:
    options = (faults,) if faults is not None else ()
    return slow_link(*parse_address(address), DELAY_S, BITS_PER_SECOND, *options)


def _passed(link: SlowLink) -> int:
    return link.forth.num_bytes + link.back.num_bytes


def _wait_for(link: SlowLink, num_bytes: int, decoder: "subprocess.Popen[str]") -> None:
    """Wait until a number of bytes have passed."""
    while _passed(link) < num_bytes and decoder.poll() is None:
        time.sleep(0.001)


def run_with_losses(
    ends: Ends, folder: Path, cut: Callable[[SlowLink, "subprocess.Popen[str]"], None], faults: Faults | None
) -> tuple[Decoded, dict[str, Any]]:
    """Run both ends while a function cuts the connection; return the result and its costs."""
    files = Files.named(folder, "cut")
    with ends.encoder() as (_, address), _linked(address, faults) as link:
        decoder = ends.decoder(link.address, files)
        threading.Thread(target=cut, args=(link, decoder), daemon=True).start()
        try:
            check_end(decoder, 0, ends.ending_s)
        finally:
            decoder.kill()
    report = report_of(ends.encoder_report)
    counts = {name: report[name] for name in (*_COUNTS, "away_s")}
    return Decoded.read(files), {**counts, "connections": link.num_connections}


def cut_once(num_bytes: int) -> Callable[[SlowLink, "subprocess.Popen[str]"], None]:
    """Return a function that cuts a link after a number of bytes."""

    def cut(link: SlowLink, decoder: "subprocess.Popen[str]") -> None:
        _wait_for(link, num_bytes, decoder)
        link.cut()

    return cut


def cut_every(pause_s: float) -> Callable[[SlowLink, "subprocess.Popen[str]"], None]:
    """Return a function that cuts a link again and again."""

    def cut(link: SlowLink, decoder: "subprocess.Popen[str]") -> None:
        _wait_for(link, OPENED_BYTES, decoder)
        while decoder.poll() is None:
            time.sleep(pause_s)
            link.cut()

    return cut


def main(words: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser("python -m benchmarks.hostile.lost_links", description=__doc__)
    parser.add_argument("--clip", default="box", help="name of a clip, or a video file; default: box")
    parser.add_argument("--frames", type=int, default=300, help="it is played forwards and backwards")
    parser.add_argument("--cut-every", type=float, metavar="S", help="interval of the cuts")
    parser.add_argument("--faults", type=float, metavar="BYTES", help="between faults of the link")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/lost_links"), help="folder of what is written")
    arguments, options = parser.parse_known_args(words)
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    video = looped(source_of(arguments.clip), folder / "video.mkv", arguments.frames)
    ends = Ends(video, folder, options, tls=arguments.faults is not None)
    expected, num_bytes = uncut(ends, folder)
    print(f"uncut: {num_bytes} bytes of the link, {len(expected.punctured)} of the file", flush=True)
    faults = None if arguments.faults is None else Faults(arguments.faults, arguments.seed)
    started_s = time.monotonic()
    cut = cut_every(arguments.cut_every) if arguments.cut_every else lambda *_: None
    found, counts = run_with_losses(ends, folder, cut, faults)
    if found != expected:
        raise SystemExit("frames or bits are not those of an uncut run")
    taken = {"seconds": round(time.monotonic() - started_s, 1), **counts, **(faults.counts if faults else {})}
    print(
        "same frames and bits; " + ", ".join(f"{name} {value}" for name, value in taken.items()), flush=True
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
