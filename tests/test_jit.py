"""Compiled kernels: an edit of any kernel that one calls outdates its code on disk."""

import importlib
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba.core import caching

KERNEL = "from dvc._jit import inlined_kernel, kernel\n{}\n\n@{}\ndef {}(x):\n    return {}\n"


def result_of(folder: Path, number: int) -> str:
    (folder / "callee.py").write_text(KERNEL.format("", "kernel", "callee", f"x + {number}"))
    command = [
        sys.executable,
        "-c",
        "from caller import caller; print(caller(0), len(caller.stats.cache_hits))",
    ]
    path = os.pathsep.join([str(folder), str(Path(__file__).resolve().parents[1])])
    environment = {
        **os.environ,
        "PYTHONPATH": path,
        "PYTHONDONTWRITEBYTECODE": "1",  # byte code knows an edit of the same length by whole seconds only
        "NUMBA_CACHE_DIR": str(folder),
        "NUMBA_DISABLE_JIT": "0",
    }
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


def test_a_copy_is_not_compiled_again(tmp_path: Path) -> None:
    """Elsewhere and at another time the code on disk serves; not with another constant of another module."""
    (tmp_path / "made").mkdir()
    code = KERNEL.format("from numbers_of import STEP", "kernel", "caller", "x + STEP")
    (tmp_path / "made" / "caller.py").write_text(code)
    command = [
        sys.executable,
        "-c",
        "from caller import caller; print(caller(0), len(caller.stats.cache_hits))",
    ]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "0", "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    told = []
    for before, folder, step in (("made", "first", 2), ("first", "second", 2), ("first", "third", 3)):
        shutil.copytree(tmp_path / before, tmp_path / folder, copy_function=shutil.copy)
        (tmp_path / folder / "numbers_of.py").write_text(f"STEP = {step}\n")
        path = os.pathsep.join([str(tmp_path / folder), str(Path(__file__).resolve().parents[1])])
        run = subprocess.run(
            command, env=environment | {"PYTHONPATH": path}, capture_output=True, text=True, check=True
        )
        told.append(run.stdout.split())
    assert told == [["2", "0"], ["2", "1"], ["3", "0"]]


def test_kernels_run_where_no_folder_can_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read-only package and a home that is none: code beside the source serves, else it is compiled."""

    def refuse(_self: object) -> None:
        raise PermissionError

    (tmp_path / "read_only.py").write_text(KERNEL.format("", "kernel", "read_only", "x + 1"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(caching._CacheLocator, "ensure_cache_path", refuse)
    function: Any = importlib.import_module("read_only").read_only
    assert function(1) == 2
    assert list(tmp_path.rglob("*.nb*")) == []
    monkeypatch.undo()
    function._cache.save_overload(function.signatures[0], function.overloads[function.signatures[0]])
    assert function._cache.load_overload(function.signatures[0], function.targetctx) is not None
    assert [path.parent.name for path in tmp_path.rglob("*.nbi")] == ["__pycache__"]


@pytest.mark.parametrize("change", ["nothing", "mode", "owner"])
def test_code_that_others_may_have_written_is_not_loaded(tmp_path: Path, change: str) -> None:
    """A cache that all may write to, or that another user owns, is neither read nor written."""
    if change == "owner" and os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    (tmp_path / "caller.py").write_text(KERNEL.format("", "kernel", "caller", "x + 1"))
    assert [result_of(tmp_path, 1) for _ in range(2)] == ["1 0\n", "1 1\n"]
    (index,) = tmp_path.rglob("*.nbi")
    if change == "mode":
        index.parent.chmod(0o777)
    if change == "owner":
        os.chown(index.parent, 12345, 12345)
    told = tmp_path / "told"
    index.write_bytes(pickle.dumps(_Stranger(told)))
    assert result_of(tmp_path, 1) == "1 0\n"
    assert told.exists() == (change == "nothing")


class _Stranger:
    """Runs code when it is read."""

    def __init__(self, told: Path) -> None:
        self._told = told

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self._told,)


def test_what_is_loaded_needs_nothing_of_the_compiler(tmp_path: Path) -> None:
    """Code on disk allocates, sorts and raises without; then another kernel is compiled all the same."""
    (tmp_path / "own.py").write_text(
        "import numpy as np\n"
        "from dvc._jit import kernel\n\n"
        "@kernel\ndef own(x):\n"
        "    if x.size == 0:\n        raise ValueError('nothing')\n"
        "    return np.sort(x * np.ones(x.size)).sum()\n\n"
        "@kernel\ndef after(x):\n    return own(x[:2]) + 1\n"
    )
    program = (
        "import sys; import numpy as np; from own import after, own\n"
        "print(own(np.arange(4.0)), len(own.stats.cache_hits), 'numba.misc.cffiimpl' in sys.modules)\n"
        "try:\n    own(np.empty(0))\nexcept ValueError as err:\n    print(err)\n"
        "if sys.argv[1] == '1': print(after(np.arange(4.0)), len(after.stats.cache_hits))\n"
    )
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).resolve().parents[1])])
    own = {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
    told = [
        subprocess.run(
            [sys.executable, "-c", program, str(number)],
            env=os.environ | own,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for number in range(2)
    ]
    assert told == ["6.0 0 True\nnothing\n", "6.0 1 False\nnothing\n2.0 0\n"]


def test_loading_and_compiling_are_told_apart_from_running(tmp_path: Path) -> None:
    """The clock of loading runs when a kernel is first called, in the thread that calls it."""
    (tmp_path / "one.py").write_text(KERNEL.format("", "kernel", "one", "x + 1"))
    (tmp_path / "two.py").write_text(KERNEL.format("from one import one", "kernel", "two", "one(x)"))
    program = (
        "import threading, time; from dvc._jit import loading_time_s; from two import two; found = []\n"
        "before = time.thread_time(), loading_time_s(); two(0)\n"
        "after = time.thread_time(), loading_time_s(); two(0)\n"
        "thread = threading.Thread(target=lambda: found.append(loading_time_s()))\n"
        "thread.start(); thread.join()\n"
        "print(before[1], after[1], after[0] - before[0], loading_time_s(), found[0])"
    )
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).resolve().parents[1])])
    environment = {
        **os.environ,
        "PYTHONPATH": path,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "NUMBA_DISABLE_JIT": "0",
    }
    command = [sys.executable, "-c", program]
    for share in (0.9, 0.5):  # compiled, then loaded
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        before, loading, spent, again, other = map(float, run.stdout.split())
        assert before == other == 0.0
        assert share * spent < loading < spent
        assert again == loading
