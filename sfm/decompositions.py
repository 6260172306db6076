"""Singular vectors by Jacobi rotations, and roots of cubics: the same digits on any x86-64 processor.

References
----------
[Hestenes1958] M. R. Hestenes, "Inversion of matrices by biorthogonalization and related results," J. SIAM,
vol. 6, no. 1, 1958.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RANK = 1e-14
"""Share of the largest singular value below which singular values count as zero."""


def right_singular(matrices: Floats) -> tuple[Floats, Floats]:
    """Return singular values (..., n), the largest first, and right singular vectors, rows of (..., n, n).

    If a matrix has fewer rows than columns, the last vectors span its null space.
    """
    _, values, rows = _decomposed(matrices)
    return values, rows


def least_singular(matrices: Floats) -> Floats:
    """Return the right singular vectors (..., n) of the least values; for Gram matrices the eigenvectors."""
    rows: Floats = _decomposed(matrices)[2][..., -1, :]
    return rows


def svd(matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Return u, s and vt of a matrix of 3x3; for singular matrices u is completed to be orthogonal."""
    columns, values, rows = _decomposed(matrix)
    rank = int(np.count_nonzero(values > RANK * values[0]))
    u = np.eye(3)
    if rank:
        u[:, :rank] = columns[:, :rank] / values[:rank]
    if rank == 1:
        across = np.cross(u[:, 0], np.eye(3)[np.abs(u[:, 0]).argmin()])
        u[:, 1] = across / np.sqrt((across * across).sum())
    if 1 <= rank < 3:
        u[:, 2] = np.cross(u[:, 0], u[:, 1])
    return u, values, rows


def real_roots(coefficients: Floats) -> Floats:
    """Return the real roots (N, 3), in rising order, of cubics (N, 4) with the constant first; nan fills."""
    from sfm import _kernels

    roots = np.empty((len(coefficients), 3))
    _kernels.real_roots(coefficients, roots)
    return roots


def _decomposed(matrices: Floats) -> tuple[Floats, Floats, Floats]:
    """Return orthogonal columns, the largest first, their lengths, and the rows that produce them."""
    from sfm import _kernels

    height, width = matrices.shape[-2:]
    columns = np.array(matrices, np.float64).reshape(-1, height, width)
    basis = np.broadcast_to(np.eye(width), (len(columns), width, width)).copy()
    _kernels.orthogonalise(columns, basis)
    lengths = np.sqrt((columns * columns).sum(axis=1))
    order = np.argsort(-lengths, axis=1, kind="stable")
    shape = matrices.shape[:-2]
    columns, basis = (np.take_along_axis(a, order[:, None], axis=2) for a in (columns, basis))
    lengths = np.take_along_axis(lengths, order, axis=1).reshape(*shape, width)
    rows = basis.transpose(0, 2, 1).reshape(*shape, width, width)
    return columns.reshape(*shape, height, width), lengths, rows
