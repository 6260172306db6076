"""Continuation of reliable surfaces over the rest of a view: of planes, across as few edges as possible."""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Floats, Mask
from dvc.geometry.warping import warp_point

CONSISTENT, OUTSIDE, OCCLUDED = range(3)
"""Visibility of points in another view: both depth maps agree; outside its frame; hidden, or wrong."""
EDGE_LEVELS = 15.0
"""Step in luma that halves the weight of surfaces behind it: well above the noise of a decoded frame."""
CONTINUED_QUANTILE = 0.5
"""Quantile of the continued inverse depths, 0 for the farthest: wrong ones come from either side."""


class Slopes(NamedTuple):
    """Measurement and reach of the slopes of surfaces."""

    radius_px: int  # radius around a point that measures the slope of a surface
    limit: float  # largest difference of inverse depth on a surface in this radius
    reach_px: float  # reach of slopes; farther away their error would be larger than that of constant depth
    spacing_px: int = 1  # spacing of the points that measure slopes; a divisor of the radius


class DepthMap(NamedTuple):
    """Depth of a view."""

    inverse_depth: Floats  # inverse depth of every pixel
    visibility: NDArray[np.int8]  # of every pixel in the other view

    @property
    def reliable(self) -> Mask:
        """Mask (H, W) of pixels with a depth that two views confirm."""
        return np.asarray(self.visibility == CONSISTENT)


class OtherView(NamedTuple):
    """Depth of another view, and the warps there and back."""

    there: Floats
    back: Floats
    depth: Floats
    visibility: NDArray[np.int8]
    slack_px: float  # distance between surfaces that may be one


def continue_surfaces(
    own: DepthMap,
    luma: Floats,
    other: DepthMap,
    warps: tuple[Floats, Floats],
    slopes: Slopes,
    slack_px: float,  # distance between surfaces that may be one,
) -> Floats:
    """Continue the planes of reliable surfaces in eight directions."""
    reliable = own.reliable
    # only the rim of consistent regions is continued
    rim = reliable & (cv2.dilate((~reliable).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    window = slopes.radius_px, slopes.spacing_px, slopes.limit
    measured = _local_slopes(own.inverse_depth, reliable, rim, *window)
    view = OtherView(*warps, *other, slack_px)
    return np.asarray(fill_depth(*own, luma, measured, slopes.reach_px, CONTINUED_QUANTILE, view))


@kernel
def _local_slopes(depth, reliable, chosen, radius, spacing, limit):
    """Fit a plane to the reliable neighbours of like depth around each chosen point; return its slopes."""
    height, width = depth.shape
    slopes = np.zeros((height, width, 2))
    for y in range(height):
        for x in range(width):
            if not chosen[y, x]:
                continue
            xx, xy, yy, xr, yr, rr = 1e-9, 0.0, 1e-9, 0.0, 0.0, 1e-30
            sx, sy, sr, n = 0.0, 0.0, 0.0, 0.0
            for i in range(max(y - radius, y % spacing), min(y + radius + 1, height), spacing):
                for j in range(max(x - radius, x % spacing), min(x + radius + 1, width), spacing):
                    if reliable[i, j] and abs(depth[i, j] - depth[y, x]) <= limit:
                        dx, dy, dr = j - x, i - y, depth[i, j] - depth[y, x]
                        n += 1.0
                        sx += dx
                        sy += dy
                        sr += dr
                        xx += dx * dx
                        xy += dx * dy
                        yy += dy * dy
                        xr += dx * dr
                        yr += dy * dr
                        rr += dr * dr
            xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
            xr, yr = xr - sx * sr / n, yr - sy * sr / n
            determinant = xx * yy - xy * xy
            rr -= sr * sr / n
            if n * spacing * spacing >= 2 * radius * radius and determinant > 0.01 * xx * yy:
                slope_x = (xr * yy - yr * xy) / determinant
                slope_y = (yr * xx - xr * xy) / determinant
                explained = min(max((slope_x * xr + slope_y * yr) / rr, 0.0), 1.0)
                slopes[y, x, 0] = explained * slope_x
                slopes[y, x, 1] = explained * slope_y
    return slopes


@kernel
def fill_depth(depth, visibility, image, slopes, reach, quantile, other):
    """Continue the planes of reliable points in eight directions over the other points."""
    values, weights, filled = np.empty(8), np.empty(8), depth.copy()
    steps = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
    nearest = np.empty((8, *depth.shape), np.int32)
    edges = np.empty((8, *depth.shape))
    for direction in range(8):
        dy, dx = steps[direction]
        _nearest_reliable(visibility, image, dy, dx, nearest[direction], edges[direction])
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            if visibility[y, x] == CONSISTENT:
                continue
            count = np.int64(0)
            for direction in range(8):
                distance = nearest[direction, y, x]
                if distance < 0:
                    continue
                dy, dx = steps[direction]
                i, j = y + distance * dy, x + distance * dx
                length = float(max(abs(i - y), abs(j - x)))
                slope = slopes[i, j, 0] * (x - j) + slopes[i, j, 1] * (y - i)
                values[count] = depth[i, j] + min(1.0, reach / length) * slope
                crossed = edges[direction, y, x] / EDGE_LEVELS
                weights[count] = 1.0 / ((1.0 + crossed * crossed) * (length + 1.0))
                if is_transparent(other, x, y, values[count]):
                    weights[count] *= 0.001
                count += 1
            if count > 0:
                filled[y, x] = _weighted_quantile(values, weights, count, quantile)
    return filled


@kernel
def _nearest_reliable(visibility, image, dy, dx, distance, edge):
    """Count steps to the nearest consistent point in a direction (-1: none); find the highest edge."""
    height, width = visibility.shape
    first_y, end_y, step_y = (height - 1, -1, -1) if dy > 0 else (0, height, 1)
    first_x, end_x, step_x = (width - 1, -1, -1) if dx > 0 else (0, width, 1)
    for y in range(first_y, end_y, step_y):
        for x in range(first_x, end_x, step_x):
            distance[y, x] = -1
            edge[y, x] = 0.0
            i, j = y + dy, x + dx
            if not (0 <= i < height and 0 <= j < width):
                continue
            step = abs(image[i, j] - image[y, x])
            if visibility[i, j] == CONSISTENT:
                distance[y, x] = 1
                edge[y, x] = step
            elif distance[i, j] > 0:
                distance[y, x] = distance[i, j] + 1
                edge[y, x] = max(step, edge[i, j])


@kernel
def is_transparent(other, x, y, rho):
    """Return whether another view looks through a point: it sees a consistent point behind it."""
    there, back, depth, visibility, slack = other
    height, width = depth.shape
    u, v, w = warp_point(there, x, y, rho)
    if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
        return False
    column, row = int(u + 0.5), int(v + 0.5)
    if visibility[row, column] != CONSISTENT or depth[row, column] >= rho / w:
        return False
    a, b, _ = warp_point(back, u, v, depth[row, column])
    return abs(a - x) + abs(b - y) > slack


@kernel
def _weighted_quantile(values, weights, count, quantile):
    """Return the value below which a share of the weight lies; sort both arrays."""
    total = 0.0
    for k in range(count):
        value, weight, m = values[k], weights[k], k
        while m > 0 and values[m - 1] > value:
            values[m], weights[m] = values[m - 1], weights[m - 1]
            m -= 1
        values[m], weights[m] = value, weight
        total += weight
    reached = 0.0
    for k in range(count):
        reached += weights[k]
        if reached >= quantile * total:
            return values[k]
    return values[count - 1]
