"""Compiled loops over the disparity maps of several cameras; validated and described by their callers.

Labels are whole numbers; `shifts`: (labels, 2) columns and rows from a pixel of the own view to the same
point in another.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel


class PlaneWindow(NamedTuple):
    """What planes are fitted to, around each pixel."""

    radius_px: int
    spacing_px: int  # between the pixels that count, a divisor of the radius
    # labels by which the farthest pixel may differ, a third of them beside the centre
    tolerance: float
    levels: float  # sum of differences of colour that divides the weight by e
    continued_weight: float  # of a pixel that no other camera supports
    stiffness_px2: float  # variance that is added to that of the pixels, so that slopes are not of noise
    most: float  # labels by which a pixel changes


class Surface(NamedTuple):
    """Labels of a camera's surface, and where they are supported."""

    labels: NDArray[np.int64]
    supported: NDArray[np.bool_]


@kernel
def agree(own, other, other_seen, shifts, tolerance, agreeing, looking):
    """Tell where another camera's label at the same point is the own one, or near it (2.15), or has any."""
    height, width = own.shape
    for y in range(height):
        for x in range(width):
            k = own[y, x]
            u, v = x + shifts[k, 0], y + shifts[k, 1]
            looking[y, x] = 0 <= u < width and 0 <= v < height and other_seen[v, u]
            agreeing[y, x] = looking[y, x] and abs(other[v, u] - k) <= tolerance


@kernel
def clear_invisible(own_surface, other_surface, shifts, origin, slack, top, weight):
    """Take the weight from voxels that the own camera sees, and that are hidden in the other (2.17, 2.19)."""
    (own, own_supported), (other, other_supported) = own_surface, other_surface
    height, width = own.shape
    for i in range(weight.shape[0]):
        y = top + i
        for x in range(width):
            first = own[y, x] - slack if own_supported[y, x] else 0
            for k in range(weight.shape[2]):
                label = origin[y, x] + k
                if label < max(first, 0) or label >= shifts.shape[0]:
                    continue
                u, v = x + shifts[label, 0], y + shifts[label, 1]
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                if other_supported[v, u] and other[v, u] > label + slack:
                    weight[i, x, k] = 0.0


@kernel
def add_distance(own, supported, origin, strength, limit, cost):
    """Add the truncated distance from the label of supported pixels: lambda_g G of (2.13) and (2.16)."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            if supported[y, x]:
                for k in range(cost.shape[2]):
                    distance = abs(origin[y, x] + k - own[y, x])
                    cost[y, x, k] += strength * np.float32(min(distance, limit))


@kernel
def fit_planes(label, supported, image, window, refined):
    """Replace labels by the plane through neighbours of like label and colour."""
    radius, spacing, tolerance, levels, continued, stiffness, most = window
    height, width = label.shape
    by_level = np.exp(-np.arange(3 * 256) / levels)
    for y in range(height):
        for x in range(width):
            s = sx = sy = sr = xx = xy = yy = xr = yr = 0.0
            for i in range(max(y - radius, (y - radius) % spacing), min(y + radius + 1, height), spacing):
                for j in range(max(x - radius, (x - radius) % spacing), min(x + radius + 1, width), spacing):
                    dx, dy, rise = j - x, i - y, label[i, j] - label[y, x]
                    if abs(rise) > tolerance * (1.0 + 2.0 * max(abs(dx), abs(dy)) / radius) / 3.0:
                        continue
                    difference = 0
                    for channel in range(3):
                        difference += abs(np.int64(image[i, j, channel]) - np.int64(image[y, x, channel]))
                    weight = by_level[difference] * (1.0 if supported[i, j] else continued)
                    s += weight
                    sx += weight * dx
                    sy += weight * dy
                    sr += weight * rise
                    xx += weight * dx * dx
                    xy += weight * dx * dy
                    yy += weight * dy * dy
                    xr += weight * dx * rise
                    yr += weight * dy * rise
            xx, yy = xx - sx * sx / s + stiffness * s, yy - sy * sy / s + stiffness * s
            xy, xr, yr = xy - sx * sy / s, xr - sx * sr / s, yr - sy * sr / s
            determinant = xx * yy - xy * xy
            slope_x, slope_y = (xr * yy - yr * xy) / determinant, (yr * xx - xr * xy) / determinant
            change = (sr - slope_x * sx - slope_y * sy) / s
            refined[y, x] = label[y, x] + min(max(change, -most), most)


@kernel
def fuse(index, maps, seen, shifts, tolerance, fused):
    """Replace labels by the median of cameras that agree, or by another where most cameras look through."""
    num, height, width = maps.shape
    values = np.empty(num)
    for y in range(height):
        for x in range(width):
            own = maps[index, y, x]
            label = np.int64(np.floor(own + 0.5))
            values[0], count, num_beyond = own, 1, 0
            for k in range(num):
                u, v = x + shifts[k, label, 0], y + shifts[k, label, 1]
                if k == index or not (0 <= u < width and 0 <= v < height) or not seen[k, v, u]:
                    continue
                if abs(maps[k, v, u] - own) <= tolerance:
                    values[count] = maps[k, v, u]
                    count += 1
                elif maps[k, v, u] < own:
                    num_beyond += 1
            if num_beyond > count:
                lower = most_confirmed(index, x, y, maps, seen, shifts, label - tolerance - 1, count)
                fused[y, x] = own if lower < 0 else lower
            else:
                agreeing = np.sort(values[:count])
                fused[y, x] = min(max(own, agreeing[(count - 1) // 2]), agreeing[count // 2])


@kernel
def most_confirmed(index, x, y, maps, seen, shifts, highest, count):
    """Find the label that most other cameras have, more than `count` and up to `highest`; -1: none."""
    num, height, width = maps.shape
    best = -1
    for label in range(highest, -1, -1):
        found = 0
        for k in range(num):
            u, v = x + shifts[k, label, 0], y + shifts[k, label, 1]
            if k != index and 0 <= u < width and 0 <= v < height and seen[k, v, u]:
                found += abs(maps[k, v, u] - label) <= 1.0
        if found > count:
            best, count = label, found
    return best
