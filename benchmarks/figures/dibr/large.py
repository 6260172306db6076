"""Time and memory of a large pair, as a whole process with compiled kernels on disk."""

import tempfile
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting, run_module
from benchmarks.figures.stereo.runs import motorcycle, write_pair

AREA = "dibr"
GIB = 2**30
WIDTH = 1500
NATIVE_WIDTH = 741
DISPARITIES = "0:128"
SLOPE = "2e-3"
MOST_S, MOST_GIB = 60.0, 4.0


def large_pair(setting: Setting, clip: str) -> Measured:
    """Encode the Motorcycle pair, enlarged, gray and in L, at one slope; the first time may compile."""
    del clip
    left, right, _ = motorcycle(1.0 if setting.quick else WIDTH / NATIVE_WIDTH)
    with tempfile.TemporaryDirectory() as scratch:
        paths = write_pair(Path(scratch), left, right)
        out = Path(scratch) / "pair.dibr"
        arguments = [
            "encode",
            *paths,
            out,
            "--disparities",
            DISPARITIES,
            "--slope",
            SLOPE,
            "--gray",
            "--quiet",
        ]
        usage = min((run_module("dvc.dibr", arguments) for _ in range(2)), key=lambda one: one.cpu_s)
        num_bytes = out.stat().st_size
    values = {"cpu_s": usage.cpu_s, "wall_s": usage.wall_s, "peak_bytes": usage.peak_bytes}
    bpp = 8 * num_bytes / (left.shape[0] * left.shape[1])
    note = f"{left.shape[1]}x{left.shape[0]}, {DISPARITIES}; {bpp:.2f} bpp; {usage.wall_s:.0f} s by the clock"
    holds = usage.cpu_s <= MOST_S and usage.peak_bytes <= MOST_GIB * GIB
    return Measured(f"{usage.cpu_s:.1f} s, {usage.peak_bytes / GIB:.2f} GiB", holds, values, note)


FIGURES = (
    Figure(
        AREA,
        "large",
        f"`dvc-dibr encode --slope {SLOPE}` of a pair {WIDTH} pixels wide and 129 disparities, L, gray",
        f"≤ {MOST_S:g} s, ≤ {MOST_GIB:g} GiB",
        large_pair,
        slow=True,
    ),
)
"""The figures of this module."""
