"""Triangle meshes of plain shapes: patches, boxes, turned profiles, bars, ellipsoids; lengths in metres."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.arrays import Floats

Ids = NDArray[np.int32]
Colour = tuple[float, float, float]


class Look(NamedTuple):
    """Material and colour of a surface."""

    material: str  # name in `MATERIALS`
    colour: Colour  # linear reflectance

    def shaded(self, factor: float) -> "Look":
        """Return a darker or brighter look."""
        r, g, b = self.colour
        return Look(self.material, (factor * r, factor * g, factor * b))


class Material(NamedTuple):
    """Parameters of a procedural texture, see `sequences._kernels.Materials`; lengths in metres."""

    stone: tuple[float, float] = (0.0, 0.0)  # width and height; 0 for a surface without joints
    joint: tuple[float, float] = (0.01, 0.02)  # width of a joint, and of the dark rim of a stone
    joint_colour: Colour = (0.1, 0.1, 0.1)
    stagger: tuple[float, float] = (0.5, 0.0)  # shift of every second course, and raggedness of joints
    spread: tuple[float, float] = (0.0, 0.2)  # deviation of stones, and amplitude of the noise
    noise: tuple[float, float, float] = (0.4, 0.85, 1.0)  # longest wave, gain of octaves, stretch


MATERIALS = {
    "asphalt": Material(spread=(0.0, 0.32), noise=(0.08, 0.9, 1.0)),
    "ashlar": Material((0.62, 0.34), (0.012, 0.03), (0.16, 0.14, 0.11), (0.5, 0.006), (0.2, 0.2)),
    "brick": Material((0.23, 0.075), (0.012, 0.008), (0.34, 0.31, 0.27), (0.5, 0.004), (0.42, 0.2)),
    "cobbles": Material((0.15, 0.13), (0.014, 0.035), (0.07, 0.065, 0.06), (0.5, 0.02), (0.42, 0.2)),
    "glass": Material((1.05, 0.85), (0.0, 0.01), (0, 0, 0), (0.3, 0.0), (0.5, 0.5), (1.3, 0.6, 2.0)),
    "leaves": Material(spread=(0.0, 0.55), noise=(0.16, 0.9, 1.0)),
    "marble": Material(spread=(0.0, 0.17), noise=(0.25, 0.95, 1.6)),
    "paint": Material(spread=(0.0, 0.09), noise=(0.3, 0.9, 1.0)),
    "paving": Material((0.55, 0.55), (0.012, 0.03), (0.1, 0.095, 0.09), (0.5, 0.008), (0.24, 0.2)),
    "plaster": Material(spread=(0.0, 0.14), noise=(0.4, 0.9, 1.3)),
    "print": Material((0.17, 0.12), (0.0, 0.004), (0, 0, 0), (0.37, 0.03), (0.7, 0.3)),
    "stone": Material(spread=(0.0, 0.22), noise=(0.3, 0.95, 1.0)),
    "tiles": Material((0.22, 0.2), (0.012, 0.06), (0.04, 0.03, 0.025), (0.5, 0.006), (0.3, 0.2)),
    "wood": Material(
        (2.1, 0.14), (0.006, 0.012), (0.03, 0.025, 0.02), (0.37, 0.0), (0.3, 0.3), (1.2, 0.85, 0.1)
    ),
}
NUMBER = {name: k for k, name in enumerate(MATERIALS)}


class Mesh(NamedTuple):
    """Triangles with attributes."""

    points: Floats  # vertices in the world, metres
    normals: Floats  # unit normals, outwards
    uv: Floats  # texture coordinates, metres along the surface
    triangles: Ids  # vertex numbers
    materials: Ids  # material number of each triangle
    tints: Floats  # linear reflectance of each triangle

    def moved(self, offset: ArrayLike) -> "Mesh":
        """Return the mesh shifted by `offset` (3,), its texture as well, so that copies do not look alike."""
        shift = np.asarray(offset, dtype=np.float64)
        uv = self.uv + np.array([[1.0, 1.9, 0.7], [0.6, 1.3, 1.0]]) @ shift
        return self._replace(points=self.points + shift, uv=uv)

    def turned(self, angle_deg: float) -> "Mesh":
        """Return the mesh turned about the vertical axis through the origin, counter-clockwise from above."""
        c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return self._replace(points=self.points @ rotation.T, normals=self.normals @ rotation.T)


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join meshes into one, in order."""
    parts = list(meshes)
    starts = np.cumsum([0] + [len(part.points) for part in parts[:-1]])
    shift = np.repeat(starts, [len(part.triangles) for part in parts])
    joined = Mesh(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    return joined._replace(triangles=(joined.triangles + shift[:, None]).astype(np.int32))


def _mesh(points: Floats, normals: Floats, uv: Floats, cells: NDArray[np.int64], look: Look) -> Mesh:
    """Make a mesh of vertices and cells (Q, 4) of four corners."""
    triangles = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]]).astype(np.int32)
    materials = np.full(len(triangles), NUMBER[look.material], dtype=np.int32)
    tints = np.tile(np.asarray(look.colour, dtype=np.float64), (len(triangles), 1))
    return Mesh(points.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), triangles, materials, tints)


