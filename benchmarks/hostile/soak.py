"""A long live run that loses its connection again and again: memory of both ends, and missing frames.

``python -m benchmarks.hostile.soak`` plays a clip forwards and backwards to an encoder, at the pace of a
camera by a pipe, and cuts the link every so often; with ``--away`` it is down for half of that time. Frames
that the queue does not hold are left out. The encoder gets all other options.
"""

import argparse
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.hostile.bad_link import BITS_PER_SECOND, DELAY_S
from benchmarks.hostile.lost_links import PATIENCE_S, Files, check_end, source_of, start
from benchmarks.results.encoder import MIB, looped
from benchmarks.results.harness import report_of
from benchmarks.slow_link import SlowLink, slow_link
from dvc.feedback import parse_address
from dvc.video import Frame, open_video

SAMPLE_S = 1.0
MAX_LATE_S = 0.5
"""Largest delay of a frame that is caught up, after the pipe was full."""
PARTS = 4
"""Number of parts of a run; the first and the last are compared."""


class Sample(NamedTuple):
    """Memory of both ends with their processes, in MiB."""

    encoder: float
    decoder: float


def processes(pid: int) -> Iterator[int]:
    """Return a process and its running descendants.

    A process that has not loaded its program yet has the memory of its parent, and is not counted.
    """
    yield pid
    with suppress(OSError):
        own = Path(f"/proc/{pid}/cmdline").read_bytes()
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            for child in map(int, children.read_text().split()):
                with suppress(OSError):
                    if Path(f"/proc/{child}/cmdline").read_bytes() != own:
                        yield from processes(child)


def resident_mib(pid: int) -> float:
    """Return the resident memory of a process and of its descendants."""
    num_pages = 0
    for each in processes(pid):
        with suppress(OSError):
            num_pages += int(Path(f"/proc/{each}/statm").read_text().split()[1])
    return num_pages * os.sysconf("SC_PAGE_SIZE") / MIB


def play(frames: Iterable[Frame], rate: Fraction, pipe: "subprocess.Popen[str]") -> None:
    """Write frames to the input of a process, each when it is due."""
    assert pipe.stdin is not None
    due_s = time.monotonic()
    with open(os.dup(pipe.stdin.fileno()), "wb") as raw:
        pipe.stdin.close()
        pipe.stdin = None
        for frame in frames:
            due_s = max(due_s + float(1 / rate), time.monotonic() - MAX_LATE_S)
            time.sleep(max(due_s - time.monotonic(), 0.0))
            raw.write(b"".join(plane.tobytes() for plane in (frame.luma, *(frame.chroma or ()))))
            raw.flush()


@contextmanager
def disturbed(link: SlowLink, every_s: float, away: bool) -> Iterator[None]:
    """Cut a link periodically during a block; it may be down for half of the time."""
    ended = threading.Event()

    def cut() -> None:
        while not ended.wait(every_s / 2 if away else every_s):
            link.go_down()
            if away:
                ended.wait(every_s / 2)
            link.is_down = False

    thread = threading.Thread(target=cut)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def run(arguments: argparse.Namespace, options: Sequence[str]) -> str:
    """Run both ends; return a report."""
    folder: Path = arguments.out
    files, report, samples = Files.named(folder, "soak"), folder / "encoder.json", list[Sample]()
    patience_s = max(PATIENCE_S, math.ceil(arguments.cut_every))
    with open_video(looped(source_of(arguments.clip), folder / "video.mkv", arguments.frames)) as video:
        rate = arguments.rate or video.info.frame_rate
        words = ["-", "--size", f"{video.info.width}x{video.info.height}", "--frame-rate", rate, *options]
        words += ["--serve", "127.0.0.1:0", "--leave-out", "--json", report]
        with (
            start("encoder", *words, stdin=subprocess.PIPE, patience_s=patience_s) as encoder,
            ThreadPoolExecutor(3) as work,
        ):
            assert encoder.stderr is not None
            address = parse_address(encoder.stderr.readline().split()[-1])
            with slow_link(*address, DELAY_S, BITS_PER_SECOND) as link:
                outputs = ["--connect", link.address, files.video, "--json", files.report]
                decoder = start("decoder", *outputs, patience_s=patience_s)
                playing = work.submit(play, video, Fraction(rate), encoder)
                ends = [work.submit(check_end, end, 0) for end in (encoder, decoder)]
                with disturbed(link, arguments.cut_every, arguments.away):
                    while not all(end.done() for end in ends):
                        samples.append(Sample(resident_mib(encoder.pid), resident_mib(decoder.pid)))
                        time.sleep(SAMPLE_S)
                playing.result()
                for end in ends:
                    end.result()
    num_decoded = len(report_of(files.report)["per_frame"])
    return _report(samples, report_of(report), num_decoded, arguments.frames)


def _report(samples: Sequence[Sample], report: dict[str, Any], num_decoded: int, num_frames: int) -> str:
    quarter = max(len(samples) // PARTS, 1)
    first, last = (
        [max(values) for values in zip(*part, strict=True)]
        for part in (samples[:quarter], samples[-quarter:])
    )
    left_out = report["left_out"]
    return "\n".join(
        (
            f"frames: {num_frames} played, {num_decoded} decoded, {left_out['frames']} left out in"
            f" {left_out['gaps']} gap(s)",
            f"connections: {report['num_reconnections']} lost, {report['away_s']:.1f} s away,"
            f" {report['groups_sent_again']} groups sent again, {report['bits_asked_again']} bits",
            f"encoder: at most {first[0]:.0f} MiB in the first quarter of {len(samples)} samples,"
            f" {last[0]:.0f} in the last; decoder {first[1]:.0f}, {last[1]:.0f}",
        )
    )


def main(words: Sequence[str] | None = None) -> int:
    """Run the command, and print memory and losses."""
    parser = argparse.ArgumentParser("python -m benchmarks.hostile.soak", description=__doc__)
    parser.add_argument("--clip", default="box", help="name of a clip, or a video file; default: box")
    parser.add_argument("--frames", type=int, default=5000, help="default: %(default)s")
    parser.add_argument("--rate", type=Fraction, help="frames a second; default: that of the clip")
    parser.add_argument("--cut-every", type=float, default=60.0, metavar="S", help="default: %(default)s")
    parser.add_argument("--away", action="store_true", help="the link is down for half of the time")
    parser.add_argument("--out", type=Path, default=Path("out/soak"), help="folder of what is written")
    arguments, options = parser.parse_known_args(words)
    arguments.out.mkdir(parents=True, exist_ok=True)
    print(run(arguments, options), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
