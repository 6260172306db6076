"""Live runs of a short clip, each cut at a random moment, until a total number in all parts.

``python -m benchmarks.hostile.cuts`` continues where it ended, with new moments, and records how many gave
the same frames and bits as uncut runs. ``--hours H`` ends it earlier.
"""

import argparse
import math
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.hostile.bad_link import Faults
from benchmarks.hostile.campaign import CUTS, Tried
from benchmarks.hostile.lost_links import OPENED_BYTES, Decoded, Ends, cut_once, run_with_losses, uncut
from benchmarks.results.harness import run_module

OPTIONS: dict[str, tuple[str, ...]] = {
    "default": (),
    "2d": ("--codec", "2d"),
    "points": ("--codec", "3d-td"),
    "faults": (),
}
"""Options of the encoder, by kind; runs with faults are inside TLS, and damaged as well."""
FAULTS_APART_BYTES = 20_000
ENDING_S = 300.0
"""Time of a run, after which it hangs."""
_SCENE, _SIZE = "street", "128x96"


class Uncut(NamedTuple):
    """Reference of the runs of a kind."""

    ends: Ends
    folder: Path
    expected: Decoded
    num_bytes: int  # bytes that passed the link


def prepared(video: Path, folder: Path) -> dict[str, Uncut]:
    """Run every kind without a cut."""
    found = {}
    for kind, options in OPTIONS.items():
        (folder / kind).mkdir(parents=True, exist_ok=True)
        ends = Ends(video, folder / kind, options, ENDING_S, tls=kind == "faults")
        found[kind] = Uncut(ends, folder / kind, *uncut(ends, folder / kind))
    return found


def run_number(number: int, runs: dict[str, Uncut]) -> tuple[str, str]:
    """Cut a run at the moment of its number; return its kind, and the difference to an uncut run."""
    rng, kind = np.random.default_rng(number), list(runs)[number % len(runs)]
    ends, folder, expected, num_bytes = runs[kind]
    faults = Faults(FAULTS_APART_BYTES, number) if kind == "faults" else None
    try:
        found, _ = run_with_losses(ends, folder, cut_once(int(rng.integers(OPENED_BYTES, num_bytes))), faults)
    except subprocess.TimeoutExpired:
        return kind, f"hang: more than {ENDING_S:.0f} s"
    except SystemExit as err:
        return kind, str(err)
    return kind, "" if found == expected else "frames or bits are not those of an uncut run"


def main(words: Sequence[str] | None = None) -> int:
    """Run the missing runs."""
    parser = argparse.ArgumentParser("python -m benchmarks.hostile.cuts", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="in all parts; default: %(default)s")
    parser.add_argument("--hours", type=float, default=math.inf, metavar="H", help="of this part")
    parser.add_argument("--frames", type=int, default=9, help="of a rendered clip; default: %(default)s")
    parser.add_argument("--state", type=Path, default=CUTS, help=f"default: {CUTS.name}")
    parser.add_argument("--out", type=Path, default=Path("out/cuts"), help="folder of what is written")
    arguments = parser.parse_args(words)
    ends_s = time.monotonic() + 3600.0 * arguments.hours
    tried, video = Tried.read(arguments.state), arguments.out / "video.mkv"
    arguments.out.mkdir(parents=True, exist_ok=True)
    run_module("sequences", "render", _SCENE, "--size", _SIZE, "--frames", arguments.frames, "--out", video)
    runs, num_finds = prepared(video, arguments.out), len(tried.finds)
    while tried.inputs.total() < arguments.runs and (started_s := time.monotonic()) < ends_s:
        (number,) = tried.take(1)
        kind, wrong = run_number(number, runs)
        finds = {f"{kind}/{number}": wrong} if wrong else {}
        tried.add(kind, 1, time.monotonic() - started_s, finds, {})
        print(f"{tried.inputs.total()} of {arguments.runs}: {kind}/{number} {wrong or 'same'}", flush=True)
    return 1 if len(tried.finds) > num_finds else 0


if __name__ == "__main__":
    sys.exit(main())
