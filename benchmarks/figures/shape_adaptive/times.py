"""Time of whole commands on Teddy's map, in fresh processes, kernels compiled."""

import os
import tempfile
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting, run_module
from benchmarks.figures.shape_adaptive.depth import AREA, RATE_BPP
from benchmarks.figures.stereo.runs import data_folder

ASKED_S = {"given": 2.0, "selected": 20.0}
NUM_RUNS = 3
_ONE_CORE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")


def depth_time(setting: Setting, clip: str) -> Measured:
    """Run `encode-depth` and `decode`, with edges of a file and with selected ones."""
    del clip
    disparities = data_folder("teddy") / "teddy" / "disp2.png"
    environment = {**os.environ, **dict.fromkeys(_ONE_CORE, "1")}
    found: dict[str, list[float]] = {name: [] for name in ASKED_S}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        stream, edges = folder / "map.dibr", folder / "edges.png"
        encode = ["encode-depth", disparities, stream, "--bpp", RATE_BPP, "--quiet"]
        for number in range(setting.choose(NUM_RUNS, 1) + 1):  # the first may compile
            for name in ("selected", "given"):
                options = ["--edges", edges] if name == "given" else []
                out = folder / f"decoded-{name}-{number}"
                runs = [
                    run_module("dvc.dibr", [*encode, *options], environment=environment),
                    run_module(
                        "dvc.dibr", ["decode", stream, "--out", out, "--quiet"], environment=environment
                    ),
                ]
                found[name].append(sum(one.cpu_s for one in runs))
                if name == "selected":
                    edges.write_bytes((out / "edges.png").read_bytes())
    least = {name: min(times[1:]) for name, times in found.items()}
    values = {f"{name}_cpu_s": seconds for name, seconds in least.items()}
    holds = all(least[name] <= asked for name, asked in ASKED_S.items())
    text = f"{least['given']:.1f} s with given edges, {least['selected']:.1f} s with selection"
    return Measured(text, holds, values, "processor time of both processes, start-up included")


FIGURES = (
    Figure(
        AREA,
        "depth-time",
        f"`dvc-dibr encode-depth` and `decode` of Teddy's map at {RATE_BPP:g} bpp, whole commands, one core",
        f"≤ {ASKED_S['given']:g} s with given edges, ≤ {ASKED_S['selected']:g} s with selection",
        depth_time,
        slow=True,
    ),
)
"""The figures of this module."""
