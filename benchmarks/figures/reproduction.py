"""The reproduction of the thesis by one command: how long its quick preset takes."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting
from dvc.errors import DvcError
from dvc.rd.results import read_results

MOST_S = 900.0
JOBS = 2
AREA = "report"


def quick_reproduction(setting: Setting, clip: str) -> Measured:
    """Measure how long the quick reproduction takes, from nothing, with two processes at a time."""
    del clip
    command = [sys.executable, "-m", "dvc.rd", "reproduce", "thesis", "--jobs", str(JOBS), "--quiet"]
    if setting.quick:
        command += ["--frames", "3", "--sequences", "street"]
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        status = subprocess.run([*command, "--out", folder], check=False).returncode
        elapsed_s = time.perf_counter() - started
        if status != 0:
            raise DvcError("the reproduction failed")
        num_points = len(read_results(Path(folder)))
    text = f"{elapsed_s / 60:.1f} min for {num_points} points"
    return Measured(text, elapsed_s <= MOST_S, {"elapsed_s": elapsed_s, "num_points": num_points})


FIGURES = (
    Figure(
        AREA,
        "quick-reproduction",
        "`dvc-rd reproduce thesis --jobs 2`: street, and box where it is there",
        "≤ 15 min on two cores",
        quick_reproduction,
    ),
)
"""The figure of this module."""
