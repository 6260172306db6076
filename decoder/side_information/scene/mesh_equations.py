"""The linear equations of a triangular mesh: epipolar lines, barycentric weights, roughness.

References
----------
[Maitre2008] Sec. 5.3.3, Eqs. (5.9) and (5.10).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dvc.geometry.cameras import homogeneous

Floats = NDArray[np.float64]


def epipolar_lines(warp: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the epipolar lines of points as the closest place to the point itself and a direction."""
    at_infinity = homogeneous(points) @ warp[:, :3].T
    line = np.cross(warp[:, 3], at_infinity)
    length = np.hypot(line[:, 0], line[:, 1])
    defined = length > 1e-12 * max(float(np.abs(line).max(initial=0.0)), 1e-300)
    line = np.where(defined[:, None], line / np.where(defined, length, 1.0)[:, None], [1.0, 0.0, 0.0])
    distance = np.where(defined, (line[:, :2] * points).sum(axis=1) + line[:, 2], 0.0)
    return points - distance[:, None] * line[:, :2], np.column_stack([-line[:, 1], line[:, 0]])


class Barycentric(NamedTuple):
    """Where points lie in a mesh."""

    vertices: NDArray[np.int64]  # corners of the triangle
    weights: Floats  # their weights, which sum to 1
    triangle: NDArray[np.int64]  # the triangle: two a cell, upper left before lower right

    def interpolate(self, values: Floats) -> Floats:
        """Interpolate values (V,) or (V, 2) of the vertices."""
        weights = self.weights.reshape(*self.weights.shape, *(1,) * (values.ndim - 1))
        mixed: Floats = (weights * values[self.vertices]).sum(axis=1)
        return mixed

    def matrix(self, num_vertices: int) -> Any:
        """Return the sparse matrix that `interpolate` applies."""
        rows = np.repeat(np.arange(len(self.vertices)), 3)
        entries = (self.weights.ravel(), (rows, self.vertices.ravel()))
        return sparse.csr_array(entries, shape=(len(self.vertices), num_vertices))


def barycentric(points: Floats, shape: tuple[int, ...], cell: float) -> Barycentric:
    """Find the triangle of each point and its weights: the rows of M in (5.10)."""
    at = (points + cell) / cell
    corner = np.clip(np.floor(at).astype(np.int64), 0, np.array(shape[::-1]) - 2)
    x, y = (at - corner).T
    lower = x + y > 1.0
    first = corner[:, 1] * shape[1] + corner[:, 0]
    right, below = first + 1, first + shape[1]
    vertices = np.column_stack([np.where(lower, below + 1, first), right, below])
    weights = np.column_stack(
        [np.where(lower, x + y - 1, 1 - x - y), np.where(lower, 1 - y, x), np.where(lower, 1 - x, y)]
    )
    triangle = 2 * (corner[:, 1] * (shape[1] - 1) + corner[:, 0]) + lower
    return Barycentric(vertices, weights, triangle)


def roughness_matrix(shape: tuple[int, int]) -> Any:
    """Return ``I - N`` of (5.10), N the mean of the neighbours on both sides."""
    rows, columns = (_second_difference(count) for count in shape)
    along = sparse.kron(sparse.eye_array(shape[0]), columns) + sparse.kron(rows, sparse.eye_array(shape[1]))
    border = np.zeros(shape, dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = True
    return sparse.csr_array(sparse.diags_array(np.where(border, 1.0, 0.5).ravel()) @ along)


def _second_difference(count: int) -> Any:
    """Half the second difference of a line of values, negated; zero rows at its ends."""
    inner = np.ones(count)
    inner[[0, -1]] = 0.0
    sides = -0.5 * inner
    return sparse.diags_array([sides[1:], inner, sides[:-1]], offsets=[-1, 0, 1]).tocsr()
