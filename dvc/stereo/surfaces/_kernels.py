"""Compiled loops over the disparity maps of several cameras; validated and described by their callers.

Labels are whole numbers; `shifts`: (labels, 2) columns and rows from a pixel of the own view to the same
point in another.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel


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
