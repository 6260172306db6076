"""Plants: leaves one by one, trees, shrubs, ivy, tufts of grass."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sequences.meshes import Mesh, merge, quads, unit_vectors
from sequences.shapes import tube
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

GREEN = (0.20, 0.40, 0.10)
UP = np.array([0.0, 0.0, 1.0])


def leaves(
    rng: np.random.Generator, centres: Floats, outwards: Floats, length_m: float, colour: ArrayLike = GREEN
) -> Mesh:
    """Put a folded, pointed leaf of random attitude and shade at each centre."""
    count = len(centres)
    normal = unit_vectors(outwards + 0.75 * rng.standard_normal((count, 3)) + [0.0, 0.0, 0.35])
    axis = unit_vectors(np.cross(normal, rng.standard_normal((count, 3))))
    side = np.cross(normal, axis)
    size = length_m * rng.uniform(0.6, 1.35, (count, 1))
    fold = 0.18 * size * normal
    corners = [-0.5 * axis * size, 0.34 * side * size + fold, 0.5 * axis * size, -0.34 * side * size + fold]
    points = np.stack([centres + corner for corner in corners], axis=1).reshape(-1, 3)
    shade = np.exp(0.24 * rng.standard_normal((count, 1)))
    hue = np.asarray(colour) * shade * (1 + rng.uniform(-0.14, 0.22, (count, 1)) * np.array([1.0, 0.25, 0.0]))
    uv = rng.uniform(0, 0.8, (count, 1, 2)) + 0.2 * size[:, None] * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    triangles = quads(count)
    return Mesh(
        points,
        np.repeat(unit_vectors(0.5 * normal + 0.5 * outwards), 4, axis=0),
        uv.reshape(-1, 2),
        np.repeat(hue, 4, axis=0),
        triangles,
        np.full(len(triangles), NUMBER["leaf"], dtype=np.int32),
    )


def clump(
    rng: np.random.Generator,
    centre: ArrayLike,
    radii: ArrayLike,
    count: int,
    length_m: float,
    colour: ArrayLike = GREEN,
) -> Mesh:
    """Fill an ellipsoid with leaves, more of them near its surface, darker within."""
    direction = unit_vectors(rng.standard_normal((count, 3)))
    depth = rng.random((count, 1)) ** 0.4
    offset = direction * depth * np.asarray(radii) * (1 + 0.12 * rng.standard_normal((count, 1)))
    mesh = leaves(rng, np.asarray(centre, dtype=np.float64) + offset, direction, length_m, colour)
    return mesh.tinted(np.repeat(0.55 + 0.45 * depth, 4, axis=0))


def tree(
    rng: np.random.Generator,
    foot: ArrayLike,
    height_m: float,
    crown_m: float,
    count: int,
    length_m: float = 0.14,
    colour: ArrayLike = GREEN,
) -> Mesh:
    """Grow a broad-leaved tree."""
    base = np.asarray(foot, dtype=np.float64)
    fork = 0.36 * height_m
    girth = 0.028 * height_m
    bend = rng.uniform(-0.12, 0.12, 2)
    path = list(base + np.linspace(0, 1, 6)[:, None] * np.array([bend[0], bend[1], 1.25 * fork]))
    parts = [tube(path, list(girth * np.array([1.5, 1.05, 0.95, 0.88, 0.8, 0.65])), NUMBER["bark"])]
    clumps = 13
    for k in range(clumps):
        angle, level = 2.4 * k + rng.uniform(-0.4, 0.4), (k + 0.5) / clumps
        reach = crown_m * math.sin(math.pi * (0.22 + 0.66 * level)) * rng.uniform(0.45, 0.8)
        tip = base + np.array([reach * math.cos(angle), reach * math.sin(angle), 0.0])
        tip[2] += fork + (height_m - fork) * (0.1 + 0.8 * level)
        start = base + np.array([bend[0], bend[1], fork * rng.uniform(0.8, 1.2)])
        middle = 0.5 * (start + tip) + [0.0, 0.0, -0.12 * crown_m]
        radii = [0.42 * girth, 0.26 * girth, 0.08 * girth]
        parts.append(tube([start, middle, tip], radii, NUMBER["bark"]))
        size = crown_m * rng.uniform(0.34, 0.52) * np.array([1.0, 1.0, 0.75])
        shade = np.asarray(colour) * rng.uniform(0.85, 1.15)
        parts.append(clump(rng, tip, size, count // clumps, length_m, shade))
    return merge(parts)


def ivy(
    rng: np.random.Generator,
    origin: ArrayLike,
    across: ArrayLike,
    up: ArrayLike,
    count: int,
    length_m: float = 0.09,
) -> Mesh:
    """Cover part of a wall with ivy that hangs in tongues."""
    o, a, b = (np.asarray(x, dtype=np.float64) for x in (origin, across, up))
    normal = unit_vectors(np.cross(a, b)[None])[0]
    s, t = rng.random(count), rng.random(count)
    phases = rng.uniform(0, 2 * math.pi, 3)
    edge = (
        0.45
        + 0.2 * np.sin(7 * s + phases[0])
        + 0.16 * np.sin(17 * s + phases[1])
        + 0.1 * np.sin(41 * s + phases[2])
    )
    keep = 1 - t < edge
    thick = 0.16 * rng.random((count, 1)) ** 1.5 + 0.01
    centres = (o + s[:, None] * a + t[:, None] * b + thick * normal)[keep]
    return leaves(rng, centres, np.broadcast_to(normal, centres.shape), length_m, (0.14, 0.30, 0.07))


def tufts(rng: np.random.Generator, feet: Floats, height_m: float, blades: int = 14) -> Mesh:
    """Grow a tuft of grass blades, bent outwards, at each foot (K, 3)."""
    count = len(feet) * blades
    foot = np.repeat(feet, blades, axis=0) + rng.normal(0, 0.02, (count, 3)) * [1, 1, 0]
    angle = rng.uniform(0, 2 * math.pi, count)
    lean = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1)
    height = height_m * rng.uniform(0.5, 1.2, (count, 1))
    side = 0.006 * np.stack([-lean[:, 1], lean[:, 0], lean[:, 2]], axis=-1)
    middle = foot + 0.25 * height * lean + 0.7 * height * UP
    tip = foot + 0.6 * height * lean + height * UP
    points = np.stack([foot - side, foot + side, middle + side, tip], axis=1).reshape(-1, 3)
    triangles = quads(count)
    hue = np.array([0.32, 0.46, 0.14]) * np.exp(0.25 * rng.standard_normal((count, 1)))
    shade = np.tile([0.5, 0.5, 0.9, 1.1], count)[:, None]
    normals = np.repeat(unit_vectors(lean + UP), 4, axis=0)
    uv = rng.uniform(0, 0.8, (4 * count, 2))
    materials = np.full(len(triangles), NUMBER["leaf"], dtype=np.int32)
    return Mesh(points, normals, uv, np.repeat(hue, 4, axis=0) * shade, triangles, materials)
