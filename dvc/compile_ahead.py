"""Kernels compiled by spare cores before a program comes to them, where none is on disk yet.

Without compiled kernels on disk a program compiles one after another, as it needs them, for most of a minute.
Each program has a list of what it needs, in order of first use. Background processes go through it from its
end and leave what they compile in numba's cache; they meet the program, which looks there first, half-way.

`DVC_REGENERATE=1`, for `tests/test_compile_ahead.py`, adds to the lists what programs call.
"""

import importlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha1
from pathlib import Path
from typing import NamedTuple

from dvc.environment import baseline_environment

MAX_PROCESSES = 3


class Kernel(NamedTuple):
    """A line of a list: what is called from Python, and the types of its arguments."""

    module: str  # where it is
    name: str  # a kernel, or a function that makes one with its arguments, whole numbers: `make(1,2)`
    signature: str  # see `dvc._jit.compile_for`

    def compile(self) -> None:
        """Compile it, unless it is on disk."""
        from dvc._jit import compile_for

        name, *numbers = self.name.rstrip(")").replace("(", ",").split(",")
        function = getattr(importlib.import_module(self.module), name)
        compile_for(function(*map(int, numbers)) if numbers else function, self.signature)


def listed(path: Path) -> list[Kernel]:
    """Read a list; lines that are no kernels are left out."""
    lines = (line.split(" ", 2) for line in path.read_text(encoding="utf-8").splitlines())
    return [Kernel(*parts) for parts in lines if len(parts) == 3]


@contextmanager
def compiling_ahead(path: Path, num_busy: int = 1) -> Iterator[None]:
    """Let spare cores compile the kernels of a list while the body runs, if any is missing on disk."""
    with ExitStack() as stack:
        count = min(len(os.sched_getaffinity(0)) - num_busy, MAX_PROCESSES)
        if count > 0 and _enabled() and _missing(path):
            environment = baseline_environment()
            for part in range(count):
                with suppress(OSError):  # the program does without
                    process = _start(["-m", __name__, path, part, count, os.getpid()], environment)
                    stack.callback(process.wait)
                    stack.callback(process.kill)
        yield


def _enabled() -> bool:
    return os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")


def _missing(path: Path) -> bool:
    """Tell whether a kernel was never compiled here, and can be kept; numba is not loaded for that."""
    present: dict[Path, set[str]] = {}
    for kernel in listed(path):
        source = path.resolve().parents[1].joinpath(*kernel.module.split(".")).with_suffix(".py")
        folder = _cache_folder(source)
        if folder not in present:
            if not _writable(folder):
                return False
            present[folder] = {
                file.name.partition("-")[0].partition(".locals")[0] for file in folder.glob("*.nbi")
            }
        if f"{source.stem}.{kernel.name.partition('(')[0]}" not in present[folder]:
            return True
    return False


def _cache_folder(source: Path) -> Path:
    root = os.environ.get("NUMBA_CACHE_DIR")
    if not root:
        return source.parent / "__pycache__"
    return Path(root) / f"{source.parent.name}_{sha1(str(source.parent).encode()).hexdigest()}"


def _writable(folder: Path) -> bool:
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return os.access(existing, os.W_OK)


def _start(arguments: list[object], environment: dict[str, str]) -> subprocess.Popen[bytes]:
    nothing = subprocess.DEVNULL
    command = [sys.executable, "-P", *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stdin=nothing, stdout=nothing, stderr=nothing)


def compile_part(path: Path, part: int, count: int, parent: int) -> None:
    """Compile one part of a list, the last kernel first, for as long as who wants them lives."""
    for kernel in listed(path)[::-1][part::count]:
        if os.getppid() != parent:
            return
        with suppress(Exception):  # what cannot be compiled here is compiled, or reported, where it is used
            kernel.compile()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this process ends it
    os.nice(19)
    compile_part(Path(sys.argv[1]), *map(int, sys.argv[2:]))
