"""Mutated input: how much of it did harm."""

import re
import subprocess
import sys

from benchmarks.results.harness import Measured, Setting
from dvc.errors import DvcError

COUNT, QUICK_COUNT = 400, 5
"""Mutations of each kind; issues ask for more, by `python -m benchmarks.hostile`."""


def harmful(setting: Setting) -> Measured:
    """Mutate what commands receive; count crashes, hangs, tracebacks and large allocations."""
    count = setting.choose(COUNT, QUICK_COUNT)
    command = [sys.executable, "-m", "benchmarks.hostile", "--count", str(count)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    kinds = re.findall(r"^([a-z][\w-]*): (.*)", done.stdout, flags=re.MULTILINE)
    if not kinds or done.returncode not in (0, 2):
        raise DvcError(f"the mutations ended with status {done.returncode}: {done.stdout[-300:]}")
    bad = re.findall(r"^ +\d+: .*", done.stdout, flags=re.MULTILINE)
    note = f"{count * len(kinds)} mutations of {len(kinds)} kinds: {', '.join(kind for kind, _ in kinds)}"
    return Measured(float(len(bad)), {}, None, note)
