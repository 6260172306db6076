"""What child processes and libraries take from their surroundings: nothing of the current folder.

Who runs a program in a folder of strangers wants none of their code and settings. Python looks there for
modules, numba and matplotlib for settings, and the loader for shared libraries once OpenCV is loaded: it
leaves an empty entry in `LD_LIBRARY_PATH`.
"""

import os
import platform
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

COMPILATION_NOTICE = "DVC_COMPILATION_NOTICE"
"""Variable with the line to print when the first kernel is compiled; if it is empty, none is printed."""

_LOCK = threading.RLock()

SINGLE_THREADED = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
"""Limits compiled kernels, linear algebra and OpenCV to one thread."""

ONE_HEAP = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
}
"""Lets threads use memory that others have freed: the GNU C library else gives each a heap of its own, or as
in a Dask worker gives memory back to the system at once, which takes half as much time again."""

_X86_BASELINE = {
    "OPENBLAS_CORETYPE": "Nehalem",
    # Names as OpenCV prints them; its libraries start at SSE3, and all of x86-64-v2 has SSE4.2.
    "OPENCV_CPU_DISABLE": "AVX,FP16,AVX2,FMA3,AVX512-SKX",
    "OPENCV_IPP": "disabled",
    "NUMBA_DISABLE_INTEL_SVML": "1",
    # The mathematical functions of the C library come with and without fused multiply and add; the
    # second names are those of versions before 2.33.
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable,-FMA4_Usable",
}
_ARM_BASELINE = {"OPENBLAS_CORETYPE": "ARMV8"}


def python_module(module: str, *words: object) -> list[str]:
    """Return the command that runs a module in a process of its own, with `child_environment`."""
    return [sys.executable, "-P", "-m", module, *map(str, words)]


def child_environment() -> dict[str, str]:
    """Return an environment in which Python finds the modules of this process, and no others."""
    path = os.pathsep.join(path or os.getcwd() for path in sys.path)
    return {**os.environ, **_library_path(), "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}


def _library_path() -> dict[str, str]:
    """Return where shared libraries are looked for, without empty entries, which are the current folder."""
    found = os.environ.get("LD_LIBRARY_PATH")
    return {} if found is None else {"LD_LIBRARY_PATH": ":".join(filter(None, found.split(":")))}


@contextmanager
def without_settings(name: str) -> Iterator[None]:
    """Import a library that would read settings from a file of this name in the current folder."""
    with _LOCK:
        os.environ |= _library_path()  # matplotlib starts a program
        exists = os.path.exists
        os.path.exists = lambda path: path != name and exists(path)
        try:
            yield
        finally:
            os.path.exists = exists


def baseline_environment() -> dict[str, str]:
    """Return an environment in which libraries compute the same on every processor of a family."""
    import numpy as np

    environment = {**child_environment(), **SINGLE_THREADED, "OPENCV_LOG_LEVEL": "ERROR"}
    environment.pop("NPY_ENABLE_CPU_FEATURES", None)
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    dispatched = [*extensions.get("found", []), *extensions.get("not found", [])]
    environment["NPY_DISABLE_CPU_FEATURES"] = " ".join(dispatched)
    machine = platform.machine().lower()
    return environment | (_X86_BASELINE if machine in ("x86_64", "amd64") else _ARM_BASELINE)
