"""Small systems of normal equations, solved the same way on any number of threads."""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TINY = 1e-300
SMALLEST_PIVOT = 1e-13  # relative to the diagonal


def solve_damped(matrix: Floats, right: Floats, damping: float) -> Floats:
    """Solve a damped positive semidefinite system by Cholesky's method.

    Written out, because at this size the threads of the library cost more than they save.

    Parameters
    ----------
    matrix : ndarray of shape (D, D), float64
        Symmetric, positive semidefinite.
    right : ndarray of shape (D,), float64
        Right hand side.
    damping : float
        What is added to the diagonal, relative to it (Levenberg-Marquardt).

    Returns
    -------
    ndarray of shape (D,), float64
        The solution; 0 for variables that the system does not determine.
    """
    diagonal = np.diag(matrix)
    scale = np.where(diagonal > 0, 1.0 / np.sqrt(np.maximum(diagonal, TINY)), 0.0)
    left = scale[:, None] * matrix * scale
    solution = scale * right
    size = len(left)
    left[np.arange(size), np.arange(size)] += damping
    for k in range(size):
        if left[k, k] <= SMALLEST_PIVOT:
            left[k:, k] = 0.0
            solution[k] = 0.0
            continue
        left[k:, k] /= math.sqrt(left[k, k])
        below = left[k + 1 :, k]
        left[k + 1 :, k + 1 :] -= below[:, None] * below
        solution[k] /= left[k, k]
        solution[k + 1 :] -= below * solution[k]
    for k in range(size - 1, -1, -1):
        if left[k, k] > 0:
            solution[k] = (solution[k] - (left[k + 1 :, k] * solution[k + 1 :]).sum()) / left[k, k]
    return scale * solution
