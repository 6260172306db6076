"""Mutated input and cut live runs: how much was tried, and how much of it did harm."""

import re
import subprocess
from pathlib import Path

from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import GOOD, outcome_of
from benchmarks.hostile.campaign import CUTS, FUZZING, Tried
from benchmarks.results.code import ROOT
from benchmarks.results.harness import Measured, Missing, Setting
from dvc.environment import child_environment, python_module
from dvc.errors import DvcError

COUNT, QUICK_COUNT = 400, 5
"""Mutations of each kind; issues ask for more, by `python -m benchmarks.hostile`."""
FINDS = ROOT / "tests" / "golden" / "finds"


def harmful(setting: Setting) -> Measured:
    """Mutate what commands receive; count crashes, hangs, tracebacks and large allocations."""
    count = setting.choose(COUNT, QUICK_COUNT)
    command = python_module("benchmarks.hostile", "--count", count)
    done = subprocess.run(command, env=child_environment(), stdout=subprocess.PIPE, text=True, check=False)
    kinds = re.findall(r"^([a-z][\w-]*): (.*)", done.stdout, flags=re.MULTILINE)
    if not kinds or done.returncode not in (0, 2):
        raise DvcError(f"the mutations ended with status {done.returncode}: {done.stdout[-300:]}")
    bad = re.findall(r"^ +\d+: .*", done.stdout, flags=re.MULTILINE)
    note = f"{count * len(kinds)} mutations of {len(kinds)} kinds: {', '.join(kind for kind, _ in kinds)}"
    return Measured(float(len(bad)), {}, None, note)


def hours_fuzzed(_: Setting) -> Measured:
    """Return the time of mutations that were new when they were tried, in all parts."""
    tried = _tried(FUZZING)
    note = (
        f"{tried.inputs.total()} mutations, {len(tried.finds)} did harm when they were found: {tried.told()}"
    )
    return Measured(tried.hours, {}, None, note)


def finds_left(_: Setting) -> Measured:
    """Count what did harm in those hours and does so still."""
    tried = _tried(FUZZING)
    harmful = [name for name in tried.finds if not _is_mended(name)]
    return Measured(float(len(harmful)), {}, None, ", ".join(harmful) or f"of {len(tried.finds)}")


def _is_mended(name: str) -> bool:
    """Tell whether a find, which is kept as a file, is refused or decoded now."""
    path = FINDS / f"{name}.bin"
    return path.exists() and outcome_of(kinds()[path.parent.name], path.read_bytes()) in GOOD


def same_after_cuts(_: Setting) -> Measured:
    """Count live runs that were cut at a random moment and gave the same frames and bits as uncut ones."""
    tried = _tried(CUTS)
    runs = tried.inputs.total()
    return Measured(float(runs - len(tried.finds)), {}, None, f"of {runs}: {tried.told()}")


def _tried(path: Path) -> Tried:
    if not path.exists():
        raise Missing(f"there is no {path.name}")
    return Tried.read(path)
