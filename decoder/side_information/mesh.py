"""Mesh interpolation: a triangular grid on the first key frame, whose vertices move along epipolar lines.

The sparse mesh of the thesis is fitted to the correspondences by linear least squares with smooth motion;
correspondences in triangles that turn over or compensate badly are dropped, and the fit repeated. The dense
mesh has a vertex at every pixel, in both key frames, fitted by a plane sweep and torn where depth jumps.

References
----------
[Maitre2008] Sec. 5.3.3, Eqs. (5.9) and (5.10), the latter with the smoothness of motions that the text
asks for.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels_3d
from decoder.side_information.mesh_equations import barycentric, epipolar_lines, roughness_matrix
from decoder.side_information.rendering import Interpolation, fill_holes, interpolate, render_view, sample
from decoder.side_information.surfaces import (
    RELIABLE,
    KeySurface,
    Known,
    SurfaceSettings,
    estimate_surfaces,
)
from decoder.side_information.trifocal import (
    Status,
    inverse_depths,
    inverse_transfer,
    transfer_matrix,
    transfer_surface,
)
from sfm.model import Model

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
Mask = NDArray[np.bool_]

RIDGE = 1e-9
"""Weight that holds vertices which neither data nor smoothness determine."""


@dataclass(frozen=True)
class MeshSettings:
    """How the mesh is fitted.

    Attributes
    ----------
    dense : bool
        A vertex at every pixel of both key frames; otherwise the sparse mesh of the thesis.
    surfaces : SurfaceSettings
        The dense mesh.
    cell_px : int
        Side of the sparse mesh's cells.
    smoothness : float
        Weight of the smoothness of motions (mu).
    largest_error : float
        Mean absolute compensation error of a triangle, in luma levels, from which its points are outliers.
    max_fits : int
        Most fits.
    """

    dense: bool = True
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    cell_px: int = 16
    smoothness: float = 0.3
    largest_error: float = 30.0
    max_fits: int = 8


class Mesh(NamedTuple):
    """A sparse mesh.

    Attributes
    ----------
    origin_px, cell_px : float
        x and y of the first vertex, and distance of vertices, in the first key frame.
    second : ndarray of shape (rows, columns, 2), float64
        Vertices in the second key frame, (x, y) in pixels.
    inverse_depth : ndarray of shape (rows, columns), float64
        Inverse depth of the vertices in the first key frame.
    kept : ndarray of shape (N,), bool
        Correspondences that were not outliers.
    num_fits : int
        Fits that were needed.
    """

    origin_px: float
    cell_px: float
    second: Floats
    inverse_depth: Floats
    kept: Mask
    num_fits: int


class MeshInterpolator:
    """Predicts frames between two key frames by a mesh.

    Parameters
    ----------
    model : Model
        Cameras of the key frames, and correspondences.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    settings : MeshSettings
        The kind of mesh, and its limits and weights.
    known : tuple of two (KnownDepth or None), optional
        What is known of the depth of each key frame already; only the dense mesh uses it.
    """

    def __init__(
        self,
        model: Model,
        first: Luma,
        second: Luma,
        settings: MeshSettings,
        known: Known = (None, None),
    ) -> None:
        self._frame = model.pixel_frame
        if settings.dense:
            self._surfaces = estimate_surfaces(model, first, second, settings.surfaces, known)
        else:
            self._surfaces = mesh_surfaces(fit_mesh(model, first, second, settings), model, first, second)

    @property
    def surfaces(self) -> tuple[KeySurface, KeySurface]:
        """What both key frames show."""
        return self._surfaces

    def interpolate(self, camera: Floats, late: float) -> Interpolation:
        """Predict one frame.

        Parameters
        ----------
        camera : ndarray of shape (3, 4), float64
            Its camera, in normalised coordinates.
        late : float
            Instant between the first key frame (0) and the second (1).

        Returns
        -------
        Interpolation
            The predicted frame.
        """
        view = render_view(self._surfaces, camera, self._frame)
        return interpolate(self._surfaces, view, camera, late, self._frame)


def fit_mesh(model: Model, first: Luma, second: Luma, settings: MeshSettings) -> Mesh:
    """Fit the sparse mesh to correspondences, and drop outliers until none is left.

    Parameters
    ----------
    model : Model
        Cameras and correspondences.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    settings : MeshSettings
        Cells, weights and limits.

    Returns
    -------
    Mesh
        It covers the frame and one cell around it.
    """
    transfer = transfer_matrix(model.first_camera, model.second_camera, model.pixel_frame)
    cell = settings.cell_px
    shape = (-(-(first.shape[0] - 1) // cell) + 3, -(-(first.shape[1] - 1) // cell) + 3)
    points, matches = model.correspondences.first, model.correspondences.second
    kept = np.asarray(np.isfinite(np.column_stack([points, matches])).all(axis=1))
    farthest = (np.array(shape[::-1]) - 2) * cell
    kept &= np.logical_and(points >= -cell, points <= farthest).all(axis=1)
    for number in range(1, settings.max_fits + 1):
        vertices = _fit_once(points[kept], matches[kept], transfer, shape, settings)
        mesh = Mesh(-cell, cell, vertices, _vertex_depths(vertices, transfer, cell), kept.copy(), number)
        bad = _bad_triangles(mesh, transfer, first, second, settings.largest_error)
        outlier: Mask = kept & bad[barycentric(np.where(kept[:, None], points, 0.0), shape, cell).triangle]
        if not outlier.any():
            break
        kept &= ~outlier
    return mesh


def _grid(shape: tuple[int, ...], cell: float) -> Floats:
    """Vertices in the first key frame, row by row: (V, 2)."""
    rows, columns = np.indices(shape)
    return np.stack([columns.ravel(), rows.ravel()], axis=-1) * float(cell) - cell


def _fit_once(
    points: Floats, matches: Floats, transfer: Floats, shape: tuple[int, int], settings: MeshSettings
) -> Floats:
    """Solve (5.10) for the positions of the vertices in the second key frame."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    grid = _grid(shape, settings.cell_px)
    place, direction = epipolar_lines(transfer, grid)
    weights = barycentric(points, shape, settings.cell_px).matrix(len(grid))
    roughness = roughness_matrix(shape)
    normal = RIDGE * sparse.eye_array(len(grid))
    right = np.zeros(len(grid))
    for axis in (0, 1):
        along = sparse.diags_array(direction[:, axis])
        data, smooth = weights @ along, settings.smoothness * roughness @ along
        normal = normal + data.T @ data + smooth.T @ smooth
        right += data.T @ (matches[:, axis] - weights @ place[:, axis])
        right -= settings.smoothness * smooth.T @ (roughness @ (place - grid)[:, axis])
    moved = place + spsolve(normal.tocsc(), right)[:, None] * direction
    return np.asarray(moved, dtype=np.float64).reshape(*shape, 2)


