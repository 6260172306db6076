"""Singular vectors and roots: what they must be, beside numpy's, and to the last digit."""

import hashlib

import numpy as np
import pytest
from numpy.typing import NDArray

from sfm import decompositions as kernels
from sfm.decompositions import least_singular, real_roots, right_singular, svd
from tests.twins import Choose

Floats = NDArray[np.float64]
SHAPES = (40, 7, 9), (20, 9, 9), (3, 300, 9), (5, 4, 12), (40, 3, 3), (2, 1, 4), (5, 2)


@pytest.mark.parametrize("shape", SHAPES)
def test_singular_values_are_those_of_numpy(shape: tuple[int, ...]) -> None:
    """The vectors are orthonormal and make orthogonal columns; what is given is left as it was."""
    matrices = np.random.default_rng(1).normal(size=shape)
    kept = matrices.copy()
    values, rows = right_singular(matrices)
    np.testing.assert_array_equal(matrices, kept)
    expected = np.zeros(values.shape)
    of_numpy = np.linalg.svd(matrices, compute_uv=False)
    expected[..., : of_numpy.shape[-1]] = of_numpy
    scale = expected.max()
    np.testing.assert_allclose(values, expected, atol=1e-14 * scale)
    identity = np.broadcast_to(np.eye(shape[-1]), rows.shape)
    np.testing.assert_allclose(rows @ np.swapaxes(rows, -1, -2), identity, atol=1e-14)
    columns = matrices @ np.swapaxes(rows, -1, -2)
    lengths = np.swapaxes(columns, -1, -2) @ columns
    np.testing.assert_allclose(lengths, values[..., None] ** 2 * identity, atol=1e-14 * scale**2)
    np.testing.assert_array_equal(least_singular(matrices), rows[..., -1, :])


@pytest.mark.parametrize("rank", range(4))
def test_u_is_completed_where_a_matrix_is_singular(rank: int) -> None:
    rng = np.random.default_rng(rank)
    matrix = rng.normal(size=(3, rank)) @ rng.normal(size=(rank, 3))
    u, values, vt = svd(matrix)
    np.testing.assert_allclose(u * values @ vt, matrix, atol=1e-14)
    np.testing.assert_allclose(u @ u.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(vt @ vt.T, np.eye(3), atol=1e-14)
    assert np.count_nonzero(values > 1e-12) == rank


def test_vectors_of_gram_matrices_are_eigenvectors() -> None:
    rows = np.random.default_rng(2).normal(size=(30, 9))
    normal = rows.T @ rows
    eigenvalues, vectors = np.linalg.eigh(normal)
    np.testing.assert_allclose(right_singular(normal)[0], eigenvalues[::-1], rtol=1e-12)
    assert abs(least_singular(normal) @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-12)


def test_roots_are_those_of_numpy() -> None:
    coefficients = np.random.default_rng(3).normal(size=(300, 4))
    found = real_roots(coefficients)
    counts = set()
    for roots, cubic in zip(found, coefficients, strict=True):
        of_numpy = np.roots(cubic[::-1])
        expected = np.sort(of_numpy.real[np.abs(of_numpy.imag) < 1e-9])
        real = roots[np.isfinite(roots)]
        np.testing.assert_allclose(real, expected, rtol=1e-11, atol=1e-11)
        counts.add(len(real))
    assert counts == {1, 3}


@pytest.mark.nojit
def test_known_roots(choose: Choose) -> None:
    """(z - 1)(z - 2)(z + 3), a triple root, and z^3 + z."""
    cubics = np.array([[6.0, -7.0, 0.0, 1.0], [-8.0, 12.0, -6.0, 1.0], [0.0, 1.0, 0.0, 1.0]])
    roots = np.empty((3, 3))
    choose(kernels.find_roots)(cubics, roots)
    np.testing.assert_allclose(roots[0], [-3.0, 1.0, 2.0], rtol=1e-14)
    assert roots[1][np.isfinite(roots[1])] == pytest.approx([2.0], abs=1e-4)
    assert roots[2][np.isfinite(roots[2])] == pytest.approx([0.0], abs=1e-30)


@pytest.mark.nojit
def test_digits_are_always_the_same(choose: Choose) -> None:
    whole = np.arange(2 * 7 * 9) ** 2 % 89 - 44.0
    columns = whole.reshape(2, 7, 9)
    basis = np.broadcast_to(np.eye(9), (2, 9, 9)).copy()
    choose(kernels.orthogonalise)(columns, basis)
    roots = np.empty((2, 3))
    choose(kernels.find_roots)(np.array([[6.0, -7.0, 0.25, 1.0], [3.0, 5.0, -9.0, 7.0]]), roots)
    found = columns.tobytes() + basis.tobytes() + roots[:, 0].tobytes()
    assert hashlib.sha256(found).hexdigest()[:16] == "01b71be2b922e43d"
