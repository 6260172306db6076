"""Mutated input and cut live runs: how much was tried, and how much of it did harm."""

from pathlib import Path

from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import GOOD, KINDS, outcome_of, run
from benchmarks.hostile.campaign import CUTS, FUZZING, Tried
from benchmarks.results.code import ROOT
from benchmarks.results.harness import Measured, Missing, Setting

COUNT, QUICK_COUNT = 400, 5
"""Mutations of each kind; issues ask for more, by `python -m benchmarks.hostile`."""
FINDS = ROOT / "tests" / "golden" / "finds"


def harmful(setting: Setting) -> Measured:
    """Mutate input of all commands; count crashes, hangs, tracebacks and large allocations."""
    count = setting.choose(COUNT, QUICK_COUNT)
    outcomes = [text for kind in KINDS for text in run([(kind, number) for number in range(count)])]
    note = f"{len(outcomes)} mutations of {len(KINDS)} kinds: {', '.join(KINDS)}"
    return Measured(float(sum(text not in GOOD for text in outcomes)), {}, None, note)


def hours_fuzzed(_: Setting) -> Measured:
    """Return the time of mutations that were new when they were tried, in all parts."""
    tried = _tried(FUZZING)
    found = f"{len(tried.finds)} did harm when they were found"
    note = f"{tried.inputs.total()} mutations, {found}: {tried.summary()}"
    return Measured(tried.hours, {}, None, note)


def finds_left(_: Setting) -> Measured:
    """Count mutations that did harm in those hours and still do."""
    tried = _tried(FUZZING)
    harmful = []
    for name in tried.finds:
        path = FINDS / f"{name}.bin"
        if not path.exists() or outcome_of(kinds()[path.parent.name], path.read_bytes()) not in GOOD:
            harmful.append(name)
    return Measured(float(len(harmful)), {}, None, ", ".join(harmful) or f"of {len(tried.finds)}")


def same_after_cuts(_: Setting) -> Measured:
    """Count live runs that were cut at a random moment and gave the same frames and bits as uncut ones."""
    tried = _tried(CUTS)
    runs = tried.inputs.total()
    return Measured(float(runs - len(tried.finds)), {}, None, f"of {runs}: {tried.summary()}")


def _tried(path: Path) -> Tried:
    if not path.exists():
        raise Missing(f"there is no {path.name}")
    return Tried.read(path)
