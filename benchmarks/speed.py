"""How fast clips are decoded, from a file and live: `python -m benchmarks.speed [CLIP ...] [--jobs N]`.

A file is decoded by one process and by N, on N Dask workers, too, on request; then the encoder is
asked live, over a link if one is described. Times are those of whole commands, their start included. A clip
that is too short is played forwards, backwards, and so on. Memory is the peak of one process of the decoder.
"""

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from benchmarks.results.encoder import looped
from benchmarks.results.harness import CLIPS, Usage, clip_source, report_of, run_module
from benchmarks.results.live import PATIENCE_S, serving
from benchmarks.slow_link import slow_link
from dvc.feedback import parse_address
from dvc.video import open_video

MIB = 2**20


def source_of(clip: str, num_frames: int, folder: Path) -> Path:
    """Return a video of a clip or file with at least a number of frames."""
    path = Path(clip) if Path(clip).suffix else clip_source(clip).path
    with open_video(path) as reader:
        available = sum(1 for _ in reader)
    return path if available >= num_frames else looped(path, folder / "looped.mkv", num_frames, available)


def decoding(stream: Path, folder: Path, *words: object) -> tuple[Usage, bytes]:
    """Decode a stream, and return resources and frames."""
    made = folder / "file.y4m"
    usage = run_module("decoder", stream, made, *words, "--quiet")
    frames = made.read_bytes()
    made.unlink()
    return usage, frames


def cluster_rows(folder: Path, workers: int, file: Usage, frames: bytes) -> list[tuple[str, str]]:
    """Compare decoding on Dask workers of this machine that are running already with that of the file."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        usage, same = decoding(folder / "stream.dvc", folder, "--dask", cluster.scheduler_address)
    return [
        (f"file, {workers} Dask workers: time over {workers} jobs", f"{usage.wall_s / file.wall_s:.2f}"),
        ("  frames", "the same" if same == frames else "NOT THE SAME"),
    ]


def live(
    video: Path, options: Sequence[object], jobs: int, link: tuple[float, float] | None, folder: Path
) -> tuple[Usage, dict[str, float], bytes]:
    """Code and decode a video live, and return resources, figures and frames of the decoder."""
    made, report = folder / "live.y4m", folder / "live.json"
    with serving(video, folder, options) as served, ExitStack() as stack:
        between = stack.enter_context(slow_link(*parse_address(served), *link)) if link else None
        address = between.address if between else served
        words = ["--connect", address, made, "--jobs", jobs, "--timeout", PATIENCE_S, "--json", report]
        usage = run_module("decoder", *words, "--quiet")
    totals, frames = report_of(report), made.read_bytes()
    made.unlink()
    figures = {name: totals[name] / totals["frames"] for name in ("num_messages", "num_requests")}
    return usage, figures | totals["delay_s"] | {"bits": 8.0 * totals["stream_bytes"]}, frames


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Return lines of names and values."""
    return "\n".join(f"  {name:<44} {value}" for name, value in rows)


def usage_rows(name: str, usage: Usage, num_frames: int) -> list[tuple[str, str]]:
    """Return the speed, processor time and memory of a command."""
    return [
        (f"{name}: frames a second", f"{num_frames / usage.wall_s:.2f}"),
        ("  processor time a frame, s", f"{usage.cpu_s / num_frames:.2f}"),
        ("  memory of a process, MiB", f"{usage.peak_bytes / MIB:.0f}"),
    ]


def measured(clip: str, arguments: argparse.Namespace) -> list[tuple[str, str]]:
    """Measure one clip."""
    folder: Path = arguments.out / Path(clip).stem
    folder.mkdir(parents=True, exist_ok=True)
    num, jobs, video = arguments.frames, arguments.jobs, source_of(clip, arguments.frames, folder)
    options = ["--qp", arguments.qp, "--frames", num]
    run_module("encoder", video, folder / "stream.dvc", *options, "--quiet")
    file, frames = decoding(folder / "stream.dvc", folder, "--jobs", jobs)
    rows = usage_rows(f"file, {jobs} jobs", file, num)
    if not arguments.no_single:
        single, same = decoding(folder / "stream.dvc", folder, "--jobs", 1)
        rows += [
            *usage_rows("file, 1 job", single, num),
            (f"  time of 1 job over that of {jobs}", f"{single.wall_s / file.wall_s:.2f}"),
            ("  frames", "the same" if same == frames else "NOT THE SAME"),
        ]
    if arguments.dask:
        rows += cluster_rows(folder, jobs, file, frames)
    if not arguments.no_live:
        link = (arguments.delay, arguments.bandwidth) if arguments.delay or arguments.bandwidth else None
        usage, totals, same = live(video, options, jobs, link, folder)
        least_s = file.wall_s + (totals["bits"] / arguments.bandwidth if link else 0.0)
        rows += [
            *usage_rows(f"live, {jobs} jobs", usage, num),
            ("  delay of a frame: median, worst, s", f"{totals['median']:.1f}, {totals['worst']:.1f}"),
            ("  messages, requests a frame", f"{totals['num_messages']:.1f}, {totals['num_requests']:.0f}"),
            ("  time over bits / rate + decoding of the file", f"{usage.wall_s / least_s:.2f}"),
            ("  frames", "the same" if same == frames else "NOT THE SAME"),
        ]
    return rows


def main(words: Sequence[str] | None = None) -> int:
    """Measure, and print a table for each clip."""
    parser = argparse.ArgumentParser("python -m benchmarks.speed", description=__doc__)
    parser.add_argument("clips", nargs="*", metavar="CLIP", help="names, or video files; default: all nine")
    parser.add_argument("--qp", type=int, default=34)
    parser.add_argument("--frames", type=int, default=49)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--delay", type=float, default=0.0, metavar="S", help="of the link, each way")
    parser.add_argument("--bandwidth", type=float, default=0.0, metavar="BITS_PER_SECOND", help="of the link")
    parser.add_argument("--no-single", action="store_true", help="do not decode the file by one process")
    parser.add_argument("--dask", action="store_true", help="decode the file on Dask workers, too")
    parser.add_argument("--no-live", action="store_true", help="do not decode live")
    parser.add_argument("--out", type=Path, default=Path("out/speed"), help="folder of streams")
    arguments = parser.parse_args(words)
    if bool(arguments.delay) != bool(arguments.bandwidth):
        parser.error("a link has --delay and --bandwidth")
    for clip in arguments.clips or CLIPS:
        print(f"{clip}, {arguments.frames} frames, QP {arguments.qp}", flush=True)
        print(table(measured(clip, arguments)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
