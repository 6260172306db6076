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
    """Encode the Motorcycle pair, enlarged, in colour and L, at one slope and at one rate.

    Gives wall-clock time and memory of the process for one slope, start-up included; beside it those of the
    search for the slope of a rate.
    """
    del clip
    left, right, _ = motorcycle(1.0 if setting.quick else WIDTH / NATIVE_WIDTH)
    rates = {"slope": ["--slope", SLOPE], "rate": ["--bpp", "0.5"]}
    values: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as scratch:
        paths = write_pair(Path(scratch), left, right)
        out = Path(scratch) / "pair.dibr"
        for told, rate in rates.items():
            usage = run_module(
                "dvc.dibr", ["encode", *paths, out, "--disparities", DISPARITIES, *rate, "--quiet"]
            )
            values |= {f"{told}_wall_s": usage.wall_s, f"{told}_cpu_s": usage.cpu_s}
            values |= {f"{told}_peak_bytes": usage.peak_bytes, f"{told}_bytes": out.stat().st_size}
    holds = values["slope_wall_s"] <= MOST_S and values["slope_peak_bytes"] <= MOST_GIB * GIB
    height = left.shape[0]
    note = (
        f"{left.shape[1]}x{height}, {DISPARITIES}; --bpp 0.5: {values['rate_wall_s']:.0f} s, "
        f"{values['rate_peak_bytes'] / GIB:.2f} GiB"
    )
    text = f"{values['slope_wall_s']:.1f} s, {values['slope_peak_bytes'] / GIB:.2f} GiB"
    return Measured(text, holds, values, note)


FIGURES = (
    Figure(
        AREA,
        "large",
        f"`dvc-dibr encode --slope {SLOPE}` of a pair {WIDTH} pixels wide and 129 disparities, L, colour",
        f"≤ {MOST_S:g} s, ≤ {MOST_GIB:g} GiB",
        large_pair,
        slow=True,
    ),
)
"""The figures of this module."""
