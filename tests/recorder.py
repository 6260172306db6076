"""Notes which kernels programs call from Python, and with which types, as lines of `dvc/kernels.txt`.

Every process with the environment of `recording` imports this module, in which numba is told to find out
where code is kept, and adds to a file what it calls.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core import caching, dispatcher

from dvc.compile_kernels import KERNELS

Locator = caching.UserProvidedCacheLocator if "NUMBA_CACHE_DIR" in os.environ else caching.InTreeCacheLocator
ROOT = Path(__file__).resolve().parents[1]
DISPATCHER: Any = dispatcher.Dispatcher
_compile = DISPATCHER._compile_for_args


@contextmanager
def recording(folder: Path) -> Iterator[dict[str, str]]:
    """Give an environment; what programs call in it must be listed, or with `DVC_REGENERATE=1` becomes so."""
    called = folder / "called.txt"
    called.touch()
    yield os.environ | {
        "DVC_CALLED": str(called),
        "NUMBA_CACHE_LOCATOR_CLASSES": f"{__name__}.Locator",
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])),
    }
    listed = KERNELS.read_text(encoding="utf-8").splitlines()
    missing = set(called.read_text(encoding="utf-8").splitlines()) - set(listed)
    if os.environ.get("DVC_REGENERATE") == "1":
        KERNELS.write_text("".join(f"{line}\n" for line in sorted({*listed, *missing})), encoding="utf-8")
    else:
        assert sorted(missing) == []


def text(kind: Any) -> str:
    """Write a type as `dvc._jit.compile_for` reads it."""
    if not hasattr(kind, "instance_class"):
        return repr(kind)
    named = kind.instance_class
    return f"{named.__module__}.{named.__qualname__}({', '.join(map(text, kind.types))})"


def record(kernel: Any, *arguments: object) -> Any:
    """Note the types of a call that numba has no code for yet in this process, and get it."""
    types = ", ".join(text(kernel.typeof_pyval(argument)) for argument in arguments)
    function = kernel.py_func
    if "<locals>" not in function.__qualname__:  # those of turbo codes are made for a trellis
        with open(os.environ["DVC_CALLED"], "a", encoding="utf-8") as called:
            called.write(f"{function.__module__} {function.__qualname__} ({types},)\n")
    return _compile(kernel, *arguments)


if "DVC_CALLED" in os.environ:
    DISPATCHER._compile_for_args = record
