"""Compiled loops of the renderer: rasterisation, point casting, procedural textures and shading."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Floats, Singles
from sequences.shapes import Ids, Mesh

NEAR_M = 0.05
"""Distance before the camera from which surfaces are visible, metres."""
OCTAVES = 8
LIFT_M = 0.03
"""Distance of a point from its surface when it is compared with the shadow map, metres."""
HAZE_PER_M = 0.0014
"""Extinction of the air."""
CLOUD = 1.5


class Materials(NamedTuple):
    """Parameters of K procedural textures: columns of courses of stones, and of noise."""

    size: Floats  # width and height of a stone, metres; 0 for a surface without joints
    joint: Floats  # width of a joint, metres, and width of the dark rim of a stone
    joint_colour: Floats  # linear reflectance of the joints
    stagger: Floats  # shift of every second course, share of a stone, and raggedness of joints, metres
    spread: Floats  # deviation of the brightness of stones, and amplitude of the noise
    noise: Floats  # longest wavelength, metres, gain from one octave to the next, and stretch along v
    seed: int


class Light(NamedTuple):
    """Sun, its shadow map, sky and haze; colours are linear RGB."""

    to_sun: Floats
    sun: Floats
    sky: Floats
    ground: Floats
    haze: Floats
    zenith: Floats
    shadow_from_world: Floats
    shadow_depth: Singles


@kernel
def edge_functions(p: Floats, q: Floats, r: Floats, e: Floats) -> float:
    """Fill `e` (3, 3) with the edge functions of a homogeneous triangle and return its determinant."""
    for i in range(3):
        a, b = (q, r) if i == 0 else ((r, p) if i == 1 else (p, q))
        e[i, 0] = a[1] * b[2] - a[2] * b[1]
        e[i, 1] = a[2] * b[0] - a[0] * b[2]
        e[i, 2] = a[0] * b[1] - a[1] * b[0]
    det = float(p[0] * e[0, 0] + p[1] * e[0, 1] + p[2] * e[0, 2])
    if det < 0.0:
        det = -det
        e *= -1.0
    return det


@kernel
def span(p: Floats, q: Floats, r: Floats, axis: int, margin: float, size: int) -> tuple[int, int]:
    """Return the first and last column or row, below `size`, that a homogeneous triangle can touch."""
    before = int(p[2] <= NEAR_M) + int(q[2] <= NEAR_M) + int(r[2] <= NEAR_M)
    if before == 3:
        return 0, -1
    if before > 0:
        return 0, size - 1
    a, b, c = p[axis] / p[2], q[axis] / q[2], r[axis] / r[2]
    low, high = min(a, b, c) - margin, max(a, b, c) + margin
    if high < 0.0 or low > size - 1:
        return 0, -1
    return int(np.ceil(max(low, 0.0))), int(np.floor(min(high, size - 1.0)))


@kernel
def narrow(slope: float, offset: float, low: int, high: int) -> tuple[int, int]:
    """Shrink a range of columns to ``slope * column + offset >= 0``, with a margin of one column."""
    if slope > 0.0:
        root = -offset / slope - 1.0
        if root > low:
            low = high + 1 if root > high else int(np.ceil(root))
    elif slope < 0.0:
        root = -offset / slope + 1.0
        if root < high:
            high = low - 1 if root < low else int(np.floor(root))
    elif offset < 0.0:
        high = low - 1
    return low, high


@kernel
def rasterize(projected: Floats, triangles: Ids, inverse_depth: Singles, ids: Ids) -> None:
    """Keep the nearest triangle of every sample; `projected` is (N, 3) homogeneous in sample units."""
    height, width = ids.shape
    e = np.empty((3, 3))
    for t in range(triangles.shape[0]):
        p, q, r = projected[triangles[t, 0]], projected[triangles[t, 1]], projected[triangles[t, 2]]
        columns, rows = span(p, q, r, 0, 0.0, width), span(p, q, r, 1, 0.0, height)
        if columns[0] > columns[1] or rows[0] > rows[1]:
            continue
        det = edge_functions(p, q, r, e)
        if det == 0.0:
            continue
        for row in range(rows[0], rows[1] + 1):
            k0 = e[0, 1] * row + e[0, 2]
            k1 = e[1, 1] * row + e[1, 2]
            k2 = e[2, 1] * row + e[2, 2]
            low, high = columns
            if high - low > 8:
                low, high = narrow(e[0, 0], k0, low, high)
                low, high = narrow(e[1, 0], k1, low, high)
                low, high = narrow(e[2, 0], k2, low, high)
            for column in range(low, high + 1):
                e0, e1, e2 = e[0, 0] * column + k0, e[1, 0] * column + k1, e[2, 0] * column + k2
                if e0 >= 0.0 and e1 >= 0.0 and e2 >= 0.0:
                    inverse = np.float32((e0 + e1 + e2) / det)
                    if inverse > inverse_depth[row, column] and inverse < 1.0 / NEAR_M:
                        inverse_depth[row, column] = inverse
                        ids[row, column] = t


@kernel
def cast_points(
    projected: Floats,
    triangles: Ids,
    xy: Floats,
    cell_start: NDArray[Any],
    cell_points: NDArray[Any],
    depth: Floats,
    ids: Ids,
) -> None:
    """Find the nearest triangle behind every image point (P, 2), sorted into pixels by the caller."""
    height, width = cell_start.shape[0], cell_start.shape[1] - 1
    e = np.empty((3, 3))
    for t in range(triangles.shape[0]):
        p, q, r = projected[triangles[t, 0]], projected[triangles[t, 1]], projected[triangles[t, 2]]
        columns, rows = span(p, q, r, 0, 0.5, width), span(p, q, r, 1, 0.5, height)
        if columns[0] > columns[1] or rows[0] > rows[1]:
            continue
        det = edge_functions(p, q, r, e)
        if det == 0.0:
            continue
        for row in range(rows[0], rows[1] + 1):
            for k in range(cell_start[row, columns[0]], cell_start[row, columns[1] + 1]):
                j = cell_points[k]
                x, y = xy[j, 0], xy[j, 1]
                e0 = e[0, 0] * x + (e[0, 1] * y + e[0, 2])
                e1 = e[1, 0] * x + (e[1, 1] * y + e[1, 2])
                e2 = e[2, 0] * x + (e[2, 1] * y + e[2, 2])
                if e0 >= 0.0 and e1 >= 0.0 and e2 >= 0.0 and e0 + e1 + e2 > 0.0:
                    z = det / (e0 + e1 + e2)
                    if NEAR_M < z < depth[j]:
                        depth[j] = z
                        ids[j] = t


@kernel
def hashed(i: int, j: int, seed: int) -> float:
    """Return a pseudo-random number in [-1, 1] of a lattice point; nothing overflows 63 bits."""
    h = (i * 374761393 + j * 668265263 + seed * 83492791) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return float((h ^ (h >> 16)) / 2147483647.5 - 1.0)


@kernel
def noise(x: float, y: float, size: float, gain: float, seed: int) -> float:
    """Return fractal noise of deviation near 1; octaves finer than a footprint of `size` fade out."""
    total, power, amplitude = 0.0, 0.0, 1.0
    for octave in range(OCTAVES):
        power += amplitude * amplitude
        if size < 0.5:
            fx, fy = np.floor(x), np.floor(y)
            i, j, ax, ay = int(fx), int(fy), x - fx, y - fy
            ax, ay = ax * ax * (3.0 - 2.0 * ax), ay * ay * (3.0 - 2.0 * ay)
            top = (1.0 - ax) * hashed(i, j, seed + octave) + ax * hashed(i + 1, j, seed + octave)
            low = (1.0 - ax) * hashed(i, j + 1, seed + octave) + ax * hashed(i + 1, j + 1, seed + octave)
            total += amplitude * min(1.0, 2.0 - 4.0 * size) * ((1.0 - ay) * top + ay * low)
        x, y = 1.6 * x + 1.2 * y + 0.37, 1.6 * y - 1.2 * x + 0.71
        size, amplitude = 2.0 * size, amplitude * gain
    return float(total * 2.6 / np.sqrt(power))


@kernel
def texture(materials: Materials, k: int, place: Floats, tint: Floats, rgb: Floats) -> None:
    """Fill `rgb` with the reflectance of a material at `place`: u, v and footprint of a sample, metres."""
    u, v, size = place[0], place[1], place[2]
    seed = materials.seed + 101 * k
    wave = 1.0 / materials.noise[k, 0]
    stretched = v / materials.noise[k, 2]
    grain = noise(u * wave, stretched * wave, size * wave, materials.noise[k, 1], seed)
    shade = max(0.12, 1.0 + materials.spread[k, 1] * grain)
    wide, tall = materials.size[k, 0], materials.size[k, 1]
    body = 1.0
    if wide > 0.0:
        u += materials.stagger[k, 1] * noise(3.0 * v / tall, 2.0 * u / tall, 0.3, 0.5, seed + 31)
        v += materials.stagger[k, 1] * noise(2.0 * u / tall, 3.0 * v / tall, 0.3, 0.5, seed + 57)
        row = int(np.floor(v / tall))
        along = u / wide + materials.stagger[k, 0] * (row & 1) + 0.1 * hashed(row, 7, seed)
        column = int(np.floor(along))
        fu, fv = along - column, v / tall - row
        edge = min(min(fu, 1.0 - fu) * wide, min(fv, 1.0 - fv) * tall) - 0.5 * materials.joint[k, 0]
        far = min(1.0, 2.0 * size / tall)
        share = (1.0 - materials.joint[k, 0] / wide) * (1.0 - materials.joint[k, 0] / tall)
        body = (1.0 - far) * min(1.0, max(0.0, edge / max(size, 0.004) + 0.5)) + far * share
        rim = min(1.0, max(0.0, edge / materials.joint[k, 1]))
        shade *= (1.0 + materials.spread[k, 0] * hashed(column, row, seed + 13) * (1.0 - far)) * (
            0.7 + 0.3 * rim
        )
    for c in range(3):
        rgb[c] = shade * body * tint[c] + (1.0 - body) * materials.joint_colour[k, c]


@kernel
def sunlit(light: Light, x: float, y: float, z: float) -> float:
    """Return the visible share of the sun's disc at a world point: 2x2 comparisons in the shadow map."""
    m = light.shadow_from_world
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    column = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / w
    row = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / w
    height, width = light.shadow_depth.shape
    c, r = int(np.floor(column)), int(np.floor(row))
    if c < 0 or r < 0 or c >= width - 1 or r >= height - 1:
        return 1.0
    ac, ar = column - c, row - r
    total = 0.0
    for i in range(2):
        for j in range(2):
            if light.shadow_depth[r + i, c + j] >= w:
                total += (ar if i else 1.0 - ar) * (ac if j else 1.0 - ac)
    return total


