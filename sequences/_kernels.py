"""Compiled loops of the renderer: rasterisation, point casting, shading and filtering of samples."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ids = NDArray[np.int32]
Array = NDArray[Any]

NEAR_M = 0.05
LEAF = 1


class Surface(NamedTuple):
    """Triangles and what is interpolated over them; arrays of length N (vertices) or M (triangles)."""

    points: Floats
    normals: Floats
    uv: Floats
    tint: Floats
    ambient: Floats
    triangles: Ids
    materials: Ids


class Textures(NamedTuple):
    """Mip-mapped square textures of one size, square-root coded, and the material table that uses them."""

    texels: NDArray[np.uint8]
    offsets: NDArray[np.int64]
    size: int
    per_metre: Floats
    macro: Floats
    kind: Ids


class Light(NamedTuple):
    """Sun, its shadow map, sky, haze; colours are linear RGB."""

    to_sun: Floats
    sun: Floats
    sky: Floats
    ground: Floats
    haze: Floats
    haze_per_m: float
    shadow_from_world: Floats
    shadow_depth: Singles
    zenith: Floats
    cloud: Floats


@kernel
def transform(matrix: Floats, points: Floats, out: Floats) -> None:
    """Write ``matrix @ (x, y, z, 1)`` of every point into `out` (N, 3); `matrix` is (3, 4)."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in range(3):
            out[i, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z + matrix[k, 3]


@kernel
def edge_functions(p: Floats, q: Floats, r: Floats, e: Floats) -> float:
    """Fill `e` (3, 3) with the edge functions of a homogeneous triangle and return its determinant."""
    e[0, 0] = q[1] * r[2] - q[2] * r[1]
    e[0, 1] = q[2] * r[0] - q[0] * r[2]
    e[0, 2] = q[0] * r[1] - q[1] * r[0]
    e[1, 0] = r[1] * p[2] - r[2] * p[1]
    e[1, 1] = r[2] * p[0] - r[0] * p[2]
    e[1, 2] = r[0] * p[1] - r[1] * p[0]
    e[2, 0] = p[1] * q[2] - p[2] * q[1]
    e[2, 1] = p[2] * q[0] - p[0] * q[2]
    e[2, 2] = p[0] * q[1] - p[1] * q[0]
    det = float(p[0] * e[0, 0] + p[1] * e[0, 1] + p[2] * e[0, 2])
    if det < 0.0:
        det = -det
        for i in range(3):
            for j in range(3):
                e[i, j] = -e[i, j]
    return det


@kernel
def bounds(p: Floats, q: Floats, r: Floats, width: int, height: int) -> tuple[int, int, int, int]:
    """Return first and last column, first and last row that a homogeneous triangle can touch."""
    if p[2] <= NEAR_M and q[2] <= NEAR_M and r[2] <= NEAR_M:
        return 0, -1, 0, -1
    if p[2] <= NEAR_M or q[2] <= NEAR_M or r[2] <= NEAR_M:
        return 0, width - 1, 0, height - 1
    x0, x1, x2 = p[0] / p[2], q[0] / q[2], r[0] / r[2]
    y0, y1, y2 = p[1] / p[2], q[1] / q[2], r[1] / r[2]
    left, right = min(x0, x1, x2), max(x0, x1, x2)
    top, bottom = min(y0, y1, y2), max(y0, y1, y2)
    if right < 0.0 or bottom < 0.0 or left > width - 1 or top > height - 1:
        return 0, -1, 0, -1
    first_column, last_column = int(np.ceil(max(left, 0.0))), int(np.floor(min(right, width - 1.0)))
    first_row, last_row = int(np.ceil(max(top, 0.0))), int(np.floor(min(bottom, height - 1.0)))
    return first_column, last_column, first_row, last_row


@kernel
def narrow(slope: float, offset: float, low: int, high: int) -> tuple[int, int]:
    """Shrink a range of columns to where ``slope * column + offset >= 0``, one to spare at either end."""
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
    """Keep at every sample the nearest triangle; `projected` is (N, 3) homogeneous in sample units."""
    height, width = ids.shape
    e = np.empty((3, 3))
    for t in range(triangles.shape[0]):
        p, q, r = projected[triangles[t, 0]], projected[triangles[t, 1]], projected[triangles[t, 2]]
        first_column, last_column, first_row, last_row = bounds(p, q, r, width, height)
        if first_column > last_column or first_row > last_row:
            continue
        det = edge_functions(p, q, r, e)
        if det == 0.0:
            continue
        scale = 1.0 / det
        for row in range(first_row, last_row + 1):
            k0 = e[0, 1] * row + e[0, 2]
            k1 = e[1, 1] * row + e[1, 2]
            k2 = e[2, 1] * row + e[2, 2]
            low, high = first_column, last_column
            if last_column - first_column > 8:
                low, high = narrow(e[0, 0], k0, low, high)
                low, high = narrow(e[1, 0], k1, low, high)
                low, high = narrow(e[2, 0], k2, low, high)
            for column in range(low, high + 1):
                e0 = e[0, 0] * column + k0
                e1 = e[1, 0] * column + k1
                e2 = e[2, 0] * column + k2
                if e0 >= 0.0 and e1 >= 0.0 and e2 >= 0.0:
                    inverse = np.float32((e0 + e1 + e2) * scale)
                    if inverse > inverse_depth[row, column] and inverse < 1.0 / NEAR_M:
                        inverse_depth[row, column] = inverse
                        ids[row, column] = t


@kernel
def cast_points(
    projected: Floats,
    triangles: Ids,
    xy: Floats,
    cell_start: Array,
    cell_points: Array,
    depth: Floats,
    ids: Ids,
) -> None:
    """Find the nearest triangle behind every image point (P, 2), wherever it lies between samples."""
    height, width = cell_start.shape[0], cell_start.shape[1] - 1
    e = np.empty((3, 3))
    shift = np.array([0.5, 0.5])
    for t in range(triangles.shape[0]):
        p, q, r = projected[triangles[t, 0]], projected[triangles[t, 1]], projected[triangles[t, 2]]
        columns = _cells(p, q, r, 0, shift[0], width)
        rows = _cells(p, q, r, 1, shift[1], height)
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
def _cells(p: Floats, q: Floats, r: Floats, axis: int, shift: float, size: int) -> tuple[int, int]:
    """Return the first and last cell along one axis that a homogeneous triangle can touch."""
    if p[2] <= NEAR_M and q[2] <= NEAR_M and r[2] <= NEAR_M:
        return 0, -1
    if p[2] <= NEAR_M or q[2] <= NEAR_M or r[2] <= NEAR_M:
        return 0, size - 1
    a, b, c = p[axis] / p[2], q[axis] / q[2], r[axis] / r[2]
    low, high = min(a, b, c) + shift, max(a, b, c) + shift
    if high < 0.0 or low >= size:
        return 0, -1
    return int(max(low, 0.0)), int(min(high, size - 1.0))


@kernel
def add_visibility(
    projected: Floats, inverse_depth: Singles, weight: Floats, bias_m: float, seen: Floats, total: Floats
) -> None:
    """Add to each vertex the light of one direction, unless its depth map shows something nearer."""
    height, width = inverse_depth.shape
    for i in range(projected.shape[0]):
        if weight[i] <= 0.0:
            continue
        total[i] += weight[i]
        z = projected[i, 2]
        column, row = int(np.floor(projected[i, 0] / z + 0.5)), int(np.floor(projected[i, 1] / z + 0.5))
        outside = column < 0 or row < 0 or column >= width or row >= height
        if outside or inverse_depth[row, column] * (z - bias_m) <= 1.0:
            seen[i] += weight[i]


@kernel
def bilinear(textures: Textures, texture: int, level: int, u: float, v: float, out: Floats) -> None:
    """Fill `out` (3,) with the linear colour of one mip level at periodic coordinates in tiles."""
    size = textures.size >> level
    x, y = u * size - 0.5, v * size - 0.5
    fx, fy = np.floor(x), np.floor(y)
    ax, ay = x - fx, y - fy
    x0, y0 = int(fx) & (size - 1), int(fy) & (size - 1)
    x1, y1 = (x0 + 1) & (size - 1), (y0 + 1) & (size - 1)
    base = textures.offsets[texture, level]
    a, b = base + (y0 * size + x0) * 3, base + (y0 * size + x1) * 3
    c, d = base + (y1 * size + x0) * 3, base + (y1 * size + x1) * 3
    t = textures.texels
    for k in range(3):
        ta, tb, tc, td = float(t[a + k]), float(t[b + k]), float(t[c + k]), float(t[d + k])
        top = (1.0 - ax) * ta * ta + ax * tb * tb
        bottom = (1.0 - ax) * tc * tc + ax * td * td
        out[k] = ((1.0 - ay) * top + ay * bottom) * (1.0 / 65025.0)


@kernel
def filtered(
    textures: Textures, texture: int, u: float, v: float, footprint: Floats, out: Floats, work: Floats
) -> None:
    """Fill `out` with the texture averaged over a sample's footprint: up to 6 trilinear taps along it."""
    ux, vx, uy, vy = footprint[0], footprint[1], footprint[2], footprint[3]
    long2, short2 = ux * ux + vx * vx, uy * uy + vy * vy
    if long2 < short2:
        long2, short2 = short2, long2
        ux, vx = uy, vy
    long, short = np.sqrt(long2) * textures.size, np.sqrt(short2) * textures.size
    taps = int(min(6.0, np.ceil(long / max(short, 1.0))))
    taps = max(taps, 1)
    fineness = np.log2(max(short, long / taps, 1.0))
    last = textures.offsets.shape[1] - 1
    level = int(fineness)
    mix = fineness - level
    if level >= last:
        level, mix = last, 0.0
    out[:] = 0.0
    for tap in range(taps):
        step = (tap + 0.5) / taps - 0.5
        bilinear(textures, texture, level, u + step * ux, v + step * vx, work)
        for k in range(3):
            out[k] += (1.0 - mix) * work[k] / taps
        if mix > 0.0:
            bilinear(textures, texture, level + 1, u + step * ux, v + step * vx, work)
            for k in range(3):
                out[k] += mix * work[k] / taps


@kernel
def sunlit(light: Light, x: float, y: float, z: float) -> float:
    """Return the fraction of the sun's disc seen from a world point: 3x3 bilinear comparisons in its map."""
    m = light.shadow_from_world
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    column = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / w
    row = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / w
    height, width = light.shadow_depth.shape
    c, r = int(np.floor(column)), int(np.floor(row))
    if c < 1 or r < 1 or c >= width - 2 or r >= height - 2:
        return 1.0
    ac, ar = column - c, row - r
    limit = np.float32(w - 0.03)
    total = 0.0
    for i in range(-1, 3):
        weight_r = 1.0 - ar if i == -1 else (ar if i == 2 else 1.0)
        for j in range(-1, 3):
            weight_c = 1.0 - ac if j == -1 else (ac if j == 2 else 1.0)
            if light.shadow_depth[r + i, c + j] >= limit:
                total += weight_r * weight_c
    return total / 9.0


@kernel
def sky_colour(light: Light, textures: Textures, direction: Floats, out: Floats, work: Floats) -> None:
    """Fill `out` with the sky in a unit direction: gradient from haze to zenith, and a layer of clouds."""
    up = max(direction[2], 0.0)
    t = 1.0 - np.exp(-3.2 * up)
    for k in range(3):
        out[k] = light.haze[k] + (light.zenith[k] - light.haze[k]) * t
    if direction[2] > 0.02:
        scale = 0.16 / (direction[2] + 0.12)
        level = min(5, int(max(0.0, np.log2(0.06 / (direction[2] + 0.02)) + 1.0)))
        bilinear(textures, 1, level, direction[0] * scale + 0.37, direction[1] * scale + 0.11, work)
        cover = work[0] * min(1.0, up * 9.0)
        for k in range(3):
            out[k] += (light.cloud[k] * (0.45 + 0.55 * work[1]) - out[k]) * cover


@kernel
def sample_texture(
    surface: Surface,
    textures: Textures,
    t: int,
    e: Floats,
    b: Floats,
    total: float,
    rgb: Floats,
    work: Floats,
) -> None:
    """Fill `rgb` with the filtered texture of triangle `t` at barycentric coordinates `b`, stains included.
    Fill `rgb` with the filtered texture of triangle `t` at barycentric coordinates `b`, stains included.
    """
    footprint = np.empty(4)
    i0, i1, i2 = surface.triangles[t, 0], surface.triangles[t, 1], surface.triangles[t, 2]
    material = surface.materials[t]
    per_metre = textures.per_metre[material]
    u = b[0] * surface.uv[i0, 0] + b[1] * surface.uv[i1, 0] + b[2] * surface.uv[i2, 0]
    v = b[0] * surface.uv[i0, 1] + b[1] * surface.uv[i1, 1] + b[2] * surface.uv[i2, 1]
    for axis in range(2):
        s = e[0, axis] + e[1, axis] + e[2, axis]
        du = e[0, axis] * surface.uv[i0, 0] + e[1, axis] * surface.uv[i1, 0] + e[2, axis] * surface.uv[i2, 0]
        dv = e[0, axis] * surface.uv[i0, 1] + e[1, axis] * surface.uv[i1, 1] + e[2, axis] * surface.uv[i2, 1]
        footprint[2 * axis] = (du - u * s) / total * per_metre
        footprint[2 * axis + 1] = (dv - v * s) / total * per_metre
    filtered(textures, material, u * per_metre, v * per_metre, footprint, rgb, work)
    if textures.macro[material] > 0.0:
        bilinear(textures, 0, 0, u * 0.137, v * 0.137, work)
        stain = 1.0 + textures.macro[material] * (2.0 * work[0] - 1.0)
        for k in range(3):
            rgb[k] *= stain


@kernel
def sunlight(light: Light, kind: int, point: Floats, n: Floats) -> float:
    """Return the share of the sun's light that a surface of normal `n` takes at a world point."""
    facing = n[0] * light.to_sun[0] + n[1] * light.to_sun[1] + n[2] * light.to_sun[2]
    if kind == LEAF:
        facing = 0.22 + 0.55 * abs(facing)
    if facing <= 0.0:
        return 0.0
    x, y, z = point[0] + 0.03 * n[0], point[1] + 0.03 * n[1], point[2] + 0.03 * n[2]
    return float(facing * sunlit(light, x, y, z))


@kernel
def viewing_ray(world_from_sample: Floats, column: int, row: int, ray: Floats) -> None:
    """Set the direction, of length 1, in which a sample looks."""
    for k in range(3):
        line = world_from_sample[k]
        ray[k] = line[0] * column + line[1] * row + line[2]
    ray /= np.sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2])


