"""Things that stand about: parked cars, lamps, bollards, signs, balustrades, columns."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sequences.meshes import Colour, Mesh, from_grid, merge, patch
from sequences.shapes import box, lathe, tube
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

_ROOF_LINE = np.array(
    [
        (0.00, 0.42), (0.03, 0.62), (0.12, 0.72), (0.60, 0.84), (1.05, 0.92),
        (1.20, 0.96), (1.55, 1.18), (1.95, 1.39), (2.30, 1.45), (2.80, 1.46), (3.30, 1.41),
        (3.55, 1.26), (3.80, 1.06), (3.95, 0.98), (4.10, 0.92), (4.17, 0.72), (4.18, 0.42),
    ]
)  # fmt: skip
_BELT_M = 0.93


def car(colour: Colour) -> Mesh:
    """Make a parked hatchback, 4.2 m long, nose towards -y, standing at the origin."""
    parts = []
    paint, glass = np.array(colour) * 1.7, np.array((0.05, 0.06, 0.065)) * 1.7
    half = np.array([_half_width(z) for z in _ROOF_LINE[:, 1]])
    for first, last in ((0, 5), (5, 7), (7, 10), (10, 13), (13, 16)):
        line, width = _ROOF_LINE[first : last + 1], half[first : last + 1]
        s = np.linspace(-1, 1, 9)
        points = np.empty((len(line), 9, 3))
        points[..., 0] = s * width[:, None]
        points[..., 1] = line[:, :1]
        points[..., 2] = line[:, 1:] - 0.05 * (s**4)
        is_glass = (first, last) in ((5, 7), (10, 13))
        parts.append(from_grid(points, points[..., :2], NUMBER["paint"], glass if is_glass else paint))
    length = np.linspace(0.0, 4.18, 45)
    roof = np.interp(length, _ROOF_LINE[:, 0], _ROOF_LINE[:, 1]) - 0.05
    for side in (-1.0, 1.0):
        parts.append(_flank(length, np.full_like(length, 0.24), np.minimum(roof, _BELT_M), side, paint))
        cabin = (length > 1.15) & (length < 3.95)
        parts.append(_flank(length[cabin], np.full(cabin.sum(), _BELT_M), roof[cabin], side, paint))
        for front, back in ((1.42, 2.45), (2.52, 3.66)):
            panes = (length > front) & (length < back)
            top = np.maximum(roof[panes] - 0.07, _BELT_M + 0.05)
            parts.append(_flank(length[panes], np.full(panes.sum(), _BELT_M + 0.04), top, side, glass, 0.008))
        for y in (0.78, 3.38):
            parts.append(_wheel(side * 0.80, y, 0.31))
    return merge([*parts, *_fittings()]).moved((0, -2.1, 0))


def _fittings() -> list[Mesh]:
    """Make lamps at the back and the front, number plates, bumpers, and what is under a car."""
    paint, parts = NUMBER["paint"], []
    for side in (-1.0, 1.0):
        x = side * 0.68
        parts.append(box((x - 0.12, 4.12, 0.68), (x + 0.12, 4.2, 0.86), paint, (0.5, 0.03, 0.025)))
        x = side * 0.62
        parts.append(box((x - 0.16, -0.01, 0.47), (x + 0.16, 0.08, 0.6), paint, (1.5, 1.5, 1.4)))
    for y in (-0.03, 4.17):
        parts.append(box((-0.26, y, 0.5), (0.26, y + 0.03, 0.61), paint, (1.5, 1.5, 1.3)))
        parts.append(box((-0.84, y - 0.02, 0.26), (0.84, y + 0.05, 0.44), paint, (0.12, 0.12, 0.13)))
    parts.append(box((-0.78, 0.3, 0.16), (0.78, 3.9, 0.3), paint, (0.05, 0.05, 0.05)))
    return parts


def _half_width(z: float) -> float:
    return 0.84 - 0.24 * float(max(0.0, (z - _BELT_M) / 0.55) ** 1.2)


def _flank(y: Floats, low: Floats, high: Floats, side: float, tint: Floats, proud: float = 0.0) -> Mesh:
    t = np.linspace(0, 1, 7)[:, None]
    z = low + t * np.maximum(high - low, 0.0)
    x = side * (np.vectorize(_half_width)(z) + proud - 0.03 * np.clip((0.5 - z) / 0.3, 0, 1))
    points = np.stack([x, np.broadcast_to(y, z.shape), z], axis=-1)
    grid = points if side > 0 else points[:, ::-1]
    return from_grid(np.ascontiguousarray(grid), np.ascontiguousarray(grid[..., 1:]), NUMBER["paint"], tint)


def _wheel(x: float, y: float, radius: float) -> Mesh:
    profile = [
        (radius * 0.98, -0.11),
        (radius, -0.08),
        (radius, 0.08),
        (radius * 0.98, 0.11),
        (radius * 0.66, 0.12),
    ]
    tyre = lathe(profile, (0, 0, 0), NUMBER["paint"], (0.05, 0.05, 0.05), 20)
    rim = lathe(
        [(radius * 0.66, 0.10), (radius * 0.2, 0.09), (0.001, 0.12)],
        (0, 0, 0),
        NUMBER["paint"],
        (0.7, 0.7, 0.72),
        20,
    )
    sign = 1.0 if x > 0 else -1.0
    turn = np.array([[0.0, 0.0, sign], [0.0, sign, 0.0], [-1.0, 0.0, 0.0]])
    both = merge([tyre, rim])
    return replace(both, points=both.points @ turn.T, normals=both.normals @ turn.T).moved((x, y, radius))


def lamp(foot: ArrayLike, towards: float, height_m: float = 5.2) -> Mesh:
    """Make a street lamp whose arm reaches `towards` metres along x."""
    base = np.asarray(foot, dtype=np.float64)
    iron = (0.14, 0.17, 0.15)
    profile = [(0.14, 0), (0.14, 0.5), (0.09, 0.62), (0.07, 1.0), (0.055, height_m)]
    arm = [
        base + np.array([0, 0, height_m]),
        base + np.array([0.35 * towards, 0, height_m + 0.32]),
        base + np.array([towards, 0, height_m + 0.34]),
    ]
    head = base + np.array([towards, 0, height_m + 0.2])
    parts = [
        lathe(profile, base, NUMBER["paint"], iron, 10),
        tube(arm, [0.045, 0.04, 0.04], NUMBER["paint"], iron),
    ]
    parts.append(
        box(head - np.array([0.2, 0.1, 0.0]), head + np.array([0.2, 0.1, 0.16]), NUMBER["paint"], iron)
    )
    return merge(parts)


def bollard(foot: ArrayLike) -> Mesh:
    """Make a cast-iron bollard."""
    profile = [
        (0.1, 0),
        (0.1, 0.08),
        (0.06, 0.14),
        (0.055, 0.7),
        (0.08, 0.74),
        (0.08, 0.8),
        (0.05, 0.9),
        (0.001, 0.94),
    ]
    return lathe(profile, foot, NUMBER["paint"], (0.11, 0.12, 0.13), 16)


def sign(foot: ArrayLike, colour: Colour, height_m: float = 2.3) -> Mesh:
    """Make a round traffic sign on a pole, facing -y."""
    base = np.asarray(foot, dtype=np.float64)
    parts = [lathe([(0.03, 0), (0.03, height_m + 0.3)], base, NUMBER["paint"], (0.55, 0.56, 0.57), 8)]
    radii = ((0.3, (1.5, 1.5, 1.5), 0.05), (0.27, colour, 0.056), (0.17, (1.5, 1.5, 1.45), 0.062))
    for radius, tint, proud in radii:
        angle = np.linspace(0, 2 * math.pi, 25)
        rim = np.stack([radius * np.cos(angle), np.full(25, -proud), radius * np.sin(angle)], axis=-1)
        disc = np.stack([np.broadcast_to([0.0, -proud, 0.0], rim.shape), rim])
        mesh = from_grid(
            disc + base + np.array([0, 0, height_m]), disc[..., [0, 2]], NUMBER["paint"], tint, smooth=False
        )
        normals = np.broadcast_to([0.0, -1.0, 0.0], mesh.points.shape).copy()
        parts.append(replace(mesh, normals=normals))
    return merge(parts)


def column(foot: ArrayLike, height_m: float, radius_m: float, tint: ArrayLike = (1, 1, 1)) -> Mesh:
    """Make a round stone column with base and capital."""
    r, h = radius_m, height_m
    shaft = [(0.95 * r, 0.45 * r + t * (h - 1.3 * r)) for t in np.linspace(0, 1, 9)]
    shaft = [(x * (1.0 - 0.13 * i / 8), z) for i, (x, z) in enumerate(shaft)]
    profile = [(1.35 * r, 0.0), (1.35 * r, 0.25 * r), (1.15 * r, 0.35 * r), *shaft]
    profile += [(1.0 * r, h - 0.75 * r), (1.3 * r, h - 0.35 * r), (1.35 * r, h - 0.3 * r), (1.35 * r, h)]
    return lathe(profile, foot, NUMBER["marble"], tint, 20)


def baluster(foot: ArrayLike, height_m: float, tint: ArrayLike = (1, 1, 1)) -> Mesh:
    """Make a turned stone baluster."""
    outline = [
        (0.065, 0),
        (0.065, 0.08),
        (0.04, 0.13),
        (0.062, 0.3),
        (0.075, 0.4),
        (0.055, 0.58),
        (0.034, 0.76),
    ]
    outline += [(0.05, 0.84), (0.035, 0.88), (0.065, 0.93), (0.065, 1.0)]
    return lathe([(r, height_m * z) for r, z in outline], foot, NUMBER["marble"], tint, 10)


def bench(foot: ArrayLike) -> Mesh:
    """Make a wooden bench, 1.8 m along x, facing -y."""
    wood, iron = NUMBER["wood"], NUMBER["paint"]
    parts = [
        box((-0.9, 0.12 * k, 0.43), (0.9, 0.12 * k + 0.1, 0.47), wood, (0.9, 0.9, 0.9)) for k in range(4)
    ]
    parts += [
        box((-0.9, 0.46, 0.58 + 0.15 * k), (0.9, 0.49, 0.69 + 0.15 * k), wood, (0.9, 0.9, 0.9))
        for k in range(2)
    ]
    for x in (-0.75, 0.7):
        parts.append(box((x, 0.0, 0.0), (x + 0.05, 0.48, 0.43), iron, (0.12, 0.12, 0.12)))
        parts.append(box((x, 0.48, 0.0), (x + 0.05, 0.53, 0.86), iron, (0.12, 0.12, 0.12)))
    return merge(parts).moved(foot)


def planter(low: ArrayLike, high: ArrayLike) -> Mesh:
    """Make a stone box filled with earth."""
    a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    rim = 0.06
    parts = [box(a, b, NUMBER["stone"], (0.9, 0.88, 0.84), 0.2)]
    size = b - a - [2 * rim, 2 * rim, 0.0]
    earth = (a[0] + rim, a[1] + rim, b[2] + 0.005)
    parts.append(patch(earth, (size[0], 0, 0), (0, size[1], 0), NUMBER["gravel"], (0.3, 0.22, 0.15), 0.2))
    return merge(parts)
