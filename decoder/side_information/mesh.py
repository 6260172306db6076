"""Method `mesh`: a triangular mesh on the first key frame with vertices that move along epipolar lines.

It is fitted to the correspondences by linear least squares with smooth motion; correspondences in triangles
that turn over or compensate badly are dropped, and the fit repeated. [Maitre2008] Sec. 5.3.3, Eqs. (5.9) and
(5.10), the latter with the smoothness of motions that the text asks for.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from decoder.side_information.protocol import Interpolation
from decoder.side_information.synthesis import render_between
from dvc.arrays import Bytes, Floats, Integers, Mask
from dvc.geometry.cameras import homogeneous
from dvc.geometry.continuation import CONSISTENT, DepthMap
from dvc.geometry.depth_maps import DepthView, Known
from dvc.geometry.rendering import fill_holes, render_grid
from dvc.geometry.triangulation import inverse_depths
from dvc.geometry.warping import EMPTY, inverse_warp, sample, warp_grid, warp_matrix
from sfm.scene_model import Model


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
    """Positions of points in a mesh."""

    vertices: Integers  # corners of the triangle
    weights: Floats  # their weights, which sum to 1
    triangle: Integers  # the triangle: two a cell, upper left before lower right

    def interpolate(self, values: Floats) -> Floats:
        """Interpolate values (V,) or (V, 2) of the vertices."""
        weights = self.weights.reshape(*self.weights.shape, *(1,) * (values.ndim - 1))
        return np.asarray((weights * values[self.vertices]).sum(axis=1))

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
    halves = []  # second differences of a line of values, halved and negated; zero rows at its ends
    for count in shape:
        inner = np.ones(count)
        inner[[0, -1]] = 0.0
        sides = -0.5 * inner
        halves.append(sparse.diags_array([sides[1:], inner, sides[:-1]], offsets=[-1, 0, 1]).tocsr())
    rows, columns = halves
    along = sparse.kron(sparse.eye_array(shape[0]), columns) + sparse.kron(rows, sparse.eye_array(shape[1]))
    border = np.zeros(shape, dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = True
    return sparse.csr_array(sparse.diags_array(np.where(border, 1.0, 0.5).ravel()) @ along)


RIDGE = 1e-9
"""Weight that holds vertices which neither data nor smoothness determine."""
EPIPOLE_MARGIN_PX = 4.0
"""Distance from the epipole below which vertices have no information about depth."""
NO_PARALLAX = 1e-9
"""Least squared motion, in pixels per unit of inverse depth, of an informative vertex."""
CELL_PX = 16
SMOOTHNESS = 0.3
"""Weight of the smoothness of motions (mu)."""
MAX_ERROR = 30.0
"""Least mean absolute compensation error of a triangle, in luma levels, that makes its points outliers."""
MAX_FITS = 8


class Mesh(NamedTuple):
    """A mesh."""

    cell_px: float  # distance of vertices in the first key frame; x and y of the first one, negated
    second: Floats  # vertices in the second key frame, (x, y) in pixels
    inverse_depth: Floats  # inverse depth of the vertices in the first key frame
    kept: Mask  # correspondences that were not outliers


class MeshInterpolator:
    """Predicts frames between two key frames by the mesh; see `SceneInterpolator`."""

    name = "mesh"

    def __init__(
        self,
        model: Model,
        first: Bytes,
        second: Bytes,
        known: Known = (None, None),
        cell_px: int = CELL_PX,
    ) -> None:
        self._frame = model.pixel_frame
        mesh = fit_mesh(model, first, second, cell_px)
        warp = warp_matrix(model.first_camera, model.second_camera, model.pixel_frame)
        in_first, _ = mesh_depth(mesh, first.shape)
        vertices = warp_grid(warp, mesh.inverse_depth, -mesh.cell_px, mesh.cell_px)
        in_second = render_grid(vertices, second.shape)
        visibility = np.full(first.shape, CONSISTENT, np.int8)
        whole = np.zeros((first.shape[0] - 1, first.shape[1] - 1), dtype=bool)  # one piece
        self.views = (
            DepthView(first, model.first_camera, DepthMap(in_first, visibility), whole, warp),
            DepthView(
                second, model.second_camera, DepthMap(in_second, visibility), whole, inverse_warp(warp)
            ),
        )

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Predict one frame."""
        return render_between(self.views, camera, temporal_position, self._frame)


