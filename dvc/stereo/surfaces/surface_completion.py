"""Completion of surfaces: continuation, planes between labels, fusion of all cameras, and confidence."""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.geometry.continuation import CONSISTENT, OCCLUDED, DepthMap, Slopes, continue_surfaces
from dvc.stereo.surfaces.occupancy import Labels, Occupancy, fineness, neighbours, seen_elsewhere, shifts
from dvc.stereo.surfaces.stereo_settings import tolerance

Measure = NDArray[np.floating]

SLOPE_RADIUS_PX, SLOPE_SPACING_PX = 34, 2
"""Radius in which slopes are measured, wide since labels are whole numbers, and spacing of its points."""
SLOPE_LIMIT = 3.0
"""Largest difference of parallax in this radius on one surface, in pixels."""
REACH_PX = 80.0
SLACK_PX = 1.5
"""Largest distance between two depths of one surface, in the test whether a camera looks through a point."""
PLANE_RADIUS_PX, PLANE_SPACING_PX = 14, 2
"""Window of the planes that give disparities between labels, and spacing of its pixels, a divisor."""
PLANE_TOLERANCE_PX, MAX_CHANGE_PX = 2.25, 0.75
"""Largest difference of parallax at the border of the window (a third at its centre), and of a pixel."""
PLANE_LEVELS, CONTINUED_WEIGHT, STIFFNESS_PX2 = 40.0, 0.2, 0.5
"""Sum of colour differences that divides the weight of a pixel by e, weight of a pixel without support, and
variance that is added to that of the pixels, so that noise makes no slopes; all chosen on
`TUNING_PAIRS` of `benchmarks.searches.surfaces`."""

FUSION_ROUNDS = 2
"""Number of rounds of fusion; the second one sees the corrections of the first one."""
TEXTURE_PX, SUPPORT_PX = 15, 31
"""Sides of the windows for texture and for support by other cameras."""
JUMP_PX, JUMP_REACH_PX = 2.0, 15.0
"""Smallest jump of parallax between neighbours, and the distance at which its influence falls to 1/e."""