def _vertex_depths(second: Floats, transfer: Floats, cell: float) -> Floats:
    """Inverse depth of the vertices by triangulation; that of the others where it is not determined."""
    shape = second.shape[:2]
    depth, status = inverse_depths(transfer, _grid(shape, cell), second.reshape(-1, 2))
    depth = np.where(status == Status.VALID, depth, _kernels_3d.EMPTY).reshape(shape)
    return fill_holes(depth)


def mesh_surface(mesh: Mesh, shape: tuple[int, ...]) -> tuple[Floats, NDArray[np.int64]]:
    """Interpolate the mesh at every pixel of the first key frame.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    shape : tuple of int
        Height and width.

    Returns
    -------
    inverse_depth : ndarray of shape (H, W), float64
        Affine in each triangle.
    triangle : ndarray of shape (H, W), int64
        Triangle of each pixel.
    """
    rows, columns = np.indices(shape)
    points = np.stack([columns.ravel(), rows.ravel()], axis=-1).astype(np.float64)
    where = barycentric(points, mesh.inverse_depth.shape, mesh.cell_px)
    return where.interpolate(mesh.inverse_depth.ravel()).reshape(shape), where.triangle.reshape(shape)


def _bad_triangles(mesh: Mesh, transfer: Floats, first: Luma, second: Luma, largest_error: float) -> Mask:
    """Tell which triangles turn over or compensate badly."""
    depth, triangle = mesh_surface(mesh, first.shape)
    moved = transfer_surface(transfer, depth)
    error = np.abs(sample(second, moved) - first)
    height, width = first.shape
    x, y = moved[..., 0], moved[..., 1]
    error[(x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)] = 0.0
    cells = (mesh.second.shape[0] - 1) * (mesh.second.shape[1] - 1)
    total = np.bincount(triangle.ravel(), error.ravel(), 2 * cells)
    count = np.bincount(triangle.ravel(), minlength=2 * cells)
    corners = mesh.second
    upper = _area(corners[:-1, :-1], corners[:-1, 1:], corners[1:, :-1])
    lower = _area(corners[1:, 1:], corners[1:, :-1], corners[:-1, 1:])
    turned = np.stack([upper, lower], axis=-1).ravel() <= 0.0
    return np.asarray(turned | (total > largest_error * count))


def _area(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the signed area of triangles."""
    ab, ac = b - a, c - a
    area: Floats = ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]
    return area


def mesh_surfaces(mesh: Mesh, model: Model, first: Luma, second: Luma) -> tuple[KeySurface, KeySurface]:
    """Turn the sparse mesh into surfaces of both key frames: one piece, all of it trusted.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    model : Model
        Cameras of the key frames.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.

    Returns
    -------
    tuple of two KeySurface
        The surface of each.
    """
    there = transfer_matrix(model.first_camera, model.second_camera, model.pixel_frame)
    depth, _ = mesh_surface(mesh, first.shape)
    vertices = transfer_surface(there, mesh.inverse_depth, mesh.origin_px, mesh.cell_px)
    drawn = np.full(second.shape, _kernels_3d.EMPTY)
    whole = np.zeros((vertices.shape[0] - 1, vertices.shape[1] - 1), dtype=bool)
    _kernels_3d.rasterise(vertices, whole, drawn)
    state = np.full(first.shape, RELIABLE, np.int8)
    torn = np.zeros((first.shape[0] - 1, first.shape[1] - 1), dtype=bool)
    return (
        KeySurface(first, model.first_camera, depth, state, torn, there),
        KeySurface(second, model.second_camera, fill_holes(drawn), state, torn, inverse_transfer(there)),
    )