def fit_mesh(model: Model, first: Bytes, second: Bytes, cell: int = CELL_PX) -> Mesh:
    """Fit the mesh to correspondences, and drop outliers until none is left."""
    warp = warp_matrix(model.first_camera, model.second_camera, model.pixel_frame)
    shape = (-(-(first.shape[0] - 1) // cell) + 3, -(-(first.shape[1] - 1) // cell) + 3)
    rows, columns = np.indices(shape)
    grid = np.stack([columns.ravel(), rows.ravel()], axis=-1) * float(cell) - cell  # in the first key frame
    points, matches = model.correspondences.first, model.correspondences.second
    kept = np.asarray(np.isfinite(np.column_stack([points, matches])).all(axis=1))
    farthest = (np.array(shape[::-1]) - 2) * cell
    kept &= np.logical_and(points >= -cell, points <= farthest).all(axis=1)
    closest, direction = epipolar_lines(warp, grid)
    roughness = roughness_matrix(shape)
    for _ in range(MAX_FITS):
        weights = barycentric(points[kept], shape, cell).matrix(len(grid))
        # Solve (5.10) for the positions of the vertices in the second key frame.
        normal, right = RIDGE * sparse.eye_array(len(grid)), np.zeros(len(grid))
        for axis in (0, 1):
            along = sparse.diags_array(direction[:, axis])
            data, smooth = weights @ along, SMOOTHNESS * roughness @ along
            normal = normal + data.T @ data + smooth.T @ smooth
            right += data.T @ (matches[kept, axis] - weights @ closest[:, axis])
            right -= SMOOTHNESS * smooth.T @ (roughness @ (closest - grid)[:, axis])
        vertices = np.asarray(closest + spsolve(normal.tocsc(), right)[:, None] * direction, np.float64)
        depth, third = inverse_depths(grid, warp, vertices)
        epipole = warp[:, 3]
        offset = epipole[:2] - vertices * epipole[2]
        # offset / |e_3| is the way from the epipole to the vertex; one at infinity is near nothing
        near = (offset**2).sum(axis=1) <= (EPIPOLE_MARGIN_PX * epipole[2]) ** 2 + NO_PARALLAX
        depth = fill_holes(np.where(near | (third <= 1e-6), EMPTY, depth).reshape(shape))
        mesh = Mesh(cell, vertices.reshape(*shape, 2), depth, kept.copy())
        # Triangles are bad that turn over or compensate badly.
        inside, triangle = mesh_depth(mesh, first.shape)
        moved = warp_grid(warp, inside)
        error = np.abs(sample(second, moved) - first)
        height, width = first.shape
        x, y = moved[..., 0], moved[..., 1]
        error[(x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)] = 0.0
        size = 2 * (shape[0] - 1) * (shape[1] - 1)
        total = np.bincount(triangle.ravel(), error.ravel(), size)
        count = np.bincount(triangle.ravel(), minlength=size)
        corners, areas = mesh.second, []
        across, below = corners[:-1, 1:], corners[1:, :-1]
        for corner, one, other in ((corners[:-1, :-1], across, below), (corners[1:, 1:], below, across)):
            a, b = one - corner, other - corner
            areas.append(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])  # twice the signed area
        bad = (np.stack(areas, axis=-1).ravel() <= 0.0) | (total > MAX_ERROR * count)
        outlier: Mask = kept & bad[barycentric(np.where(kept[:, None], points, 0.0), shape, cell).triangle]
        if not outlier.any():
            break
        kept &= ~outlier
    return mesh


def mesh_depth(mesh: Mesh, shape: tuple[int, ...]) -> tuple[Floats, Integers]:
    """Interpolate the mesh at every pixel of the first key frame."""
    rows, columns = np.indices(shape)
    points = np.stack([columns.ravel(), rows.ravel()], axis=-1).astype(np.float64)
    where = barycentric(points, mesh.inverse_depth.shape, mesh.cell_px)
    return where.interpolate(mesh.inverse_depth.ravel()).reshape(shape), where.triangle.reshape(shape)
