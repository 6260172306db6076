"""Compiled kernels: an edit of any kernel that one calls outdates its code on disk."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

KERNEL = "from dvc._jit import inlined_kernel, kernel\n{}\n\n@{}\ndef {}(x):\n    return {}\n"


def result_of(folder: Path, number: int) -> str:
    (folder / "callee.py").write_text(KERNEL.format("", "kernel", "callee", f"x + {number}"))
    command = [
        sys.executable,
        "-c",
        "from caller import caller; print(caller(0), len(caller.stats.cache_hits))",
    ]
    path = os.pathsep.join([str(folder), str(Path(__file__).resolve().parents[1])])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder), "NUMBA_DISABLE_JIT": "0"}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return run.stdout


@pytest.mark.parametrize("middle", ["kernel", "inlined_kernel"])
def test_an_edit_of_a_callee_is_noticed(tmp_path: Path, middle: str) -> None:
    """A kernel whose callee in another file was edited is compiled anew, else loaded from disk."""
    for name, decorator, called in (("middle", middle, "callee"), ("caller", "kernel", "middle")):
        code = KERNEL.format(f"from {called} import {called}", decorator, name, f"{called}(x)")
        (tmp_path / f"{name}.py").write_text(code)
    assert [result_of(tmp_path, number).split() for number in (1, 1, 2)] == [
        ["1", "0"],
        ["1", "1"],
        ["2", "0"],
    ]