def smooth_sheet(points: Floats, look: Look) -> Mesh:
    """Make a curved surface of a grid of points (rows, columns, 3); normals are ``d/dcolumn x d/drow``."""
    normals = unit_vectors(np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0)))
    if np.allclose(points[:, 0], points[:, -1]):
        normals[:, 0] = normals[:, -1] = unit_vectors(normals[:, 0] + normals[:, -1])
    u = np.cumsum(np.linalg.norm(np.diff(points, axis=1, prepend=points[:, :1]), axis=2).max(axis=0))
    v = np.cumsum(np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=2).max(axis=1))
    index = np.arange(normals.size // 3).reshape(points.shape[:2])
    cells = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
    return _mesh(points, normals, np.stack(np.meshgrid(u, v), axis=-1), cells.reshape(-1, 4), look)


def quads(corners: ArrayLike, look: Look) -> Mesh:
    """Make flat quadrilaterals (Q, 4, 3), counter-clockwise from outside; textures follow the position."""
    points = np.asarray(corners, dtype=np.float64)
    normal = unit_vectors(np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]))
    right = unit_vectors(points[:, 1] - points[:, 0])
    frame = np.stack([right, np.cross(normal, right)], axis=2)
    uv = points @ frame + 1.7 * (points[:, :1] * normal[:, None]).sum(axis=2, keepdims=True)
    cells = np.arange(4 * len(points)).reshape(-1, 4)
    return _mesh(points, np.repeat(normal, 4, axis=0), uv, cells, look)


def patch(origin: ArrayLike, across: ArrayLike, up: ArrayLike, look: Look) -> Mesh:
    """Make a flat parallelogram with the normal ``across x up``."""
    o, a, b = (np.asarray(x, dtype=np.float64) for x in (origin, across, up))
    return quads([[o, o + a, o + a + b, o + b]], look)


_CUBE = np.array(
    [
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[1, 1, 0], [0, 1, 0], [0, 1, 1], [1, 1, 1]],
        [[0, 1, 0], [0, 0, 0], [0, 0, 1], [0, 1, 1]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
    ],
    dtype=np.float64,
)
"""Corners of the sides of a cube (6, 4, 3), counter-clockwise from outside."""


def slab(origin: ArrayLike, x: ArrayLike, y: ArrayLike, z: ArrayLike, look: Look) -> Mesh:
    """Make a closed parallelepiped of a corner and three right-handed sides (3,)."""
    sides = np.array([x, y, z], dtype=np.float64)
    return quads(np.asarray(origin, dtype=np.float64) + _CUBE @ sides, look)


def box(low: ArrayLike, high: ArrayLike, look: Look, inset: tuple[float, float] = (0.0, 0.0)) -> Mesh:
    """Make a box along the axes from its lowest to its highest corner, its top inset in x and y."""
    corners = np.asarray(low) + _CUBE * np.subtract(high, low)
    corners[..., :2] += (1.0 - 2.0 * _CUBE[..., :2]) * _CUBE[..., 2:] * inset
    return quads(corners, look)


def lathe(profile: ArrayLike, foot: ArrayLike, look: Look, segments: int = 12) -> Mesh:
    """Turn a profile (radius, height), listed from the bottom up, about a vertical axis."""
    shape = np.asarray(profile, dtype=np.float64)
    angle = np.linspace(0.0, 2.0 * math.pi, segments + 1)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    points = shape[:, None, :1] * ring + shape[:, None, 1:] * [0.0, 0.0, 1.0]
    return smooth_sheet(points, look).moved(foot)


def bar(path: ArrayLike, radii: Sequence[float], look: Look) -> Mesh:
    """Make a round bar along a path of points: branches, rails, limbs; eight sides."""
    line = np.asarray(path, dtype=np.float64)
    tangent = unit_vectors(np.gradient(line, axis=0))
    side = unit_vectors(
        np.cross(tangent, np.where(np.abs(tangent[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]]))
    )
    angle = np.linspace(0.0, 2.0 * math.pi, 9)[None, :, None]
    ring = np.cos(angle) * side[:, None] + np.sin(angle) * np.cross(tangent, side)[:, None]
    points = line[:, None] + np.asarray(radii, dtype=np.float64)[:, None, None] * ring
    return smooth_sheet(points, look)


def ellipsoid(
    centre: ArrayLike, radii: ArrayLike, look: Look, bumps: np.random.Generator | None = None, rows: int = 12
) -> Mesh:
    """Make an ellipsoid, its surface uneven if there is a generator of `bumps`."""
    tilt = np.linspace(-1.57, 1.57, rows + 1)  # nearly to the poles, at which normals are undefined
    turn = np.linspace(0.0, 2.0 * math.pi, 2 * rows + 1)
    height = np.ones((rows + 1, 2 * rows + 1, 1))
    if bumps is not None:
        height += 0.3 * (bumps.random(height.shape) - 0.5)
        height[0], height[-1], height[:, -1] = height[0, 0], height[-1, 0], height[:, 0]
    flat = np.cos(tilt)[:, None]
    ball = np.stack(
        [flat * np.cos(turn), flat * np.sin(turn), np.broadcast_to(np.sin(tilt)[:, None], height.shape[:2])],
        axis=-1,
    )
    return smooth_sheet(ball * height * np.asarray(radii, dtype=np.float64), look).moved(centre)


def unit_vectors(vectors: Floats) -> Floats:
    """Scale vectors to length 1; zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12), dtype=np.float64)
