"""Time of encoding without feedback compared with x264: ``python -m benchmarks.encoder_time [CLIP ...]``.

Clips, names or video files, are played forwards, backwards, and so on. Each row is a clip at a length, with
the time of a process without start and input: milliseconds a frame, and its ratio to that of each anchor;
medians of interleaved runs. `encoding/time` of the results only counts later frames.
"""

import argparse
import statistics
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.results.encoder import ANCHORS, CLIPS, OURS, REPETITIONS, anchor_cpu_s, own_run_s
from benchmarks.speed import source_of
from dvc import cli


def ratios(video: Path, folder: Path, frames: int, repetitions: int) -> tuple[float, dict[str, float]]:
    """Return milliseconds a frame, and its ratio to that of each anchor."""
    runs = {OURS: partial(own_run_s, video, folder, frames)}
    runs |= {anchor: partial(anchor_cpu_s, video, folder, anchor, frames) for anchor in ANCHORS}
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repetitions):
        for name, run in runs.items():
            times[name].append(run())
    medians = {name: statistics.median(values) for name, values in times.items()}
    return 1000.0 * medians[OURS] / frames, {anchor: medians[OURS] / medians[anchor] for anchor in ANCHORS}


def main(words: Sequence[str] | None = None) -> int:
    """Print a row for each clip and length."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.encoder_time", description=__doc__)
    parser.add_argument("clips", nargs="*", default=CLIPS, metavar="CLIP")
    parser.add_argument("--frames", nargs="+", type=cli.integer(2, 10**6), default=[49, 490])
    parser.add_argument("--repetitions", type=cli.integer(1, 100), default=REPETITIONS)
    arguments = parser.parse_args(words)
    found: dict[int, list[dict[str, float]]] = {frames: [] for frames in arguments.frames}
    for name in arguments.clips:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            video = source_of(name, max(arguments.frames), folder)
            for frames in arguments.frames:
                frame_ms, over = ratios(video, folder, frames, arguments.repetitions)
                found[frames].append(over)
                text = ", ".join(f"{ratio:.2f} of {anchor}" for anchor, ratio in over.items())
                print(f"{Path(name).stem}, {frames} frames: {frame_ms:.2f} ms a frame, {text}", flush=True)
    for frames, overs in found.items():
        text = ", ".join(
            f"{statistics.fmean(over[anchor] for over in overs):.2f} of {anchor}" for anchor in ANCHORS
        )
        print(f"mean, {frames} frames: {text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
