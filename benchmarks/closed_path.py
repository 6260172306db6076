"""What long-term references spare where the camera comes back: `python -m benchmarks.closed_path [--qp 32]`.

The rendered scene *rounds* is coded by real processes with and without them, and its two rounds compared.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from dvc.environment import child_environment, python_module
from dvc.metrics import psnr_db
from dvc.stream import StreamReader
from dvc.video import open_video

SCENE = "rounds"
NUM_FRAMES = 240
NOISE = 1.5
"""Of the sensor, in luma levels: other noise in each frame."""


class Round(NamedTuple):
    """What one round takes."""

    kbit: float  # of what was needed to decode it
    psnr_db: float  # mean over its frames
    key_frames: int


def run(module: str, *words: object) -> None:
    """Run a program of the project."""
    subprocess.run(python_module(module, *words), env=child_environment(), check=True)


def rounds(punctured: Path, decoded: Path, original: Path, num_frames: int) -> tuple[Round, Round]:
    """Measure both halves of a decoded clip; a group belongs to the half in which it ends."""
    with StreamReader(punctured) as reader:
        entries = reader.index.entries
        keys = [not record.without_key for record in reader]
    ends = list(accumulate(entry.num_frames for entry in entries))
    with open_video(decoded) as ours, open_video(original) as theirs:
        quality = [psnr_db(b.luma, a.luma) for a, b in zip(ours, theirs, strict=True)]
    found = []
    for half in (range(1, num_frames // 2 + 1), range(num_frames // 2 + 1, num_frames + 1)):
        within = [k for k, end in enumerate(ends) if end in half]
        bits = 8 * sum(entries[k].size for k in within)
        psnr = [quality[frame - 1] for frame in half]
        found.append(Round(bits / 1e3, sum(psnr) / len(psnr), sum(keys[k] for k in within)))
    return found[0], found[1]


def measure(original: Path, qp: int, long_term: int, folder: Path, num_frames: int) -> tuple[Round, Round]:
    """Code and decode the clip."""
    stream, punctured, decoded = (folder / f"{long_term}{end}" for end in (".dvc", "p.dvc", ".y4m"))
    run("encoder", original, stream, "--qp", qp, "--intra-period", 256, "--long-term", long_term, "--quiet")
    run("decoder", stream, decoded, "--punctured", punctured, "--jobs", 2, "--quiet")
    return rounds(punctured, decoded, original, num_frames)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command."""
    example = "example:\n  python -m benchmarks.closed_path --qp 32"
    parser = argparse.ArgumentParser(
        "python -m benchmarks.closed_path",
        description=__doc__,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--qp", type=int, default=32, help="quality; default: %(default)s")
    parser.add_argument("--frames", type=int, default=NUM_FRAMES, help="in both rounds; default: %(default)s")
    parser.add_argument("--size", default="352x288", help="of frames; default: %(default)s")
    arguments = parser.parse_args(words)
    print("long-term  round   kbit   PSNR  key frames")
    with tempfile.TemporaryDirectory() as folder:
        original = Path(folder) / "original.mkv"
        rendering = "--size", arguments.size, "--frames", arguments.frames, "--noise", NOISE, "--jobs", 2
        run("sequences", "render", SCENE, "--out", original, *rendering)
        for long_term in (0, 64):
            found = measure(original, arguments.qp, long_term, Path(folder), arguments.frames)
            for number, one in enumerate(found, 1):
                print(f"{long_term:9} {number:6} {one.kbit:6.0f} {one.psnr_db:6.2f} {one.key_frames:11}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
