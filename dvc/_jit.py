"""The one door to numba: every compiled kernel of the project is declared through it."""

import ast
import contextlib
import fcntl
import os
import stat
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache as cached
from functools import wraps
from hashlib import sha1
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import numpy.ma  # numba asks for it when a kernel first gets an array

from dvc.environment import without_settings
from dvc.memory import resident_bytes

with without_settings(".numba_config.yaml"):
    import numba
    from numba.core import caching, codegen
    from numba.core.runtime.nrt import rtsys

Function = TypeVar("Function", bound=Callable[..., Any])

_CONFIG: Any = numba.config
_CONFIG._config_fname = ""  # numba looks for the file again whenever it compiles
_CONFIG.reload_config()  # where another has imported numba before
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
    locator: Any = caching.UserProvidedCacheLocator
    locator.get_suitable_cache_subpath = staticmethod(folder)


if _CONFIG.BOUNDSCHECK:
    _check_bounds()


def kernel(function: Function) -> Function:
    """Compile a kernel on first call, keep the machine code on disk, and release the GIL while it runs."""
    return _compiled(function)


def inlined_kernel(function: Function) -> Function:
    """Compile a kernel as `kernel` does, and make it part of the kernels that call it."""
    return _compiled(function, forceinline=True, _nrt=False)  # without numba's run-time memory


def _compiled(function: Function, **options: Any) -> Function:
    compiled: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    if compiled is not function:  # the JIT is on
        _time_loading(compiled)
        compiled._cache = _Cache(function)
    return cast(Function, compiled)


PORTABLE = ("x86-64-v3", "-fma")
"""What `dvc-compile` compiles for: any x86-64 processor with AVX2, without its fused arithmetic."""
_NEEDED = {"+avx2", "+bmi", "+bmi2", "+f16c", "+lzcnt", "+movbe"}
_TOLD: str | None = _CONFIG.CPU_FEATURES
RUNS_PORTABLE = _NEEDED.issubset((codegen.get_host_cpu_features() if _TOLD is None else _TOLD).split(","))
"""Whether this processor, as numba is told or finds, runs such code."""


def _can_be_trusted(folder: Path, source: Path) -> bool:
    """Return whether code can come from no others than the user, root, and who can change its source."""
    if not (folder.is_absolute() or _CONFIG.CACHE_DIR):  # numba's own place where there is no home
        return False
    with contextlib.suppress(OSError):
        found, own = folder.stat(), source.stat()
        known = found.st_uid in (os.geteuid(), 0, own.st_uid)
        return known and not found.st_mode & ~own.st_mode & stat.S_IWOTH
    return True


class _ReadOnlyLocator(caching.InTreeCacheLocator):
    """The folder beside a source, where numba finds none to write to."""

    @classmethod
    def from_function(cls, function: Callable[..., Any], path: str) -> Any:
        return cls(function, path)


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = [*caching.CompileResultCacheImpl._locator_classes, _ReadOnlyLocator]  # noqa: RUF012


class _Cache(caching.FunctionCache):
    """Machine code on disk: first what lies beside the source, then what numba keeps.

    One process at a time reads or writes a folder: numba's index and code are separate files.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        kept = self._cache_file
        kept._source_stamp = _stamps(function)
        beside = Path(function.__code__.co_filename).with_name("__pycache__")
        made = caching.IndexDataCacheFile(str(beside), self._impl.filename_base, kept._source_stamp)
        # Code beside the source does not check bounds.
        files = [kept] if _CONFIG.BOUNDSCHECK or beside == Path(self.cache_path) else [made, kept]
        source = Path(function.__code__.co_filename)
        self._files = [file for file in files if _can_be_trusted(Path(file._cache_path), source)]

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the code for a signature, None where there is none.

        What numba can compile it looks up once there is something to compile; code needs its run-time only.
        """
        rtsys.initialize(context)
        types, (triple, *own), code = self._index_key(signature, context.codegen())
        for file in self._files:
            for processor in [PORTABLE, own] if RUNS_PORTABLE else [own]:
                with _file_lock(Path(file._cache_path)):
                    found = file.load((types, (triple, *processor), code))
                if found is not None:
                    return self._impl.rebuild(context, found)
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the code for a signature, where there is a folder for it."""
        if self._cache_file not in self._files:
            return
        with _file_lock(Path(self.cache_path)), contextlib.suppress(OSError):
            super().save_overload(signature, result)


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
    """Let the clock run while a kernel, with all that it calls, is looked up, and loaded or compiled."""

    def timed(done: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(done)
        def run(*arguments: Any, **named: Any) -> Any:
            if _CLOCK.running:
                return done(*arguments, **named)
            started, held, _CLOCK.running = time.thread_time(), resident_bytes(), True
            try:
                return done(*arguments, **named)
            finally:
                _CLOCK.num_bytes += max(resident_bytes() - held, 0)
                _CLOCK.seconds += time.thread_time() - started
                _CLOCK.running = False

        return run

    compiled.compile = timed(compiled.compile)
    compiled._compile_for_args = timed(compiled._compile_for_args)  # for arguments of new types
    compiled.typeof_pyval = timed(compiled.typeof_pyval)  # for arguments of types never met before


def _stamps(function: Callable[..., Any]) -> list[str]:
    """Let machine code serve as long as its source, constants, and kernels that it calls read the same.

    Numba would look at one file alone: an edit of a kernel that is called went unnoticed.
    """
    code = function.__code__
    stamps = {_digest(code.co_filename)}
    for name in code.co_names:
        value: Any = function.__globals__.get(name)
        called: Any = getattr(value, "_cache", None)
        if isinstance(called, _Cache):
            stamps.update(called._cache_file._source_stamp)
        elif isinstance(value, bool | int | float | tuple):
            stamps.add(f"{name} = {value!r}")
        elif isinstance(value, np.ndarray):
            stamps.add(f"{name} = {sha1(value.tobytes()).hexdigest()}")
    return sorted(stamps)


@cached
def _digest(path: str) -> str:
    """Return a digest of a source."""
    return sha1(Path(path).read_bytes()).hexdigest()


@contextlib.contextmanager
def _file_lock(folder: Path) -> Iterator[None]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / ".kernels.lock").open("a")
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
