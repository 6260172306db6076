"""Proof that compiled kernels check bounds: `python -m benchmarks.hostile.bounds`."""

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.errors import DvcError

BOUNDS = "NUMBA_BOUNDSCHECK"
"""Variable of the environment that makes kernels check bounds."""
_LENGTH = 3


@kernel
def wrong_read(array: NDArray[np.int64], index: int) -> int:
    """Read an element that may not be there."""
    return int(array[index])


@kernel
def wrong_write(array: NDArray[np.int64], index: int) -> None:
    """Write an element that may not be there, in two dimensions."""
    array.reshape(1, -1)[0, index] = 1


def check_bounds() -> None:
    """Raise `DvcError` if kernels accept a wrong index, so that no later result would prove anything."""
    array = np.zeros(_LENGTH + 8, np.int64)[4 : 4 + _LENGTH]  # harmless if bounds are not checked
    for function in (wrong_read, wrong_write):
        for index in (_LENGTH, -_LENGTH - 1):
            try:
                function(array, index)
            except IndexError:
                continue
            raise DvcError(f"{function.__name__} takes index {index} of {_LENGTH}: bounds are not checked")


if __name__ == "__main__":
    check_bounds()
    print(f"indices {_LENGTH} and {-_LENGTH - 1} of an array of {_LENGTH} are refused in compiled code")
