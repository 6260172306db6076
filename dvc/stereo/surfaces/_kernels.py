"""Compiled loops over the disparity maps of several cameras; validated and described by their callers.

Labels are whole numbers; `shifts`: (labels, 2) columns and rows from a pixel of the own view to the same
point in another.
"""

import numpy as np

from dvc._jit import kernel


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
def clear_invisible(own, own_supported, other, other_supported, shifts, origin, slack, top, weight):
    """Take the weight from voxels that the own camera sees, and that are hidden in the other (2.17, 2.19)."""
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
