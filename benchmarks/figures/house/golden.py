"""Frozen streams: whether they decode to the frozen frames, here and on emulated processors."""

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from functools import partial

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.house.revisions import TREE
from dvc.environment import SINGLE_THREADED
from dvc.errors import DvcError

AREA = "house"
TESTS = "tests/test_golden.py"
QUICK = "2d-odd-luma or 3d-te-odd"
LIBRARIES = {
    "OPENBLAS_CORETYPE": "Sandybridge",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3",
    "OPENCV_CPU_DISABLE": "AVX2,FMA3",
}
COMPILER = {"NUMBA_CPU_NAME": "generic"}
C_LIBRARY = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"}


def threads(count: int) -> dict[str, str]:
    """Return the variables that fix the number of threads of all libraries."""
    return dict.fromkeys(SINGLE_THREADED, str(count))


PROCESSORS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "streams": ("here", {}),
    "libraries": ("libraries that believe in a lesser processor", LIBRARIES),
    "compiler": ("kernels compiled for any x86-64", COMPILER),
    "c-library": ("a C library that believes in a lesser processor", C_LIBRARY),
    "1-thread": ("all of these, 1 thread", {**LIBRARIES, **COMPILER, **C_LIBRARY, **threads(1)}),
    "2-threads": ("all of these, 2 threads", {**LIBRARIES, **COMPILER, **C_LIBRARY, **threads(2)}),
}
"""Name and title of a row, and the variables of its processes."""


def frozen_streams(setting: Setting, _clip: str, environment: Mapping[str, str]) -> Measured:
    """Decode the frozen streams, buffered and punctured."""
    command = [sys.executable, "-m", "pytest", TESTS, "-q", "-n", "0", "--tb=no", "--timeout=3600"]
    if setting.quick:
        command += ["-k", QUICK]
    variables = {**os.environ, **environment, "PYTHONPATH": str(TREE)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=TREE, env=variables)
    if done.returncode not in {0, 1}:
        raise DvcError(f"pytest ended with status {done.returncode}: {done.stdout.strip()[-300:]}")
    passed = _count(r"(\d+) passed", done.stdout)
    failures = re.findall(r"^FAILED \S+?\[(\S+)\]", done.stdout, re.MULTILINE)
    total = passed + _count(r"(\d+) failed", done.stdout)
    return Measured(f"{passed} of {total} tests pass", passed == total > 0, {"failures": failures})


def _count(pattern: str, text: str) -> int:
    found = re.findall(pattern, text)
    return int(found[-1]) if found else 0


FIGURES = tuple(
    Figure(
        AREA,
        f"golden-{name}",
        f"frozen streams of every codec, buffered and punctured: {title}",
        "all decode to the frozen frames",
        partial(frozen_streams, environment=environment),
        slow=bool(environment),
        programs=("decoder",),
    )
    for name, (title, environment) in PROCESSORS.items()
)
"""Figures of this module."""
