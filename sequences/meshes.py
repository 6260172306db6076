"""Triangle meshes: vertices with attributes, grids, flat patches; lengths in metres, on the texture too."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]
Colour = tuple[float, float, float]

WHITE: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Mesh:
    """Triangles with attributes at their vertices."""

    points: Floats  # vertices in the world, metres
    normals: Floats  # unit normals, outwards
    uv: Floats  # texture coordinates, metres along the surface
    tint: Floats  # linear colour that multiplies the texture
    triangles: Ids  # vertex numbers
    materials: Ids  # texture number of each triangle

    def moved(self, offset: ArrayLike) -> "Mesh":
        """Return the mesh shifted by `offset` (3,), metres."""
        return replace(self, points=self.points + np.asarray(offset, dtype=np.float64))

    def turned(self, angle_deg: float) -> "Mesh":
        """Return the mesh turned about the vertical axis through the origin, counter-clockwise from above."""
        c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return replace(self, points=self.points @ rotation.T, normals=self.normals @ rotation.T)

    def texture_moved(self, u_m: float, v_m: float) -> "Mesh":
        """Return the mesh with its texture shifted, so that repeated parts do not look alike."""
        return replace(self, uv=self.uv + np.array([u_m, v_m]))

    def tinted(self, factor: ArrayLike) -> "Mesh":
        """Return the mesh with its tint multiplied by `factor`, of shape (3,) or (N, 1) or (N, 3)."""
        return replace(self, tint=self.tint * np.asarray(factor, dtype=np.float64))


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join meshes into one, in order."""
    parts = list(meshes)
    starts = np.cumsum([0] + [len(part.points) for part in parts[:-1]])
    return Mesh(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.tint for part in parts]),
        np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=True)]).astype(
            np.int32
        ),
        np.concatenate([part.materials for part in parts]),
    )


def from_grid(
    points: Floats, uv: Floats, material: int, tint: ArrayLike = WHITE, smooth: bool = True
) -> Mesh:
    """Make a surface of a grid of points (rows, columns, 3); normals are ``d/dcolumn x d/drow``."""
    colour = np.broadcast_to(np.asarray(tint, dtype=np.float64), points.shape)
    if smooth:
        across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
        normals = unit_vectors(np.cross(across, down)).reshape(-1, 3)
        p, t, c = points.reshape(-1, 3), uv.reshape(-1, 2), colour.reshape(-1, 3)
        return _mesh(p, normals, t, c, _grid_triangles(*points.shape[:2]), material)
    corners = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))]
    corners += [(slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]
    p, t, c = (
        np.stack([a[i] for i in corners], axis=2).reshape(-1, a.shape[2]) for a in (points, uv, colour)
    )
    normals = np.repeat(unit_vectors(np.cross(p[1::4] - p[0::4], p[3::4] - p[0::4])), 4, axis=0)
    return _mesh(p, normals, t, c, _halves(np.arange(len(p)).reshape(-1, 4)), material)


def quads(count: int) -> Ids:
    """Return the triangles of quads that share no vertex."""
    return (4 * np.arange(count)[:, None] + [0, 1, 2, 0, 2, 3]).reshape(-1, 3).astype(np.int32)


def patch(
    origin: ArrayLike,
    across: ArrayLike,
    up: ArrayLike,
    material: int,
    tint: ArrayLike = WHITE,
    cell_m: float = 0.35,
    uv_at: ArrayLike = (0.0, 0.0),
) -> Mesh:
    """Make a flat parallelogram with the normal ``across x up``, cut into cells on which light is baked."""
    o, a, b = (np.asarray(x, dtype=np.float64) for x in (origin, across, up))
    wide, tall = math.sqrt(float(a @ a)), math.sqrt(float(b @ b))
    columns, rows = max(1, math.ceil(wide / cell_m)), max(1, math.ceil(tall / cell_m))
    st, triangles = _unit_grid(rows, columns)
    uv = st * (wide, tall) + np.asarray(uv_at, dtype=np.float64)
    points = o + st @ np.stack([a, b])
    normals, colour = np.empty_like(points), np.empty_like(points)
    normals[:] = _normal(a, b)
    colour[:] = tint
    return Mesh(points, normals, uv, colour, triangles, np.full(len(triangles), material, dtype=np.int32))


@lru_cache(maxsize=512)
def _unit_grid(rows: int, columns: int) -> tuple[Floats, Ids]:
    """Return the vertices (N, 2) of a grid over the unit square, row by row, and its triangles."""
    s, t = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    triangles = _grid_triangles(rows + 1, columns + 1).astype(np.int32)
    return np.stack([s.ravel(), t.ravel()], axis=-1), triangles


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int64]:
    """Return the triangles of a grid of vertices: the first halves of all cells, then the second ones."""
    index = np.arange(rows * columns).reshape(rows, columns)
    corners = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]
    return _halves(np.stack(corners, axis=-1).reshape(-1, 4))


def _halves(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


def _normal(a: Floats, b: Floats) -> Floats:
    normal = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    return np.asarray(normal / math.sqrt(float(normal @ normal)))


def _mesh(
    points: Floats, normals: Floats, uv: Floats, tint: Floats, triangles: NDArray[np.int64], material: int
) -> Mesh:
    ids = triangles.astype(np.int32)
    materials = np.full(len(ids), material, dtype=np.int32)
    return Mesh(points, normals, uv, np.array(tint, dtype=np.float64), ids, materials)


def unit_vectors(vectors: Floats) -> Floats:
    """Scale vectors to length 1; zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12), dtype=np.float64)
