"""Shapes that scenes are made of: boxes, slabs, mouldings, turned and bent bars; lengths in metres."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sequences.meshes import WHITE, Mesh, from_grid, merge, patch, quads, unit_vectors

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]


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
    return np.array(vertices), np.array(normals), quads(5)


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
    """Sweep a profile along a straight horizontal line: kerbs, steps, cornices, rails."""
    shape, a, b = (np.asarray(x, dtype=np.float64) for x in (profile, start, end))
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    outwards = np.cross(along, [0.0, 0.0, 1.0])
    t = np.linspace(0, 1, max(1, math.ceil(length / cell_m)) + 1)
    rim = shape[:, :1] * outwards + shape[:, 1:] * np.array([0.0, 0.0, 1.0])
    points = a + t[None, :, None] * (b - a) + rim[:, None, :]
    around = _lengths(shape)
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
    around = _lengths(shape)
    width = angle * float(shape[:, 0].max())
    uv = np.stack(np.broadcast_arrays(width[None, :], around[:, None]), axis=-1)
    mesh = from_grid(points + np.asarray(centre, dtype=np.float64), uv, material, tint)
    normals = mesh.normals.reshape(len(shape), segments + 1, 3)
    seam = unit_vectors(normals[:, 0] + normals[:, -1])
    normals[:, 0], normals[:, -1] = seam, seam
    return replace(mesh, normals=normals.reshape(-1, 3))


def square_moulding(profile: ArrayLike, half_m: float, material: int, tint: ArrayLike = WHITE) -> Mesh:
    """Run a profile (outwards, up), listed from the top, round a square of side ``2 half_m``."""
    shape = np.asarray(profile, dtype=np.float64)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], dtype=np.float64)
    points = np.empty((len(shape), 5, 3))
    points[..., :2] = (half_m + shape[:, None, :1]) * corners
    points[..., 2] = shape[:, None, 1]
    around = _lengths(shape)
    uv = np.stack(np.broadcast_arrays(2 * half_m * np.arange(5.0)[None, :], around[:, None]), axis=-1)
    return from_grid(points[:, ::-1], uv[:, ::-1], material, tint, smooth=False)


def tube(path: Sequence[ArrayLike], radii: Sequence[float], material: int, tint: ArrayLike = WHITE) -> Mesh:
    """Make a round bar along a path of points: branches, handrails, pipes; eight sides."""
    line = np.asarray(path, dtype=np.float64)
    tangent = unit_vectors(np.gradient(line, axis=0))
    helper = np.where(np.abs(tangent[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = unit_vectors(np.cross(tangent, helper))
    other = np.cross(tangent, side)
    angle = np.linspace(0, 2 * math.pi, 9)
    ring = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * other[:, None]
    radius = np.asarray(radii, dtype=np.float64)
    length = _lengths(line)
    uv = np.stack(np.broadcast_arrays(angle[None, :] * radius.max(), length[:, None]), axis=-1)
    points = line[:, None] + radius[:, None, None] * ring
    mesh = from_grid(points, uv, material, tint)
    return replace(mesh, normals=ring.reshape(-1, 3))


def _lengths(path: Floats) -> Floats:
    """Return the length of a path up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