@kernel
def shade(
    surface: Surface,
    textures: Textures,
    light: Light,
    projected: Floats,
    world_from_sample: Floats,
    ids: Ids,
    inverse_depth: Singles,
    colour: Singles,
) -> None:
    """Write the linear radiance of every sample into `colour` (H, W, 3): Lambertian, sun, sky, haze."""
    height, width = ids.shape
    e, b = np.empty((3, 3)), np.empty(3)
    rgb, work, n, point = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    last = -1
    for row in range(height):
        for column in range(width):
            t = ids[row, column]
            if t < 0:
                viewing_ray(world_from_sample, column, row, n)
                sky_colour(light, textures, n, rgb, work)
                for k in range(3):
                    colour[row, column, k] = rgb[k]
                continue
            i0, i1, i2 = surface.triangles[t, 0], surface.triangles[t, 1], surface.triangles[t, 2]
            if t != last:
                edge_functions(projected[i0], projected[i1], projected[i2], e)
                last = t
            for i in range(3):
                b[i] = e[i, 0] * column + e[i, 1] * row + e[i, 2]
            total = b[0] + b[1] + b[2]
            b /= total
            sample_texture(surface, textures, t, e, b, total, rgb, work)
            for k in range(3):
                rgb[k] *= b[0] * surface.tint[i0, k] + b[1] * surface.tint[i1, k] + b[2] * surface.tint[i2, k]
                n[k] = (
                    b[0] * surface.normals[i0, k]
                    + b[1] * surface.normals[i1, k]
                    + b[2] * surface.normals[i2, k]
                )
                point[k] = (
                    b[0] * surface.points[i0, k] + b[1] * surface.points[i1, k] + b[2] * surface.points[i2, k]
                )
            n /= max(np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), 1e-9)
            open_sky = b[0] * surface.ambient[i0] + b[1] * surface.ambient[i1] + b[2] * surface.ambient[i2]
            sun = sunlight(light, textures.kind[surface.materials[t]], point, n)
            clear = np.exp(-light.haze_per_m / inverse_depth[row, column])
            for k in range(3):
                sky = light.ground[k] + (light.sky[k] - light.ground[k]) * (0.5 + 0.5 * n[2])
                value = rgb[k] * (light.sun[k] * sun + sky * open_sky + 0.13 * light.ground[k])
                colour[row, column, k] = value * clear + light.haze[k] * (1.0 - clear)


@kernel
def resolve(samples: Singles, taps: Floats, step: int, out: Singles) -> None:
    """Average samples into pixels (H, W, 3), `step` samples apart, with a separable kernel of `taps`."""
    height, width, _ = out.shape
    count = taps.shape[0]
    for row in range(height):
        for column in range(width):
            for k in range(3):
                total = 0.0
                for i in range(count):
                    line = 0.0
                    for j in range(count):
                        line += taps[j] * samples[row * step + i, column * step + j, k]
                    total += taps[i] * line
                out[row, column, k] = total