@kernel
def sky(light: Light, rays: Floats, column: int, row: int, rgb: Floats) -> None:
    """Fill `rgb` with the sky that a sample sees: a gradient from haze to zenith, and clouds."""
    x = rays[0, 0] * column + rays[0, 1] * row + rays[0, 2]
    y = rays[1, 0] * column + rays[1, 1] * row + rays[1, 2]
    z = rays[2, 0] * column + rays[2, 1] * row + rays[2, 2]
    length = np.sqrt(x * x + y * y + z * z)
    up = max(z / length, 0.0)
    scale = 0.9 / ((up + 0.12) * length)
    cover = 0.45 * noise(x * scale, y * scale, 0.02, 0.55, 5) - 0.2
    cover = min(1.0, max(0.0, cover)) * min(1.0, 8.0 * up)
    t = 1.0 - np.exp(-3.2 * up)
    for k in range(3):
        clear = light.haze[k] + (light.zenith[k] - light.haze[k]) * t
        rgb[k] = clear + (CLOUD - clear) * cover


@kernel
def interpolate(values: Floats, corners: Ids, b: Floats, out: Floats) -> None:
    """Fill `out` with the values of a triangle's corners, weighted by barycentric coordinates."""
    for k in range(values.shape[1]):
        out[k] = b[0] * values[corners[0], k] + b[1] * values[corners[1], k] + b[2] * values[corners[2], k]


