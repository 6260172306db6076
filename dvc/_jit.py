"""The one door to numba: every compiled kernel of the project is declared through it."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a kernel on first call, keep the machine code on disk, and release the GIL while it runs.

    Strict IEEE arithmetic (no ``fastmath``): results must not depend on the processor.

    Parameters
    ----------
    function : callable
        A function of arrays and scalars in the subset of Python that numba compiles.

    Returns
    -------
    callable
        The compiled function; with ``NUMBA_DISABLE_JIT=1`` the function itself.
    """
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def python_twin(function: Function) -> Function:
    """Return the Python function behind a kernel, whether the JIT is on or off.

    Parameters
    ----------
    function : callable
        What `kernel` returned.

    Returns
    -------
    callable
        The undecorated function.
    """
    return cast(Function, getattr(function, "py_func", function))
