"""A robed figure as the level set of a signed distance field, cut into triangles by marching cubes."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sequences.meshes import Mesh
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

LOW, HIGH = np.array([-0.62, -0.48, -0.03]), np.array([0.62, 0.48, 2.32])


def ellipsoid(points: Floats, centre: ArrayLike, radii: ArrayLike) -> Floats:
    """Return the approximate signed distance (metres) of points (..., 3) to an ellipsoid.

    Parameters
    ----------
    points : ndarray of shape (..., 3), float64
        Where to evaluate, metres.
    centre : array_like of shape (3,)
        Its middle, metres.
    radii : array_like of shape (3,)
        Half axes, metres.

    Returns
    -------
    ndarray of shape (...), float64
        Distance, negative inside.
    """
    scaled = (points - np.asarray(centre)) / np.asarray(radii)
    length = np.sqrt((scaled**2).sum(axis=-1))
    gradient = np.sqrt(((scaled / np.asarray(radii)) ** 2).sum(axis=-1))
    return np.asarray(length * (length - 1.0) / np.maximum(gradient, 1e-6))


def capsule(points: Floats, start: ArrayLike, end: ArrayLike, radii: tuple[float, float]) -> Floats:
    """Return the signed distance (metres) of points (..., 3) to a round bar whose radius changes evenly.

    Parameters
    ----------
    points : ndarray of shape (..., 3), float64
        Where to evaluate, metres.
    start : array_like of shape (3,)
        One end of the axis, metres.
    end : array_like of shape (3,)
        The other end, metres.
    radii : tuple of float
        Radius at either end, metres.

    Returns
    -------
    ndarray of shape (...), float64
        Distance, negative inside.
    """
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    t = np.clip(((points - a) @ (b - a)) / float((b - a) @ (b - a)), 0.0, 1.0)
    distance = np.sqrt(((points - a - t[..., None] * (b - a)) ** 2).sum(axis=-1))
    return np.asarray(distance - (radii[0] + t * (radii[1] - radii[0])))


def block(points: Floats, centre: ArrayLike, half: ArrayLike) -> Floats:
    """Return the signed distance (metres) of points (..., 3) to a box along the axes.

    Parameters
    ----------
    points : ndarray of shape (..., 3), float64
        Where to evaluate, metres.
    centre : array_like of shape (3,)
        Its middle, metres.
    half : array_like of shape (3,)
        Half sides, metres.

    Returns
    -------
    ndarray of shape (...), float64
        Distance, negative inside.
    """
    q = np.abs(points - np.asarray(centre)) - np.asarray(half)
    outside = np.sqrt((np.maximum(q, 0.0) ** 2).sum(axis=-1))
    return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0) - 0.012)


def blend(a: Floats, b: Floats, width: float) -> Floats:
    """Return the union of two distance fields, rounded over `width` metres where they meet.

    Parameters
    ----------
    a : ndarray, float64
        One distance field.
    b : ndarray, float64
        The other.
    width : float
        Reach of the rounding, metres.

    Returns
    -------
    ndarray of shape (...), float64
        Distance, negative inside.
    """
    h = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.asarray(np.minimum(a, b) - 0.25 * width * h**2)


def robe(points: Floats) -> Floats:
    """Return the distance to a long garment with deep folds, from the hips to the ground.

    Parameters
    ----------
    points : ndarray of shape (..., 3), float64
        Where to evaluate, metres.

    Returns
    -------
    ndarray of shape (...), float64
        Distance, negative inside.
    """
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    lean = 0.03 * np.sin(1.6 * z)
    angle = np.arctan2(y / 0.85, x - lean)
    fall = np.clip(1.0 - z / 1.15, 0.0, 1.0)
    radius = 0.185 + 0.13 * fall**1.4
    folds = np.sin(11 * angle + 2.2 * np.sin(2.3 * z) + 1.2 * z) + 0.5 * np.sin(19 * angle - 3.0 * z)
    radius = radius * (1.0 + (0.035 + 0.10 * fall) * 0.7 * folds)
    side = np.hypot(x - lean, y / 0.85) - radius
    return np.asarray(np.maximum(0.62 * side, np.maximum(z - 1.12, -z)))


def distance_field(points: Floats) -> Floats:
    """Return the signed distance (metres, approximate) of points (..., 3) to the figure, which faces -y.

    Parameters
    ----------
    points : ndarray of shape (..., 3), float64
        Where to evaluate, metres.

    Returns
    -------
    ndarray of shape (...), float64
        Distance, negative inside.
    """
    body = blend(robe(points), ellipsoid(points, (0.015, 0.0, 1.24), (0.205, 0.145, 0.30)), 0.10)
    body = blend(body, capsule(points, (-0.185, 0.0, 1.44), (0.20, 0.0, 1.43), (0.088, 0.088)), 0.10)
    body = blend(body, capsule(points, (0.01, 0.005, 1.46), (0.01, -0.01, 1.62), (0.066, 0.056)), 0.05)
    head = blend(
        ellipsoid(points, (0.01, -0.015, 1.725), (0.086, 0.102, 0.122)),
        ellipsoid(points, (0.01, 0.035, 1.765), (0.098, 0.098, 0.098)),
        0.03,
    )
    head = blend(head, capsule(points, (0.01, -0.108, 1.74), (0.01, -0.128, 1.705), (0.012, 0.019)), 0.018)
    head = blend(head, ellipsoid(points, (0.01, -0.075, 1.615), (0.058, 0.055, 0.075)), 0.04)
    for side in (-1.0, 1.0):
        head = np.maximum(
            head, -ellipsoid(points, (0.01 + 0.036 * side, -0.122, 1.742), (0.024, 0.026, 0.015))
        )
    locks = 0.006 * np.sin(70 * points[..., 0]) * np.sin(60 * points[..., 2] + 40 * points[..., 1])
    head = head + locks * (points[..., 1] > -0.03)
    body = blend(body, head, 0.03)
    arms = blend(
        capsule(points, (0.22, 0.0, 1.42), (0.40, -0.05, 1.22), (0.080, 0.066)),
        capsule(points, (0.40, -0.05, 1.22), (0.46, -0.22, 1.42), (0.066, 0.042)),
        0.05,
    )
    arms = blend(arms, ellipsoid(points, (0.465, -0.245, 1.46), (0.045, 0.048, 0.055)), 0.03)
    left = blend(
        capsule(points, (-0.20, 0.0, 1.42), (-0.30, -0.03, 1.12), (0.082, 0.068)),
        capsule(points, (-0.30, -0.03, 1.12), (-0.12, -0.23, 1.10), (0.068, 0.045)),
        0.05,
    )
    body = blend(blend(body, arms, 0.07), left, 0.06)
    creases = 0.012 * np.sin(34 * (points[..., 2] + 0.9 * points[..., 0]) + 3 * np.sin(9 * points[..., 0]))
    sash = capsule(points, (-0.23, 0.05, 1.44), (0.19, -0.10, 0.98), (0.07, 0.10)) + creases
    hang = capsule(points, (-0.24, 0.12, 1.40), (-0.20, 0.14, 0.2), (0.07, 0.15))
    hang = hang + 0.016 * np.sin(46 * (points[..., 0] - 0.8 * points[..., 1]) + 2.0 * points[..., 2])
    body = blend(body, blend(sash, hang, 0.06), 0.04)
    body = np.minimum(body, block(points, (-0.10, -0.25, 1.17), (0.095, 0.03, 0.125)))
    staff = capsule(points, (0.475, -0.255, 0.0), (0.475, -0.255, 2.18), (0.021, 0.021))
    return blend(
        blend(body, staff, 0.015), ellipsoid(points, (0.475, -0.255, 2.20), (0.05, 0.05, 0.06)), 0.02
    )


def figure(step_m: float) -> Mesh:
    """Cut the figure into triangles.

    Parameters
    ----------
    step_m : float
        Grid step of the marching cubes, metres.

    Returns
    -------
    Mesh
        About 2.3 m tall on z = 0, facing -y, with smooth normals.
    """
    from skimage.measure import marching_cubes

    axes = [np.arange(low, high, step_m) for low, high in zip(LOW, HIGH, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    level_set: Callable[..., Any] = marching_cubes
    vertices, triangles, _, _ = level_set(distance_field(grid), 0.0)
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
        [distance_field(points + step) - distance_field(points - step) for step in steps], axis=-1
    )
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12))