@kernel
def footprint(uv: Floats, corners: Ids, e: Floats, total: float, place: Floats) -> float:
    """Return the side of a square as large as a sample at (u, v) on its triangle, metres."""
    slopes = np.empty((2, 2))
    for axis in range(2):
        bend = e[0, axis] + e[1, axis] + e[2, axis]
        for k in range(2):
            along = e[0, axis] * uv[corners[0], k] + e[1, axis] * uv[corners[1], k]
            slopes[axis, k] = (along + e[2, axis] * uv[corners[2], k] - place[k] * bend) / total
    return float(np.sqrt(abs(slopes[0, 0] * slopes[1, 1] - slopes[0, 1] * slopes[1, 0])))


@kernel
def shade(
    surface: Mesh,
    materials: Materials,
    light: Light,
    projected: Floats,
    rays: Floats,
    ids: Ids,
    inverse_depth: Singles,
    colour: Singles,
) -> None:
    """Write the linear radiance of every sample into `colour` (H, W, 3): Lambertian, sun, sky, haze."""
    height, width = ids.shape
    e, b, place = np.empty((3, 3)), np.empty(3), np.empty(3)
    rgb, n, point = np.empty(3), np.empty(3), np.empty(3)
    last = -1
    for row in range(height):
        for column in range(width):
            t = ids[row, column]
            if t < 0:
                sky(light, rays, column, row, rgb)
                for k in range(3):
                    colour[row, column, k] = rgb[k]
                continue
            corners = surface.triangles[t]
            if t != last:
                edge_functions(projected[corners[0]], projected[corners[1]], projected[corners[2]], e)
                last = t
            for i in range(3):
                b[i] = e[i, 0] * column + e[i, 1] * row + e[i, 2]
            total = b[0] + b[1] + b[2]
            b /= total
            interpolate(surface.uv, corners, b, place)
            place[2] = footprint(surface.uv, corners, e, total, place)
            texture(materials, surface.materials[t], place, surface.tints[t], rgb)
            interpolate(surface.normals, corners, b, n)
            interpolate(surface.points, corners, b, point)
            length = max(np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), 1e-9)
            for k in range(3):
                n[k] /= length
                point[k] += LIFT_M * n[k]
            sun = n[0] * light.to_sun[0] + n[1] * light.to_sun[1] + n[2] * light.to_sun[2]
            sun = sun * sunlit(light, point[0], point[1], point[2]) if sun > 0.0 else 0.0
            clear = np.exp(-HAZE_PER_M / inverse_depth[row, column])
            for k in range(3):
                sky_light = light.ground[k] + (light.sky[k] - light.ground[k]) * (0.5 + 0.5 * n[2])
                value = rgb[k] * (light.sun[k] * sun + sky_light)
                colour[row, column, k] = value * clear + light.haze[k] * (1.0 - clear)
