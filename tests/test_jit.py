"""Compiled kernels: when code on disk is used, and who can have written it."""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
KERNEL = "from dvc._jit import inlined_kernel, kernel\n{}\n\n@{}\ndef {}(x):\n    return {}\n"
CALL = "from caller import caller; print(caller(0), len(caller.stats.cache_hits))"


def run(program: str, folder: Path, **variables: str) -> list[str]:
    """Run Python with the modules of a folder, and its kernels there too unless told otherwise."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]),
        "PYTHONDONTWRITEBYTECODE": "1",  # byte code is compared by whole seconds and lengths
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
        "NUMBA_DISABLE_JIT": "0",
        **variables,
    }
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def write_kernel(folder: Path, name: str, value: str, imports: str = "", decorator: str = "kernel") -> None:
    """Write a module with one kernel of its name."""
    (folder / f"{name}.py").write_text(KERNEL.format(imports, decorator, name, value))


@pytest.mark.parametrize("middle", ["kernel", "inlined_kernel"])
def test_an_edit_of_a_callee_is_noticed(tmp_path: Path, middle: str) -> None:
    """A kernel is compiled again if a callee in another file was edited, else loaded from disk."""
    write_kernel(tmp_path, "middle", "callee(x)", "from callee import callee", middle)
    write_kernel(tmp_path, "caller", "middle(x)", "from middle import middle")
    results = []
    for number in (1, 1, 2, 1):
        write_kernel(tmp_path, "callee", f"x + {number}")
        results.append(run(CALL, tmp_path))
    assert results == [["1", "0"], ["1", "1"], ["2", "0"], ["1", "1"]]


def test_a_copy_is_not_compiled_again(tmp_path: Path) -> None:
    """Trees share code; not with another constant of another module, nor if bounds are checked."""
    write_kernel(tmp_path, "caller", "x + STEP", "from numbers_of import STEP")
    results = []
    for name, step, bounds in (("first", 2, ""), ("second", 2, ""), ("third", 3, ""), ("fourth", 2, "1")):
        (tmp_path / name).mkdir()
        shutil.copy(tmp_path / "caller.py", tmp_path / name)
        (tmp_path / name / "numbers_of.py").write_text(f"STEP = {step}\n")
        variables = {"NUMBA_CACHE_DIR": str(tmp_path / "kernels"), "NUMBA_BOUNDSCHECK": bounds}
        results.append(
            run(CALL, tmp_path / name, **{key: value for key, value in variables.items() if value})
        )
    assert results == [["2", "0"], ["2", "1"], ["3", "0"], ["2", "0"]]


def test_the_cache_is_the_users(tmp_path: Path) -> None:
    write_kernel(tmp_path, "caller", "x + 1")
    assert run(CALL, tmp_path, NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(tmp_path / "caches")) == ["1", "0"]
    assert list((tmp_path / "caches" / "dvc3d" / "kernels" / "caller").glob("*.nbi"))
    assert not list(tmp_path.glob("__pycache__/*.nb*"))


@pytest.mark.parametrize("home", ["file", "relative"])
def test_kernels_run_if_no_folder_can_be_written_to(tmp_path: Path, home: str) -> None:
    """They are compiled into a temporary folder, which child processes use and which goes in the end."""
    write_kernel(tmp_path, "caller", "x + 1")
    (tmp_path / "file").write_text("")
    (tmp_path / "temporary").mkdir()
    program = f"{CALL}; import subprocess, sys; subprocess.run([sys.executable, '-c', {CALL!r}])"
    home = str(tmp_path / "file") if home == "file" else home
    variables = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": home, "TMPDIR": str(tmp_path / "temporary")}
    results = run(f"import sys; print(end='', flush=True)\n{program}", tmp_path, **variables)
    assert sorted(results) == ["0", "1", "1", "1"]
    assert list((tmp_path / "temporary").iterdir()) == []
    assert list(tmp_path.rglob("*.nb*")) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write anywhere")
def test_a_read_only_cache_is_used(tmp_path: Path) -> None:
    """Code that is there is loaded; other code is compiled, and kept as long as the process."""
    write_kernel(tmp_path, "caller", "x + 1")
    run(CALL, tmp_path)
    (tmp_path / "kernels").chmod(0o500)
    assert run(CALL, tmp_path) == ["1", "1"]
    (tmp_path / "kernels").chmod(0o700)


@pytest.mark.parametrize("change", ["nothing", "mode", "owner"])
def test_code_that_strangers_may_have_written_is_not_loaded(tmp_path: Path, change: str) -> None:
    """A cache that all may write to, or that another user owns, is neither read nor written."""
    if change == "owner" and os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    write_kernel(tmp_path, "caller", "x + 1")
    assert [run(CALL, tmp_path) for _ in range(2)] == [["1", "0"], ["1", "1"]]
    if change == "mode":
        (tmp_path / "kernels").chmod(0o777)
    if change == "owner":
        os.chown(tmp_path / "kernels", 12345, 12345)
    touched = tmp_path / "touched"
    (index,) = tmp_path.rglob("*.nbi")
    index.write_bytes(pickle.dumps(_Stranger(touched)))
    assert run(CALL, tmp_path) == ["1", "0"]
    assert touched.exists() == (change == "nothing")


class _Stranger:
    """Runs code when it is read."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self._path,)


def test_processes_that_compile_at_once_keep_all_code(tmp_path: Path) -> None:
    """Code of one kernel for several types, compiled by several processes, ends in files of its own."""
    write_kernel(tmp_path, "caller", "x + 1")
    types = ("1", "1.5", "1j", "True")
    program = (
        "import subprocess, sys\n"
        "call = 'from caller import caller; print(caller({}))'\n"
        f"started = [subprocess.Popen([sys.executable, '-c', call.format(x)]) for x in {types}]\n"
        "[process.wait() for process in started]\n"
    )
    run(program, tmp_path)
    assert len(list(tmp_path.rglob("*.nbi"))) == 1
    hits = (
        f"from caller import caller; print(*map(caller, ({', '.join(types)})), len(caller.stats.cache_hits))"
    )
    assert run(hits, tmp_path) == ["2", "2.5", "(1+1j)", "2", "4"]


def test_loading_and_compiling_are_timed_apart_from_running(tmp_path: Path) -> None:
    """The clock of loading runs when a kernel is first called, in the thread that calls it."""
    write_kernel(tmp_path, "one", "x + 1")
    write_kernel(tmp_path, "two", "one(x)", "from one import one")
    program = (
        "import threading, time; from dvc._jit import loading_time_s; from two import two; found = []\n"
        "before = time.thread_time(), loading_time_s(); two(0)\n"
        "after = time.thread_time(), loading_time_s(); two(0)\n"
        "thread = threading.Thread(target=lambda: found.append(loading_time_s()))\n"
        "thread.start(); thread.join()\n"
        "print(before[1], after[1], after[0] - before[0], loading_time_s(), found[0])"
    )
    for share in (0.9, 0.5):  # compiled, then loaded
        before, loading, spent, again, other = map(float, run(program, tmp_path))
        assert other == 0.0
        assert share * spent < loading - before < spent
        assert again == loading
