"""A robed figure as the level set of a signed distance field, cut into triangles by marching cubes."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sequences.meshes import Mesh
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

LOW, HIGH = np.array([-0.62, -0.48, -0.03]), np.array([0.62, 0.48, 2.32])


def _ellipsoid(points: Floats, centre: ArrayLike, radii: ArrayLike) -> Floats:
    """Return the approximate signed distance (...) in metres of points (..., 3) to an ellipsoid."""
    scaled = (points - np.asarray(centre)) / np.asarray(radii)
    length = np.sqrt((scaled**2).sum(axis=-1))
    gradient = np.sqrt(((scaled / np.asarray(radii)) ** 2).sum(axis=-1))
    return np.asarray(length * (length - 1.0) / np.maximum(gradient, 1e-6))


def _capsule(points: Floats, start: ArrayLike, end: ArrayLike, radii: tuple[float, float]) -> Floats:
    """Return the signed distance to a round bar whose radius changes evenly."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    t = np.clip(((points - a) @ (b - a)) / float((b - a) @ (b - a)), 0.0, 1.0)
    distance = np.sqrt(((points - a - t[..., None] * (b - a)) ** 2).sum(axis=-1))
    return np.asarray(distance - (radii[0] + t * (radii[1] - radii[0])))


def _block(points: Floats, centre: ArrayLike, half: ArrayLike) -> Floats:
    """Return the signed distance to a box along the axes."""
    q = np.abs(points - np.asarray(centre)) - np.asarray(half)
    outside = np.sqrt((np.maximum(q, 0.0) ** 2).sum(axis=-1))
    return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0) - 0.012)


def _blend(a: Floats, b: Floats, width: float) -> Floats:
    """Return the union of two distance fields, rounded over `width` metres where they meet."""
    h = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.asarray(np.minimum(a, b) - 0.25 * width * h**2)


def _robe(points: Floats) -> Floats:
    """Return the distance to a long garment with deep folds, from the hips to the ground."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    lean = 0.03 * np.sin(1.6 * z)
    angle = np.arctan2(y / 0.85, x - lean)
    fall = np.clip(1.0 - z / 1.15, 0.0, 1.0)
    radius = 0.185 + 0.13 * fall**1.4
    folds = np.sin(11 * angle + 2.2 * np.sin(2.3 * z) + 1.2 * z) + 0.5 * np.sin(19 * angle - 3.0 * z)
    radius = radius * (1.0 + (0.035 + 0.10 * fall) * 0.7 * folds)
    side = np.hypot(x - lean, y / 0.85) - radius
    return np.asarray(np.maximum(0.62 * side, np.maximum(z - 1.12, -z)))


def _distance_field(points: Floats) -> Floats:
    """Return the signed distance (metres, approximate, negative inside) to the figure, which faces -y."""
    body = _blend(_robe(points), _ellipsoid(points, (0.015, 0.0, 1.24), (0.205, 0.145, 0.30)), 0.10)
    body = _blend(body, _capsule(points, (-0.185, 0.0, 1.44), (0.20, 0.0, 1.43), (0.088, 0.088)), 0.10)
    body = _blend(body, _capsule(points, (0.01, 0.005, 1.46), (0.01, -0.01, 1.62), (0.066, 0.056)), 0.05)
    head = _blend(
        _ellipsoid(points, (0.01, -0.015, 1.725), (0.086, 0.102, 0.122)),
        _ellipsoid(points, (0.01, 0.035, 1.765), (0.098, 0.098, 0.098)),
        0.03,
    )
    head = _blend(head, _capsule(points, (0.01, -0.108, 1.74), (0.01, -0.128, 1.705), (0.012, 0.019)), 0.018)
    head = _blend(head, _ellipsoid(points, (0.01, -0.075, 1.615), (0.058, 0.055, 0.075)), 0.04)
    for side in (-1.0, 1.0):
        head = np.maximum(
            head, -_ellipsoid(points, (0.01 + 0.036 * side, -0.122, 1.742), (0.024, 0.026, 0.015))
        )
    locks = 0.006 * np.sin(70 * points[..., 0]) * np.sin(60 * points[..., 2] + 40 * points[..., 1])
    head = head + locks * (points[..., 1] > -0.03)
    body = _blend(body, head, 0.03)
    arms = _blend(
        _capsule(points, (0.22, 0.0, 1.42), (0.40, -0.05, 1.22), (0.080, 0.066)),
        _capsule(points, (0.40, -0.05, 1.22), (0.46, -0.22, 1.42), (0.066, 0.042)),
        0.05,
    )
    arms = _blend(arms, _ellipsoid(points, (0.465, -0.245, 1.46), (0.045, 0.048, 0.055)), 0.03)
    left = _blend(
        _capsule(points, (-0.20, 0.0, 1.42), (-0.30, -0.03, 1.12), (0.082, 0.068)),
        _capsule(points, (-0.30, -0.03, 1.12), (-0.12, -0.23, 1.10), (0.068, 0.045)),
        0.05,
    )
    body = _blend(_blend(body, arms, 0.07), left, 0.06)
    creases = 0.012 * np.sin(34 * (points[..., 2] + 0.9 * points[..., 0]) + 3 * np.sin(9 * points[..., 0]))
    sash = _capsule(points, (-0.23, 0.05, 1.44), (0.19, -0.10, 0.98), (0.07, 0.10)) + creases
    hang = _capsule(points, (-0.24, 0.12, 1.40), (-0.20, 0.14, 0.2), (0.07, 0.15))
    hang = hang + 0.016 * np.sin(46 * (points[..., 0] - 0.8 * points[..., 1]) + 2.0 * points[..., 2])
    body = _blend(body, _blend(sash, hang, 0.06), 0.04)
    body = np.minimum(body, _block(points, (-0.10, -0.25, 1.17), (0.095, 0.03, 0.125)))
    staff = _capsule(points, (0.475, -0.255, 0.0), (0.475, -0.255, 2.18), (0.021, 0.021))
    return _blend(
        _blend(body, staff, 0.015), _ellipsoid(points, (0.475, -0.255, 2.20), (0.05, 0.05, 0.06)), 0.02
    )


def figure(step_m: float) -> Mesh:
    """Cut the figure into triangles."""
    from skimage.measure import marching_cubes

    axes = [np.arange(low, high, step_m) for low, high in zip(LOW, HIGH, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    level_set: Callable[..., Any] = marching_cubes
    vertices, triangles, _, _ = level_set(_distance_field(grid), 0.0)
    points = vertices.astype(np.float64) * step_m + LOW
    normals = _gradient(points)
    uv = np.stack([points[:, 0] + 0.62 * points[:, 1], points[:, 2] + 0.35 * points[:, 1]], axis=-1)
    rain = np.clip(0.72 + 0.42 * normals[:, 2], 0.5, 1.05)
    tint = rain[:, None] * np.array([1.12, 1.08, 1.0])
    materials = np.full(len(triangles), NUMBER["marble"], dtype=np.int32)
    return Mesh(points, normals, uv, tint, triangles.astype(np.int32), materials)


def _gradient(points: Floats, step_m: float = 0.006) -> Floats:
    steps = step_m * np.eye(3)
    slope = np.stack(
        [_distance_field(points + step) - _distance_field(points - step) for step in steps], axis=-1
    )
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12))