def continued(
    occupancy: Occupancy,
    other: Occupancy,
    labels: DisparityLabels,
    positions: tuple[LatticePosition, LatticePosition],
    image: Bytes,
    fineness: float,
) -> Floats:
    """Continue the supported surfaces of a camera over the rest of its view."""
    warps = _warp(labels, *positions), _warp(labels, *positions[::-1])
    slopes = Slopes(SLOPE_RADIUS_PX, SLOPE_LIMIT * fineness, REACH_PX, SLOPE_SPACING_PX)
    red, green, blue = np.moveaxis(image.astype(np.float64), 2, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    mine, theirs = (
        DepthMap(
            label.astype(np.float64),
            np.where(supported, CONSISTENT, OCCLUDED).astype(np.int8),
        )
        for label, supported in (occupancy, other)
    )
    filled = continue_surfaces(mine, luma, theirs, warps, slopes, SLACK_PX)
    return np.clip(filled, 0.0, labels.num_labels - 1.0)


def _warp(labels: DisparityLabels, source: LatticePosition, target: LatticePosition) -> Floats:
    """Return the warp between two views for labels as inverse depth (2.5)."""
    dm, dn = source.m - target.m, source.n - target.n
    moved, low = labels.step, labels.lowest
    return np.array(
        [[1.0, 0.0, dm * low, dm * moved], [0.0, 1.0, dn * low, dn * moved], [0.0, 0.0, 1.0, 0.0]]
    )


def fitted_planes(label: Floats, supported: Mask, image: Bytes, fineness: float) -> Floats:
    """Replace labels by the planes through neighbours of like label and colour."""
    refined = np.empty(label.shape)
    _fit_planes(label, supported, image, PLANE_TOLERANCE_PX * fineness, MAX_CHANGE_PX * fineness, refined)
    return refined


@kernel
def _fit_planes(label, supported, image, tolerance, max_change, refined):
    """Fit a plane to the neighbours of like label and colour of every pixel."""
    radius, spacing = PLANE_RADIUS_PX, PLANE_SPACING_PX
    height, width = label.shape
    by_level = np.exp(-np.arange(3 * 256) / PLANE_LEVELS)
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
                    weight = by_level[difference] * (1.0 if supported[i, j] else CONTINUED_WEIGHT)
                    s += weight
                    sx += weight * dx
                    sy += weight * dy
                    sr += weight * rise
                    xx += weight * dx * dx
                    xy += weight * dx * dy
                    yy += weight * dy * dy
                    xr += weight * dx * rise
                    yr += weight * dy * rise
            xx, yy = xx - sx * sx / s + STIFFNESS_PX2 * s, yy - sy * sy / s + STIFFNESS_PX2 * s
            xy, xr, yr = xy - sx * sy / s, xr - sx * sr / s, yr - sy * sr / s
            determinant = xx * yy - xy * xy
            slope_x, slope_y = (xr * yy - yr * xy) / determinant, (yr * xx - xr * xy) / determinant
            change = (sr - slope_x * sx - slope_y * sy) / s
            refined[y, x] = label[y, x] + min(max(change, -max_change), max_change)


def fused(array: CameraArray, labels: DisparityLabels, maps: Sequence[Floats], index: int) -> Floats:
    """Fuse the surface of a camera with those of all other cameras that see its points."""
    here = array[index].position
    moved = np.stack([shifts(labels, here, view.position) for view in array])
    seen = np.stack([view.seen for view in array])
    result = np.empty(array.shape)
    _fuse(index, np.stack(maps), seen, moved, tolerance(fineness(array, labels)), result)
    return result


@kernel
def _fuse(index, maps, seen, shifts, tolerance, result):
    """Replace labels by the median of agreeing cameras, or by lower ones if most cameras look through."""
    num, height, width = maps.shape
    values = np.empty(num)
    for y in range(height):
        for x in range(width):
            mine = maps[index, y, x]
            label = np.int64(np.floor(mine + 0.5))
            values[0], count, num_beyond = mine, np.int64(1), 0
            for k in range(num):
                u, v = x + shifts[k, label, 0], y + shifts[k, label, 1]
                if k == index or not (0 <= u < width and 0 <= v < height) or not seen[k, v, u]:
                    continue
                if abs(maps[k, v, u] - mine) <= tolerance:
                    values[count] = maps[k, v, u]
                    count += 1
                elif maps[k, v, u] < mine:
                    num_beyond += 1
            if num_beyond > count:
                lower = _most_confirmed(index, x, y, maps, seen, shifts, label - tolerance - 1, count)
                result[y, x] = mine if lower < 0 else lower
            else:
                agreeing = np.sort(values[:count])
                result[y, x] = min(max(mine, agreeing[(count - 1) // 2]), agreeing[count // 2])


@kernel
def _most_confirmed(index, x, y, maps, seen, shifts, highest, count):
    """Return the label up to `highest` shared by most other cameras, more than `count`; -1 for none."""
    num, height, width = maps.shape
    best = -1
    for label in range(highest, -1, -1):
        shared = 0
        for k in range(num):
            u, v = x + shifts[k, label, 0], y + shifts[k, label, 1]
            if k != index and 0 <= u < width and 0 <= v < height and seen[k, v, u]:
                shared += abs(maps[k, v, u] - label) <= 1.0
        if shared > count:
            best, count = label, shared
    return best


class Evidence(NamedTuple):
    """Evidence for a surface: measures of each pixel, (H, W), float32, or weights of the measures."""

    constant: Measure | float  # 1 everywhere
    texture: Measure | float  # log(1 + mean slope of the luma along the parallax, in levels)
    near_jump: Measure | float  # 1 at a jump of the surface, falling to 0 away from it
    agreement: Measure | float  # 1 if another camera has the same label
    support: Measure | float  # share of the pixels around with agreement


WEIGHTS = Evidence(0.1, 0.8, -3.2, 0.6, 3.2)
"""Weights of the log-odds: by `benchmarks.searches.confidence` on its `TUNING_PAIRS`, rounded."""


def confidence(measures: Evidence) -> Singles:
    """Return the probability that each disparity is right within a pixel."""
    log_odds = sum(weight * measure for weight, measure in zip(WEIGHTS, measures, strict=True))
    return (1.0 / (1.0 + np.exp(-log_odds))).astype(np.float32)


def evidence(array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int) -> Evidence:
    """Measure the evidence for a camera's surface from the labels of all cameras."""
    fine, near, view = fineness(array, labels), neighbours(array, index), array[index]
    luma = view.image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    # the larger texture of the directions with other cameras
    ways = [way for way, cameras in (((1, 0), near.horizontal), ((0, 1), near.vertical)) if cameras]
    slopes = [cv2.blur(np.abs(cv2.Sobel(luma, cv2.CV_32F, *way)) / 8.0, (TEXTURE_PX,) * 2) for way in ways]
    same = seen_elsewhere(array, labels, maps, index, int(0.5 * fine)).astype(np.float32)
    parallax_px, around = (maps[index] / fine).astype(np.float32), np.ones((3, 3), np.uint8)
    is_even = cv2.dilate(parallax_px, around) - cv2.erode(parallax_px, around) <= JUMP_PX
    from_jumps = np.full(view.shape, np.inf, np.float32)
    if not is_even.all():
        from_jumps = np.asarray(cv2.distanceTransform(is_even.astype(np.uint8), cv2.DIST_L2, 5))
    return Evidence(
        np.ones(view.shape, np.float32),
        np.asarray(np.log1p(np.max(slopes, axis=0))),
        np.exp(-from_jumps / JUMP_REACH_PX),
        same,
        np.asarray(cv2.blur(same, (SUPPORT_PX, SUPPORT_PX)), np.float32),
    )
