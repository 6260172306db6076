"""Singular vectors by Jacobi rotations, and roots of cubics: the same digits on any x86-64 processor.

References
----------
[Hestenes1958] M. R. Hestenes, "Inversion of matrices by biorthogonalization and related results," J. SIAM,
vol. 6, no. 1, 1958.
"""

import math

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Floats

RANK = 1e-14
"""Share of the largest singular value below which singular values count as zero."""
MAX_SWEEPS = 40
MAX_STEPS = 200
PRECISION = 1e-15
"""Largest cosine between orthogonal columns."""
NOTHING = 1e-31
"""Share of the sum of squares below which a product of columns is a rounding error."""


def right_singular(matrices: Floats) -> tuple[Floats, Floats]:
    """Return singular values (..., n), falling, and right singular vectors as rows, null space included."""
    _, values, rows = _decomposed(matrices)
    return values, rows


def least_singular(matrices: Floats) -> Floats:
    """Return the right singular vectors (..., n) of the least values; for Gram matrices the eigenvectors."""
    return _decomposed(matrices)[2][..., -1, :]


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
    roots = np.empty((len(coefficients), 3))
    find_roots(coefficients, roots)
    return roots


def _decomposed(matrices: Floats) -> tuple[Floats, Floats, Floats]:
    """Return orthogonal columns, the largest first, their lengths, and the rows that produce them."""
    height, width = matrices.shape[-2:]
    columns = np.array(matrices, np.float64, order="C").reshape(-1, height, width)
    basis = np.broadcast_to(np.eye(width), (len(columns), width, width)).copy()
    orthogonalise(columns, basis)
    lengths = np.sqrt((columns * columns).sum(axis=1))
    order = np.argsort(-lengths, axis=1, kind="stable")
    shape = matrices.shape[:-2]
    columns, basis = (np.take_along_axis(a, order[:, None], axis=2) for a in (columns, basis))
    lengths = np.take_along_axis(lengths, order, axis=1).reshape(*shape, width)
    rows = basis.transpose(0, 2, 1).reshape(*shape, width, width)
    return columns.reshape(*shape, height, width), lengths, rows


@kernel
def orthogonalise(columns: Floats, basis: Floats) -> None:
    """Rotate pairs of columns (N, m, n), and of a basis (N, n, n) with them, until all are orthogonal."""
    for number in range(columns.shape[0]):
        a, v = columns[number], basis[number]
        whole = 0.0
        for i in range(a.shape[0]):
            for j in range(a.shape[1]):
                whole += a[i, j] * a[i, j]
        for _ in range(MAX_SWEEPS):
            is_done = True
            for p in range(a.shape[1] - 1):
                for q in range(p + 1, a.shape[1]):
                    first = second = product = 0.0
                    for i in range(a.shape[0]):
                        first += a[i, p] * a[i, p]
                        second += a[i, q] * a[i, q]
                        product += a[i, p] * a[i, q]
                    if abs(product) <= max(PRECISION * math.sqrt(first * second), NOTHING * whole):
                        continue
                    is_done = False
                    half = (second - first) / (2.0 * product)
                    tangent = math.copysign(1.0, half) / (abs(half) + math.sqrt(1.0 + half * half))
                    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
                    rotate(a, p, q, cosine, cosine * tangent)
                    rotate(v, p, q, cosine, cosine * tangent)
            if is_done:
                break


@kernel
def rotate(a: Floats, p: int, q: int, cosine: float, sine: float) -> None:
    """Rotate two columns."""
    for i in range(a.shape[0]):
        left, right = a[i, p], a[i, q]
        a[i, p] = cosine * left - sine * right
        a[i, q] = sine * left + cosine * right


@kernel
def find_roots(coefficients: Floats, roots: Floats) -> None:
    """Find real roots (N, 3), in rising order, of cubics (N, 4) with the constant first; nan fills."""
    for number in range(coefficients.shape[0]):
        cubic, lead = coefficients[number], coefficients[number, 3]
        a, b, c = cubic[2] / lead, cubic[1] / lead, cubic[0] / lead
        reach = 1.0 + max(abs(a), abs(b), abs(c))
        inside = a * a - 3.0 * b
        turn = math.sqrt(inside) if inside > 0.0 else 0.0
        ends = (-reach, (-a - turn) / 3.0, (-a + turn) / 3.0, reach)
        for k in range(3):
            roots[number, k] = root_between(a, b, c, ends[k], ends[k + 1])


@kernel
def root_between(a: float, b: float, c: float, low: float, high: float) -> float:
    """Find a root of z^3 + a z^2 + b z + c in an interval, by Newton steps within it; nan without one."""
    at_low, at_high = ((low + a) * low + b) * low + c, ((high + a) * high + b) * high + c
    if low == high or (at_low > 0.0) == (at_high > 0.0):
        return math.nan
    z = 0.5 * (low + high)
    for _ in range(MAX_STEPS):
        value = ((z + a) * z + b) * z + c
        if (value > 0.0) == (at_high > 0.0):
            high = z
        else:
            low = z
        slope = (3.0 * z + 2.0 * a) * z + b
        after = z - value / slope if slope != 0.0 else low
        if not low < after < high:
            after = 0.5 * (low + high)
        if after == z:
            break
        z = after
    return z
