"""Triangle meshes and the shapes that scenes are made of; lengths and texture coordinates in metres."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]
Colour = tuple[float, float, float]

WHITE: Colour = (1.0, 1.0, 1.0)
# The two triangles of a quad, to be added to the number of its first vertex.
QUAD = np.array([0, 1, 2, 0, 2, 3])


@dataclass(frozen=True)
class Mesh:
    """Triangles with attributes at their vertices.

    Parameters
    ----------
    points : ndarray of shape (N, 3), float64
        Vertices in the world, metres.
    normals : ndarray of shape (N, 3), float64
        Unit normals, outwards.
    uv : ndarray of shape (N, 2), float64
        Texture coordinates, metres along the surface.
    tint : ndarray of shape (N, 3), float64
        Linear colour that multiplies the texture.
    triangles : ndarray of shape (M, 3), int32
        Vertex numbers.
    materials : ndarray of shape (M,), int32
        Texture number of each triangle.
    """

    points: Floats
    normals: Floats
    uv: Floats
    tint: Floats
    triangles: Ids
    materials: Ids

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
    """Make a surface of a grid of points (rows, columns, 3); normals are ``d/dcolumn x d/drow``.

    Parameters
    ----------
    points : ndarray of shape (R, C, 3), float64
        Surface points.
    uv : ndarray of shape (R, C, 2), float64
        Texture coordinates.
    material : int
        Texture number.
    tint : array_like of shape (3,) or (R, C, 3)
        Linear colour.
    smooth : bool
        Share vertices (smooth normals) or give every quad its own.

    Returns
    -------
    Mesh
        Two triangles per cell.
    """
    colour = np.broadcast_to(np.asarray(tint, dtype=np.float64), points.shape)
    if not smooth:
        corners = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))]
        corners += [(slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]
        p, t, c = (
            np.stack([a[i] for i in corners], axis=2).reshape(-1, a.shape[2]) for a in (points, uv, colour)
        )
        normals = np.repeat(_unit(np.cross(p[1::4] - p[0::4], p[3::4] - p[0::4])), 4, axis=0)
        first = np.arange(0, len(p), 4)
    else:
        across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
        normals = _unit(np.cross(across, down)).reshape(-1, 3)
        p, t, c = points.reshape(-1, 3), uv.reshape(-1, 2), colour.reshape(-1, 3)
        rows, columns = points.shape[:2]
        index = np.arange(rows * columns).reshape(rows, columns)
        quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(
            -1, 4
        )
        return _mesh(p, normals, t, c, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), material)
    quads = first[:, None] + np.arange(4)
    return _mesh(p, normals, t, c, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), material)


def patch(
    origin: ArrayLike,
    across: ArrayLike,
    up: ArrayLike,
    material: int,
    tint: ArrayLike = WHITE,
    cell_m: float = 0.35,
    uv_at: ArrayLike = (0.0, 0.0),
) -> Mesh:
    """Make a flat parallelogram with the normal ``across x up``, cut into cells on which light is baked.

    Parameters
    ----------
    origin, across, up : array_like of shape (3,)
        Corner and the two sides, metres.
    material : int
        Texture number.
    tint : array_like of shape (3,)
        Linear colour.
    cell_m : float
        Largest side of a cell.
    uv_at : array_like of shape (2,)
        Texture coordinates of the corner, metres.

    Returns
    -------
    Mesh
        The surface.
    """
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
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return np.stack([s.ravel(), t.ravel()], axis=-1), triangles


def _normal(a: Floats, b: Floats) -> Floats:
    normal = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    return np.asarray(normal / math.sqrt(float(normal @ normal)))


def box(
    low: ArrayLike,
    high: ArrayLike,
    material: int,
    tint: ArrayLike = WHITE,
    cell_m: float = 0.6,
    uv_at: float = 0.0,
) -> Mesh:
    """Make a box with sides along the axes from its lowest to its highest corner, without its bottom."""
    a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    size = b - a
    if float(size.max()) <= cell_m:
        points = a + _BOX[:, 0] * size
        uv = (_BOX[:, 1:] * size).sum(axis=-1) + uv_at
        colour = np.empty_like(points)
        colour[:] = tint
        return Mesh(points, _BOX_NORMALS, uv, colour, _BOX_TRIANGLES, np.full(10, material, dtype=np.int32))
    x, y, z = np.diag(size)
    sides = [(a, x, z), (a + x, y, z), (a + x + y, -x, z), (a + y, -y, z), (a + z, x, y)]
    return merge(
        patch(o, s, t, material, tint, cell_m, (uv_at + 1.7 * i, uv_at)) for i, (o, s, t) in enumerate(sides)
    )


def _unit_box() -> tuple[Floats, Floats, Ids]:
    """Return place and axes of u and v (20, 3, 3), normals and triangles of the vertices of an open box."""
    x, y, z = np.eye(3)
    vertices, normals = [], []
    for o, s, t in [(0 * x, x, z), (x, y, z), (x + y, -x, z), (y, -y, z), (z, x, y)]:
        for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)):
            vertices.append([o + i * s + j * t, i * np.abs(s), j * t])
            normals.append(np.cross(s, t))
    first = 4 * np.arange(5)[:, None]
    return (
        np.array(vertices),
        np.array(normals),
        (first + QUAD).reshape(-1, 3).astype(np.int32),
    )


_BOX, _BOX_NORMALS, _BOX_TRIANGLES = _unit_box()


def slab(
    origin: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    material: int,
    tint: ArrayLike = WHITE,
    cell_m: float = 0.5,
) -> Mesh:
    """Make a closed parallelepiped from a corner and three right-handed sides (3,): copings, ramps, beams."""
    o, a, b, c = (np.asarray(side, dtype=np.float64) for side in (origin, x, y, z))
    sides = [(o, a, c), (o + a, b, c), (o + a + b, -a, c), (o + b, -b, c), (o + c, a, b), (o, b, a)]
    return merge(patch(p, s, t, material, tint, cell_m, (1.3 * i, 0.0)) for i, (p, s, t) in enumerate(sides))


def extrude(
    profile: ArrayLike,
    start: ArrayLike,
    end: ArrayLike,
    material: int,
    tint: ArrayLike = WHITE,
    cell_m: float = 0.35,
) -> Mesh:
    """Sweep a profile along a straight horizontal line: kerbs, steps, cornices, rails.

    Parameters
    ----------
    profile : array_like of shape (K, 2)
        Points (outwards, up) from the line, in order from the top of the outer face downwards or the reverse;
        outwards is to the right of the direction of travel.
    start, end : array_like of shape (3,)
        The line, metres.
    material : int
        Texture number.
    tint : array_like of shape (3,)
        Linear colour.
    cell_m : float
        Largest length of a cell along the line.

    Returns
    -------
    Mesh
        Flat facets, one strip per side of the profile; normals to the left of a profile that runs downwards.
    """
    shape, a, b = (np.asarray(x, dtype=np.float64) for x in (profile, start, end))
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    outwards = np.cross(along, [0.0, 0.0, 1.0])
    t = np.linspace(0, 1, max(1, math.ceil(length / cell_m)) + 1)
    rim = shape[:, :1] * outwards + shape[:, 1:] * np.array([0.0, 0.0, 1.0])
    points = a + t[None, :, None] * (b - a) + rim[:, None, :]
    around = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(shape, axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(t[None, :] * length, around[:, None]), axis=-1)
    return from_grid(points[:, ::-1], uv[:, ::-1], material, tint, smooth=False)


def lathe(
    profile: ArrayLike, centre: ArrayLike, material: int, tint: ArrayLike = WHITE, segments: int = 12
) -> Mesh:
    """Turn a profile (radius, height), listed from the bottom up, about a vertical axis: posts, vases."""
    shape = np.asarray(profile, dtype=np.float64)
    angle = np.linspace(0, 2 * math.pi, segments + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = np.empty((len(shape), segments + 1, 3))
    points[..., :2] = shape[:, None, :1] * ring
    points[..., 2] = shape[:, None, 1]
    around = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(shape, axis=0), axis=1))])
    width = angle * float(shape[:, 0].max())
    uv = np.stack(np.broadcast_arrays(width[None, :], around[:, None]), axis=-1)
    mesh = from_grid(points + np.asarray(centre, dtype=np.float64), uv, material, tint)
    normals = mesh.normals.reshape(len(shape), segments + 1, 3)
    seam = _unit(normals[:, 0] + normals[:, -1])
    normals[:, 0], normals[:, -1] = seam, seam
    return replace(mesh, normals=normals.reshape(-1, 3))


def square_moulding(profile: ArrayLike, half_m: float, material: int, tint: ArrayLike = WHITE) -> Mesh:
    """Run a profile (outwards, up), listed from the top, round a square of side ``2 half_m``."""
    shape = np.asarray(profile, dtype=np.float64)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], dtype=np.float64)
    points = np.empty((len(shape), 5, 3))
    points[..., :2] = (half_m + shape[:, None, :1]) * corners
    points[..., 2] = shape[:, None, 1]
    around = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(shape, axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(2 * half_m * np.arange(5.0)[None, :], around[:, None]), axis=-1)
    return from_grid(points[:, ::-1], uv[:, ::-1], material, tint, smooth=False)


def tube(path: Sequence[ArrayLike], radii: Sequence[float], material: int, tint: ArrayLike = WHITE) -> Mesh:
    """Make a round bar along a path of points: branches, handrails, pipes; eight sides."""
    line = np.asarray(path, dtype=np.float64)
    tangent = _unit(np.gradient(line, axis=0))
    helper = np.where(np.abs(tangent[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = _unit(np.cross(tangent, helper))
    other = np.cross(tangent, side)
    angle = np.linspace(0, 2 * math.pi, 9)
    ring = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * other[:, None]
    radius = np.asarray(radii, dtype=np.float64)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(angle[None, :] * radius.max(), length[:, None]), axis=-1)
    points = line[:, None] + radius[:, None, None] * ring
    mesh = from_grid(points, uv, material, tint)
    return replace(mesh, normals=ring.reshape(-1, 3))


def _mesh(
    points: Floats, normals: Floats, uv: Floats, tint: Floats, triangles: NDArray[np.int64], material: int
) -> Mesh:
    ids = triangles.astype(np.int32)
    materials = np.full(len(ids), material, dtype=np.int32)
    return Mesh(points, normals, uv, np.array(tint, dtype=np.float64), ids, materials)


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12), dtype=np.float64)
