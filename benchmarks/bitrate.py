"""How well a bitrate is kept: ``python -m benchmarks.bitrate [CLIP ...] [--bitrate 150k 300k] [--live]``.

Clips, names or video files, are played forwards, backwards, and so on. Without feedback, or live with a
decoder, a row has the worst deviation of groups of pictures that last two seconds, which begin after the
first two, in percent of the bitrate; how much quality that costs against streams of constant QP, by the mean
PSNR of both at the same rate (``--psnr``); and the range of QPs.
"""

import argparse
import io
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.results.harness import CLIPS, report_of, run_module
from benchmarks.results.live import PATIENCE_S, serving
from benchmarks.speed import source_of
from dvc import cli
from dvc.config import MAX_QP
from dvc.stream import StreamReader, StreamWriter
from dvc.video import open_video
from encoder.rate_limits import TOLERANCE, WINDOW_S

QP_PER_OCTAVE = 6
"""About as many halve a stream: for the next try."""


class GroupRate(NamedTuple):
    """Size of a group."""

    num_frames: int
    num_bits: int


def group_rates(stream: Path) -> list[GroupRate]:
    """Return the size of each group of a stream, framing included."""
    with StreamReader(stream) as reader, StreamWriter(io.BytesIO(), reader.config, reader.form) as writer:
        found, before = [], writer.num_bytes
        for record in reader:
            writer.write_gop(record)
            found.append(GroupRate(record.num_frames, 8 * (writer.num_bytes - before)))
            before = writer.num_bytes
    return found


def deviations(groups: Sequence[GroupRate], frame_rate: float, bits_per_s: float) -> list[float]:
    """Return by how much of the bitrate groups that last `WINDOW_S` are off, for all that begin after it."""
    times = np.cumsum([0, *(group.num_frames for group in groups)]) / frame_rate
    bits = np.cumsum([0, *(group.num_bits for group in groups)])
    found = []
    for first in range(int(np.searchsorted(times, WINDOW_S)), len(times)):
        last = int(np.searchsorted(times, times[first] + WINDOW_S))
        if last < len(times):
            found.append((bits[last] - bits[first]) / ((times[last] - times[first]) * bits_per_s) - 1.0)
    return found


class Clip(NamedTuple):
    """A video, and how it is coded."""

    video: Path
    options: tuple[object, ...]
    live: bool
    folder: Path

    @property
    def report(self) -> Path:
        """Report of the decoder."""
        return self.folder / "report.json"

    def decode(self, *words: object) -> None:
        """Decode to a video and a report."""
        outputs = [self.folder / "decoded.y4m", "--reference", self.video, "--json", self.report]
        run_module("decoder", *words, *outputs, "--jobs", 2, "--quiet")

    def code(self, *quality: object) -> Path:
        """Code the video; live, a decoder asks, and decodes it."""
        stream, options = self.folder / "stream.dvc", [*self.options, *quality]
        if self.live:
            with serving(self.video, self.folder, options) as served:
                self.decode("--timeout", PATIENCE_S, "--punctured", stream, "--connect", served)
        else:
            run_module("encoder", self.video, stream, "--no-feedback", *options, "--quiet")
        return stream

    def psnr_db(self, stream: Path) -> float:
        """Return the mean PSNR of the stream that was coded last."""
        if not self.live:
            self.decode(stream)
        report = report_of(self.report)
        return float(report.get("psnr_yuv_db", report["psnr_y_db"]))

    def constant_psnr_db(self, num_bytes: int) -> float:
        """Return the mean PSNR of streams of constant QP at a size, from those next to it."""
        points: dict[int, tuple[float, float]] = {}
        qp = 30
        while qp not in points and len(points) < 5:
            stream = self.code("--qp", qp)
            octaves = math.log2(stream.stat().st_size / num_bytes)
            points[qp] = octaves, self.psnr_db(stream)
            sides = {
                size > 0.0: at for at, (size, _) in sorted(points.items(), key=lambda one: -abs(one[1][0]))
            }
            if len(sides) == 2 and sides[False] - sides[True] <= 2:
                break
            qp = min(max(qp + (math.ceil if octaves > 0 else math.floor)(octaves * QP_PER_OCTAVE), 1), MAX_QP)
        sizes, psnrs_db = zip(*sorted(points.values()), strict=True)
        return float(np.interp(0.0, sizes, psnrs_db))


def row(clip: Clip, bits_per_s: int, frame_rate: float, with_psnr: bool) -> str:
    """Code a clip at a bitrate, and return the deviations from it."""
    stream = clip.code("--bitrate", bits_per_s)
    size = stream.stat().st_size
    off = deviations(group_rates(stream), frame_rate, bits_per_s)
    worst = max(off, key=abs, default=math.nan)
    within = np.mean([abs(one) <= TOLERANCE for one in off]) if off else math.nan
    text = f"{bits_per_s}: worst {100 * worst:+.1f} %, {100 * within:.0f} % of {len(off)} within 5 %"
    if with_psnr:
        found_db = clip.psnr_db(stream)
        text += f", {found_db:.2f} dB, {found_db - clip.constant_psnr_db(size):+.2f} dB to constant QP"
    return text


def main(words: Sequence[str] | None = None) -> int:
    """Print a row for each clip and bitrate."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bitrate", description=__doc__)
    parser.add_argument("clips", nargs="*", default=CLIPS, metavar="CLIP")
    parser.add_argument("--bitrate", nargs="+", type=cli.parse_bits, default=[150_000, 300_000, 600_000])
    parser.add_argument("--seconds", type=cli.parse_positive, default=20.0)
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--psnr", action="store_true")
    arguments = parser.parse_args(words)
    for name in arguments.clips:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            with open_video(source_of(name, 1, folder)) as reader:
                frame_rate = float(reader.info.frame_rate)
            num_frames = round(arguments.seconds * frame_rate)
            video = source_of(name, num_frames, folder)
            clip = Clip(video, ("--frames", num_frames), arguments.live, folder)
            for bits_per_s in arguments.bitrate:
                print(Path(name).stem, row(clip, bits_per_s, frame_rate, arguments.psnr), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
