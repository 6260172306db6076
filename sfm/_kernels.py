"""Compiled loops of `sfm.decompositions`."""

import math

from dvc._jit import kernel

MAX_SWEEPS = 40
MAX_STEPS = 200
PRECISION = 1e-15
"""Largest cosine between orthogonal columns."""
NOTHING = 1e-31
"""Share of the sum of squares below which a product of columns is a rounding error."""


@kernel
def orthogonalise(columns, basis):
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
def rotate(a, p, q, cosine, sine):
    """Rotate two columns."""
    for i in range(a.shape[0]):
        left, right = a[i, p], a[i, q]
        a[i, p] = cosine * left - sine * right
        a[i, q] = sine * left + cosine * right


@kernel
def real_roots(coefficients, roots):
    """Find real roots (N, 3), in rising order, of cubics (N, 4) with the constant first; nan fills."""
    for number in range(coefficients.shape[0]):
        lead = coefficients[number, 3]
        c, b, a = (
            coefficients[number, 0] / lead,
            coefficients[number, 1] / lead,
            coefficients[number, 2] / lead,
        )
        reach = 1.0 + max(abs(a), abs(b), abs(c))
        inside = a * a - 3.0 * b
        turn = math.sqrt(inside) if inside > 0.0 else 0.0
        ends = (-reach, (-a - turn) / 3.0, (-a + turn) / 3.0, reach)
        for k in range(3):
            roots[number, k] = root_between(a, b, c, ends[k], ends[k + 1])


@kernel
def root_between(a, b, c, low, high):
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
