"""How long reconstructions take, and how much memory, as whole processes with compiled kernels on disk."""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting, Usage
from benchmarks.figures.stereo.runs import data_folder, motorcycle, reconstruction_folder, write_pair
from dvc.multiview.camera_array import LatticePosition
from dvc.pfm import read_pfm
from dvc.stereo.thesis.real_sets import PAIRS, TSUKUBA

AREA = "stereo"
GIB = 2**30
SPEED_UP = 1.7
LARGE = 1500 / 741
LARGE_DISPARITIES = "0:128"


def _best(
    repetitions: int,
    paths: Sequence[Path],
    disparities: str,
    positions: Sequence[LatticePosition] | None = None,
    jobs: int = 1,
) -> tuple[Usage, dict[str, bytes]]:
    """Run several times after a first one, which may compile; return the fastest, and what was written."""
    used, written = [], {}
    for _ in range(repetitions + 1):
        with reconstruction_folder(paths, disparities, positions, ["--jobs", jobs]) as (folder, usage):
            used.append(usage)
            written = {path.name: read_pfm(path).tobytes() for path in sorted(folder.glob("*.pfm"))}
    return min(used[1:] or used, key=lambda usage: usage.wall_s), written


def _told(usage: Usage, most_s: float, most_bytes: float) -> Measured:
    holds = usage.wall_s <= most_s and usage.peak_bytes <= most_bytes
    values = {"wall_s": usage.wall_s, "cpu_s": usage.cpu_s, "peak_bytes": usage.peak_bytes}
    return Measured(f"{usage.wall_s:.1f} s, {usage.peak_bytes / GIB:.2f} GiB", holds, values)


def pair_time(setting: Setting, clip: str, name: str, most_s: float) -> Measured:
    """Measure one pair of the Middlebury evaluation, one job."""
    del clip
    one = PAIRS[name]
    usage, _ = _best(setting.choose(3, 1), one.pair_files(data_folder(name)), one.disparities)
    return _told(usage, most_s, 2 * GIB)


def array_time(setting: Setting, clip: str) -> Measured:
    """Measure all cameras of Tsukuba, one job."""
    del setting, clip
    files, positions = TSUKUBA.array_files(data_folder("tsukuba"), 25)
    usage, _ = _best(0, files, TSUKUBA.disparities, positions)
    return _told(usage, 180.0, 2 * GIB)


def two_jobs(setting: Setting, clip: str) -> Measured:
    """Measure Tsukuba's cross with one job and with two."""
    files, positions = TSUKUBA.array_files(data_folder("tsukuba"), 5)
    del clip
    runs = [_best(setting.choose(2, 1), files, TSUKUBA.disparities, positions, jobs) for jobs in (1, 2)]
    faster = runs[0][0].wall_s / runs[1][0].wall_s
    same = runs[0][1] == runs[1][1]
    text = f"{faster:.2f} times, {'the same' if same else 'NOT the same'} disparities"
    values = {"speed_up": faster, "wall_s": [run[0].wall_s for run in runs], "same": same}
    return Measured(text, faster >= SPEED_UP and same, values)


def large_pair(setting: Setting, clip: str) -> Measured:
    """Measure the Motorcycle pair enlarged to a width of 1500 pixels, one job."""
    del clip
    left, right, truth = motorcycle(LARGE if not setting.quick else 1.0)
    with tempfile.TemporaryDirectory() as scratch:
        paths = write_pair(Path(scratch), left, right)
        disparities = LARGE_DISPARITIES if not setting.quick else "0:64"
        with reconstruction_folder(paths, disparities, None, ["--jobs", 1]) as (folder, usage):
            found = read_pfm(folder / "disparity-left.pfm")
    known = np.isfinite(truth)
    bad = 100.0 * float(np.mean(np.abs(found - truth)[known] > 2.0))
    measured = _told(usage, 120.0, 4 * GIB)
    measured.values["bad_percent_2px"] = bad
    return measured


FIGURES = (
    *(
        Figure(
            AREA,
            f"time-{name}",
            f"`dvc-stereo reconstruct` of {name}, two views, one job",
            f"≤ {most_s:g} s, ≤ 2 GiB",
            partial(pair_time, name=name, most_s=most_s),
        )
        for name, most_s in (("tsukuba", 3.0), ("teddy", 10.0))
    ),
    Figure(
        AREA,
        "time-25-cameras",
        "`dvc-stereo reconstruct` of Tsukuba, 25 views, one job",
        "≤ 3 min, ≤ 2 GiB",
        array_time,
        slow=True,
    ),
    Figure(
        AREA,
        "two-jobs",
        "two jobs instead of one, Tsukuba with 5 cameras",
        f"≥ {SPEED_UP} times faster, same disparities",
        two_jobs,
    ),
    Figure(
        AREA,
        "large-pair",
        "`dvc-stereo reconstruct` of a pair of 1500x1012 pixels and 129 disparities, one job",
        "≤ 2 min, ≤ 4 GiB",
        large_pair,
    ),
)
"""The figures of this module."""
