"""Compiled kernels: their decorators, the cache of their machine code, and the notice of compilation."""

import fcntl
import os
import shutil
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha1
from pathlib import Path
from typing import Any, TextIO, TypeVar, cast

import numpy as np

import dvc
from dvc.environment import COMPILATION_NOTICE, without_settings
from dvc.memory import resident_bytes

with without_settings(".numba_config.yaml"):
    import numba
    from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

_CONFIG: Any = numba.config
_CONFIG._config_fname = ""  # numba looks for the file again at each compilation
_CONFIG.reload_config()  # numba may have been imported before

if "numba.np.arraymath" not in sys.modules:
    # No kernel multiplies matrices; numba would import scipy's linear algebra for that.
    sys.modules["scipy.linalg.cython_blas"] = cast(Any, None)
    with without_settings(".numba_config.yaml"):
        import numba.np.arraymath
    del sys.modules["scipy.linalg.cython_blas"]


def kernel(function: Function) -> Function:
    """Compile a function at its first call, cache its machine code, and release the GIL while it runs."""
    return _compiled(function)


def inlined_kernel(function: Function) -> Function:
    """Compile a function as `kernel` does, as a part of the kernels that call it."""
    return _compiled(function, inline=True)


def _compiled(function: Function, inline: bool = False) -> Function:
    locators = _CONFIG.CACHE_LOCATOR_CLASSES
    _CONFIG.CACHE_LOCATOR_CLASSES = f"{__name__}.KernelCache"
    try:
        njit = cast(Any, numba.njit)  # kernels take less time to compile without what C would call
        decorator = njit(
            cache=True, nogil=True, error_model="numpy", forceinline=inline, no_cfunc_wrapper=True
        )
        return cast(Function, decorator(function))
    finally:
        _CONFIG.CACHE_LOCATOR_CLASSES = locators


def python_twin(function: Function) -> Function:
    """Return the Python function behind a kernel, whether the JIT is on or off."""
    return cast(Function, getattr(function, "py_func", function))


class KernelCache:
    """Files of the machine code of one kernel, for numba's `CACHE_LOCATOR_CLASSES`.

    They are named by the contents of all sources that the code comes from, so that trees share them.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._folder = cache_folder() / function.__module__
        self._digest = sha1(repr(_stamps(function)).encode()).hexdigest()[:16]

    @classmethod
    def from_function(cls, function: Callable[..., Any], _path: str) -> "KernelCache":
        """Return the files of a kernel."""
        return cls(function)

    def get_cache_path(self) -> str:
        """Return their folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return the digest of the sources."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Return a part of the file names."""
        return self._digest

    def ensure_cache_path(self) -> None:
        """Make the folder, and lock it until numba has written its two files."""
        self._folder.mkdir(parents=True, exist_ok=True)
        _COMPILING.lock = (self._folder / ".lock").open("a")
        fcntl.flock(_COMPILING.lock, fcntl.LOCK_EX)


@cache
def cache_folder() -> Path:
    """Return the folder of machine code: `NUMBA_CACHE_DIR` or one in the user's cache folder.

    If it cannot be written to, or strangers can, the folder is a temporary one.
    """
    with suppress(OSError, RuntimeError):  # no home
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = Path(_CONFIG.CACHE_DIR).absolute() if _CONFIG.CACHE_DIR else caches / "dvc3d" / "kernels"
        if folder.is_absolute():
            with suppress(OSError):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if _is_trusted(folder):
                return folder if os.access(folder, os.W_OK) else _temporary_folder(folder)
    return _temporary_folder()


def _is_trusted(folder: Path) -> bool:
    """Return whether only the user, root, and the owner of the package can have written to a folder."""
    status, owner = folder.stat(), Path(dvc.__file__).stat().st_uid
    return status.st_uid in (os.geteuid(), 0, owner) and not status.st_mode & stat.S_IWOTH


_TEMPORARY: list[tempfile.TemporaryDirectory[str]] = []


def _temporary_folder(source: Path | None = None) -> Path:
    """Make a folder for the life of this process and its children, with links to files that exist already."""
    _TEMPORARY.append(tempfile.TemporaryDirectory(prefix="dvc3d-kernels-"))
    folder = Path(_TEMPORARY[-1].name)
    if source is not None:
        shutil.copytree(source, folder, copy_function=os.symlink, dirs_exist_ok=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return folder


_STAMPS: dict[Callable[..., Any], set[str]] = {}
"""Sources and constants of each kernel."""


def _stamps(function: Callable[..., Any]) -> list[str]:
    """List the compiler, the file and constants of a kernel, and those of kernels that it calls."""
    code = function.__code__
    stamps = {numba.__version__, f"bounds: {_CONFIG.BOUNDSCHECK}", _digest(code.co_filename)}
    for name in code.co_names:
        value: Any = function.__globals__.get(name)
        if isinstance(value, bool | int | float | tuple):
            stamps.add(f"{name} = {value!r}")
        elif isinstance(value, np.ndarray):
            stamps.add(f"{name} = {sha1(value.tobytes()).hexdigest()}")
        elif callable(value):
            stamps |= _STAMPS.get(python_twin(value), set())
    _STAMPS[function] = stamps
    return sorted(stamps)


@cache
def _digest(path: str) -> str:
    return sha1(Path(path).read_bytes()).hexdigest()


class _Compiling(threading.local):
    """Loading and compiling in one thread."""

    depth = 0
    seconds = 0.0
    num_bytes = 0
    started_s = 0.0
    held_bytes = 0
    lock: TextIO | None = None


_COMPILING = _Compiling()


def loading_time_s() -> float:
    """Return the processor time that this thread has spent on loading and compiling kernels."""
    return _COMPILING.seconds


def loaded_bytes() -> int:
    """Return the growth of this process while this thread was loading and compiling kernels."""
    return _COMPILING.num_bytes


class _LockListener(event.Listener):
    """Times the compiler's lock, which numba holds while it loads, or compiles and saves, a kernel."""

    def on_start(self, event: Any) -> None:
        """Start the clock."""
        if _COMPILING.depth == 0:
            _COMPILING.started_s, _COMPILING.held_bytes = time.thread_time(), resident_bytes()
        _COMPILING.depth += 1

    def on_end(self, event: Any) -> None:
        """Stop the clock; unlock the folder of code that has been saved."""
        if _COMPILING.lock is not None:
            _COMPILING.lock.close()
            _COMPILING.lock = None
        _COMPILING.depth -= 1
        if _COMPILING.depth == 0:
            _COMPILING.seconds += time.thread_time() - _COMPILING.started_s
            _COMPILING.num_bytes += max(resident_bytes() - _COMPILING.held_bytes, 0)


class _CompileListener(event.Listener):
    """Prints the notice of `dvc.environment` when the first kernel is compiled."""

    def on_start(self, event: Any) -> None:
        """Print it once."""
        notice = os.environ.get(COMPILATION_NOTICE)
        if notice:
            os.environ[COMPILATION_NOTICE] = ""
            sys.stderr.write(f"{notice}\n")

    def on_end(self, event: Any) -> None:
        """Do nothing."""


event.register("numba:compiler_lock", _LockListener())
event.register("numba:compile", _CompileListener())
