"""The one door to numba: every compiled kernel of the project is declared through it."""

import ast
import contextlib
import fcntl
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache as cached
from hashlib import sha1
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np

from dvc.memory import resident_bytes

Function = TypeVar("Function", bound=Callable[..., Any])

_CONFIG: Any = numba.config
_ROOT = Path(__file__).resolve().parents[1]


def _skip_blas() -> None:
    """Keep numba from importing scipy's linear algebra for `np.dot`: slow, and not called."""

    def _missing() -> None:
        raise ImportError

    with contextlib.suppress(ImportError, AttributeError):
        linalg: Any = import_module("numba.np.linalg")
        ensure, linalg.ensure_blas = linalg.ensure_blas, _missing
        try:
            import_module("numba.np.arraymath")
        finally:
            linalg.ensure_blas = ensure


_skip_blas()


def _check_bounds() -> None:
    """Refuse negative indices as well where bounds are checked; numba counts them from the end."""
    if not _CONFIG.CACHE_DIR:
        raise RuntimeError("NUMBA_BOUNDSCHECK needs a NUMBA_CACHE_DIR: kernels on disk may check nothing")
    arrays: Any = import_module("numba.np.arrayobj")
    constant: Any = import_module("llvmlite.ir").Constant
    wrapped = arrays.fix_integer_index

    def unwrapped(context: Any, builder: Any, index_type: Any, index: Any, size: Any) -> Any:
        if isinstance(index, constant):  # as it is written in a kernel
            return wrapped(context, builder, index_type, index, size)
        return context.cast(builder, index, index_type, numba.types.intp)

    def folder(path: str) -> str:  # the same in all clones
        return str(Path(path).resolve().relative_to(_ROOT).parent)

    arrays.fix_integer_index = unwrapped
    caching: Any = import_module("numba.core.caching")
    caching.UserProvidedCacheLocator.get_suitable_cache_subpath = staticmethod(folder)


if _CONFIG.BOUNDSCHECK:
    _check_bounds()


def kernel(function: Function) -> Function:
    """Compile a kernel on first call, keep the machine code on disk, and release the GIL while it runs."""
    return _compiled(function)


def inlined_kernel(function: Function) -> Function:
    """Compile a kernel as `kernel` does, and make it part of the kernels that call it."""
    return _compiled(function, forceinline=True, _nrt=False)  # without numba's run-time memory


def _compiled(function: Function, **options: Any) -> Function:
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    _time_loading(compiled)
    cache = getattr(compiled, "_cache", None)
    if cache is not None and hasattr(cache, "cache_path"):
        _lock_cache(cache)
        _stamp_cache(cache, function)
    return cast(Function, compiled)


class _LoadingClock(threading.local):
    """Processor time that a thread has spent on loading and compiling kernels, and memory that this took."""

    seconds = 0.0
    num_bytes = 0
    running = False


_CLOCK = _LoadingClock()


def loading_time_s() -> float:
    """Tell how long this thread has been loading and compiling kernels."""
    return _CLOCK.seconds


def loaded_bytes() -> int:
    """Tell by how much the memory of the process grew while this thread was loading and compiling kernels."""
    return _CLOCK.num_bytes


def _time_loading(compiled: Any) -> None:
    """Let the clock run while a kernel, with all that it calls, is loaded or compiled."""
    compile_now: Callable[[Any], Any] | None = getattr(compiled, "compile", None)
    if compile_now is None:  # the JIT is off
        return

    def timed(signature: Any) -> Any:
        if _CLOCK.running:
            return compile_now(signature)
        started, held, _CLOCK.running = time.thread_time(), resident_bytes(), True
        try:
            return compile_now(signature)
        finally:
            _CLOCK.num_bytes += max(resident_bytes() - held, 0)
            _CLOCK.seconds += time.thread_time() - started
            _CLOCK.running = False

    compiled.compile = timed


def _stamp_cache(cache: Any, function: Callable[..., Any]) -> None:
    """Let machine code serve as long as its source, constants, and kernels that it calls read the same.

    Numba would look at the time of one file alone: an edit of a kernel that is called went unnoticed, and a
    copy of the tree would be compiled anew.
    """
    file, code = cache._cache_file, function.__code__
    stamps = {_digest(code.co_filename)}
    for name in code.co_names:
        value: Any = function.__globals__.get(name)
        called: Any = getattr(value, "_cache", None)
        if hasattr(called, "_cache_file"):
            stamps.update(called._cache_file._source_stamp)
        elif isinstance(value, bool | int | float | tuple):
            stamps.add(f"{name} = {value!r}")
        elif isinstance(value, np.ndarray):
            stamps.add(f"{name} = {sha1(value.tobytes()).hexdigest()}")
    file._source_stamp = sorted(stamps)


@cached
def _digest(path: str) -> str:
    """Return a digest of a source."""
    return sha1(Path(path).read_bytes()).hexdigest()


def _lock_cache(cache: Any) -> None:
    """Let one process at a time read or write a kernel's cache: numba's index and code are separate files."""
    for name in ("load_overload", "save_overload"):
        setattr(cache, name, _locked(getattr(cache, name), Path(cache.cache_path)))


def _locked(method: Callable[..., Any], folder: Path) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        with _file_lock(folder / ".kernels.lock"):
            return method(*arguments)

    return call


@contextlib.contextmanager
def _file_lock(path: Path) -> Iterator[None]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a")
    except OSError:  # nothing can be cached there either
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def python_twin(function: Function) -> Function:
    """Return the Python function behind a kernel, whether the JIT is on or off."""
    return cast(Function, getattr(function, "py_func", function))


def compile_for(function: Callable[..., Any], signature: str) -> None:
    """Compile a kernel without calling it, unless its code is on disk."""
    cast(Any, function).compile(_evaluated(ast.parse(signature, mode="eval").body))


def _evaluated(node: ast.expr) -> Any:
    match node:
        case ast.Tuple():
            return tuple(map(_evaluated, node.elts))
        case ast.Constant():
            return node.value
        case ast.Name():
            return getattr(numba.types, node.id)
        case ast.Call():
            inner = map(_evaluated, node.args)
            if isinstance(node.func, ast.Name):
                named = {str(keyword.arg): _evaluated(keyword.value) for keyword in node.keywords}
                return _evaluated(node.func)(*inner, **named)
            module, _, name = ast.unparse(node.func).rpartition(".")
            named_tuple = getattr(import_module(module), name)
            return cast(Any, numba.types.BaseTuple).from_types(tuple(inner), named_tuple)
    raise ValueError(f"not a type: {ast.unparse(node)}")
