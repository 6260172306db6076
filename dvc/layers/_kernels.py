"""Compiled loops of surfaces, layers and sprites."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

REFUTED, HIDDEN, CONFIRMED = 0, 1, 2


JUST_BELOW = 0.999
"""Factor on limits that rounding may miss."""
NOBODY = -1
"""In place of a camera."""


class Placing(NamedTuple):
    """How points of a camera fall into the cells of a canvas."""

    m: float  # position of the camera
    n: float
    corner: tuple[int, int]  # column and row of the canvas's first cell
    shape: tuple[int, int]  # rows and columns of the canvas
    jump: float  # disparities of neighbours that differ by more are of two surfaces
    camera: int


class Cells(NamedTuple):
    """Points of the cells of a canvas, one cell after the other."""

    next_free: NDArray[np.int64]  # of each cell; where its points begin
    points: NDArray[np.float32]  # disparities; none: points are only counted
    cameras: NDArray[np.int16]


class Levels(NamedTuple):
    """Disparities that are told apart."""

    lowest: float
    step: float
    reach: int  # steps within which points are of one surface


class Pictures(NamedTuple):
    """Cameras and what they see."""

    positions: NDArray[np.float64]
    images: NDArray[np.uint8]


class Strip(NamedTuple):
    """Rows of a canvas, and where the reference view is in them."""

    corner: tuple[int, int]  # column and row of the first cell in the reference view
    shape: tuple[int, int]
    frame: tuple[int, int, int, int]  # left, top, right and bottom of the reference view
    reference: int  # its camera


class CellState(NamedTuple):
    """Work space of `peel` for the points of a cell."""

    seen: NDArray[np.bool_]  # cameras that have been met
    alive: NDArray[np.bool_]  # points that may still be values
    chosen: NDArray[np.bool_]  # points of the last value


class Transitions(NamedTuple):
    """How likely neighbours are of one sprite (2.22)."""

    smooth: float  # differences of disparity up to this, and up to the next, are told apart
    jump: float
    rho: tuple[float, float]


@kernel
def judge(disparity, other, dm, dn, tolerance, verdict):
    """Raise verdicts on a surface to what another camera, (dm, dn) away, says about it."""
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            d = disparity[y, x]
            u, v = x - dm * d, y - dn * d
            left, top = int(np.floor(u + 1e-6)), int(np.floor(v + 1e-6))
            right, bottom = int(np.ceil(u - 1e-6)), int(np.ceil(v - 1e-6))
            found = HIDDEN if right < 0 or left >= width or bottom < 0 or top >= height else REFUTED
            for row in range(max(top, 0), min(bottom, height - 1) + 1):
                for column in range(max(left, 0), min(right, width - 1) + 1):
                    difference = other[row, column] - d
                    if abs(difference) <= tolerance:
                        found = CONFIRMED
                    elif difference > 0.0 and found == REFUTED:
                        found = HIDDEN
            verdict[y, x] = max(verdict[y, x], found)


@kernel
def splat(disparity, votes, placing, cells):
    """Enter the voting pixels of a surface at `next_free` of the cells of a canvas that they fall into."""
    m, n, corner, shape, jump, camera = placing
    height, width = disparity.shape
    x4, y4, d4 = np.empty(4), np.empty(4), np.empty(4)
    for y in range(height):
        for x in range(width):
            if not votes[y, x]:
                continue
            d = disparity[y, x]
            column = int(np.floor(x + m * d - corner[0] + 0.5))
            row = int(np.floor(y + n * d - corner[1] + 0.5))
            _enter(row, column, d, shape, camera, cells)
            if y + 1 == height or x + 1 == width:
                continue
            low, high, whole = np.inf, -np.inf, True
            for k in range(4):
                v, u = y + k // 2, x + k % 2
                d4[k] = disparity[v, u]
                x4[k], y4[k] = u + m * d4[k] - corner[0], v + n * d4[k] - corner[1]
                low, high, whole = min(low, d4[k]), max(high, d4[k]), whole and votes[v, u]
            if whole and 0.0 < high - low <= jump:
                _fill(x4, y4, d4, shape, camera, cells)


@kernel
def _enter(row, column, d, shape, camera, cells):
    next_free, points, cameras = cells
    if 0 <= row < shape[0] and 0 <= column < shape[1]:
        cell = row * shape[1] + column
        if points.size:
            points[next_free[cell]] = d
            cameras[next_free[cell]] = camera
        next_free[cell] += 1


@kernel
def _fill(x4, y4, d4, shape, camera, cells):
    """Enter cells inside four neighbours that none of them falls into."""
    for row in range(int(np.ceil(y4.min() - 1e-6)), int(np.floor(y4.max() + 1e-6)) + 1):
        for column in range(int(np.ceil(x4.min() - 1e-6)), int(np.floor(x4.max() + 1e-6)) + 1):
            taken = False
            for k in range(4):
                taken = taken or (np.floor(x4[k] + 0.5) == column and np.floor(y4[k] + 0.5) == row)
            if not taken:
                d = _inside(x4, y4, d4, 0, 1, 2, column, row)
                d = _inside(x4, y4, d4, 3, 2, 1, column, row) if np.isnan(d) else d
                if not np.isnan(d):
                    _enter(row, column, d, shape, camera, cells)


@kernel
def _inside(x4, y4, d4, a, b, c, x, y):
    """Return the disparity at a point of a triangle; NaN outside, or where it is seen from behind."""
    ux, uy, vx, vy = x4[b] - x4[a], y4[b] - y4[a], x4[c] - x4[a], y4[c] - y4[a]
    area = ux * vy - uy * vx
    if area <= 1e-9:
        return np.nan
    s = ((x - x4[a]) * vy - (y - y4[a]) * vx) / area
    t = ((y - y4[a]) * ux - (x - x4[a]) * uy) / area
    if s < -1e-6 or t < -1e-6 or s + t > 1.0 + 1e-6:
        return np.nan
    return d4[a] + s * (d4[b] - d4[a]) + t * (d4[c] - d4[a])


@kernel
def sort_points(starts, points, cameras):
    """Sort the points of each cell from near to far, those of equal disparity by camera."""
    for cell in range(starts.size - 1):
        for i in range(starts[cell] + 1, starts[cell + 1]):
            d, camera, j = points[i], cameras[i], i - 1
            while j >= starts[cell] and (points[j] < d or (points[j] == d and cameras[j] > camera)):
                points[j + 1], cameras[j + 1] = points[j], cameras[j]
                j -= 1
            points[j + 1], cameras[j + 1] = d, camera


@kernel
def peel(points, cameras, levels, how, baselines, owner, state):
    """Choose the next value of a cell by (2.21), and remove from `alive` what cannot be another one."""
    seen, alive, chosen = state
    _, step, reach = how
    seen[:] = False
    best, most, best_sum = 0, 0, 0.0
    level, run, total = 0, 0, 0.0
    for i in range(points.size):
        chosen[i] = alive[i] and not seen[cameras[i]]
        if not chosen[i]:
            continue
        seen[cameras[i]] = True
        if run == 0 or levels[i] != level:
            level, run, total = levels[i], 0, 0.0
        run, total = run + 1, total + points[i]
        if run > most or (run == most and level == best):
            best, most, best_sum = level, run, total
    votes, value = 0, best_sum / max(most, 1)
    for i in range(points.size):
        near = alive[i] and abs(levels[i] - best) <= reach
        behind = value - points[i]
        hidden = behind > JUST_BELOW * step and behind * baselines[cameras[i]] > JUST_BELOW and not chosen[i]
        chosen[i] = chosen[i] and near
        votes += chosen[i]
        alive[i] = alive[i] and cameras[i] != owner and (not near or hidden)
        alive[i] = alive[i] and (owner < 0 or levels[i] <= best)
    return value, votes


@kernel
def vote(cells, how, pictures, strip, layers):
    """Peel the values of every cell, (2.21): disparity and votes, and the median colour of who votes."""
    starts, points, cameras = cells
    positions, images = pictures
    disparity, votes, colour = layers
    longest = 1
    for cell in range(starts.size - 1):
        longest = max(longest, starts[cell + 1] - starts[cell])
    levels, samples = np.empty(longest, np.int64), np.empty((positions.shape[0], 3))
    alive, chosen = np.empty(longest, np.bool_), np.empty(longest, np.bool_)
    state = CellState(np.empty(positions.shape[0], np.bool_), alive, chosen)
    left, top, right, bottom = strip.frame
    baselines = np.maximum(np.abs(positions[:, 0]), np.abs(positions[:, 1]))
    for cell in range(starts.size - 1):
        start, count = starts[cell], starts[cell + 1] - starts[cell]
        row, column = cell // strip.shape[1], cell % strip.shape[1]
        in_frame = top <= row < bottom and left <= column < right
        d, c = points[start : start + count], cameras[start : start + count]
        for i in range(count):
            levels[i], alive[i] = int(np.floor((d[i] - how.lowest) / how.step + 0.5)), True
        for layer in range(disparity.shape[0]):
            owner = strip.reference if in_frame and layer == 0 else NOBODY
            value, number = peel(d, c, levels, how, baselines, owner, state)
            if number == 0:
                break
            place = layer
            while place > 0 and disparity[place - 1, row, column] < value:
                disparity[place, row, column] = disparity[place - 1, row, column]
                votes[place, row, column] = votes[place - 1, row, column]
                colour[place, row, column] = colour[place - 1, row, column]
                place -= 1
            disparity[place, row, column], votes[place, row, column] = value, min(number, 255)
            number = 0
            for i in range(count):
                if chosen[i]:
                    x = column + strip.corner[0] - positions[c[i], 0] * d[i]
                    y = row + strip.corner[1] - positions[c[i], 1] * d[i]
                    _sample(images[c[i]], x, y, samples[number])
                    number += 1
            for channel in range(3):
                median = np.median(samples[:number, channel])
                colour[place, row, column, channel] = int(np.floor(median + 0.5))


@kernel
def _sample(image, x, y, sample):
    """Interpolate a picture linearly, continued beyond its border."""
    height, width = image.shape[:2]
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
    s, t = x - left, y - top
    for channel in range(3):
        above = (1.0 - s) * image[top, left, channel] + s * image[top, right, channel]
        below = (1.0 - s) * image[bottom, left, channel] + s * image[bottom, right, channel]
        sample[channel] = (1.0 - t) * above + t * below


@kernel
def reach(depth, alpha, mask, jump, order, entered):
    """List the pixels that can be reached from those of a mask without a discontinuity, the mask's first."""
    height, width = depth.shape
    count = 0
    for y in range(height):
        for x in range(width):
            if mask[y, x]:
                order[count] = y * width + x
                entered[y, x] = True
                count += 1
    done = 0
    while done < count:
        y, x = order[done] // width, order[done] % width
        done += 1
        for side in range(4):
            v, u = _beside(y, x, side)
            if not (0 <= v < height and 0 <= u < width) or entered[v, u] or not alpha[v, u]:
                continue
            if abs(depth[v, u] - depth[y, x]) <= jump:
                entered[v, u] = True
                order[count] = v * width + u
                count += 1
    return count


@kernel
def _beside(y, x, side):
    """Return the neighbour to the right, below, to the left or above; (s + 2) % 4 is opposite to side s."""
    if side == 0:
        return y, x + 1
    if side == 1:
        return y + 1, x
    if side == 2:
        return y, x - 1
    return y - 1, x


@kernel
def likelihood(depth, mask, entered, order, transitions, max_sweeps, tolerance, messages):
    """Pass messages of the transitions of (2.22) forth and back along `order`, and return the likelihoods."""
    height, width = depth.shape
    first = 0
    while first < order.size and mask[order[first] // width, order[first] % width]:
        _send(order[first], depth, mask, entered, transitions, messages)
        first += 1
    for sweep in range(max_sweeps):
        change = 0.0
        for k in range(first, order.size):
            pixel = order[k] if sweep % 2 == 0 else order[order.size - 1 - (k - first)]
            change = max(change, _send(pixel, depth, mask, entered, transitions, messages))
        if change < tolerance:
            break
    result = np.zeros((height, width))
    for pixel in order:
        y, x = pixel // width, pixel % width
        result[y, x] = 1.0 if mask[y, x] else _belief(messages[y, x], -1)
    return result


@kernel
def _send(pixel, depth, mask, entered, transitions, messages):
    """Send the messages of a pixel, and return by how much they have changed at most."""
    smooth, jump, rho = transitions
    height, width = depth.shape
    y, x = pixel // width, pixel % width
    change = 0.0
    for side in range(4):
        v, u = _beside(y, x, side)
        if not (0 <= v < height and 0 <= u < width) or not entered[v, u] or mask[v, u]:
            continue
        p = 1.0 if mask[y, x] else _belief(messages[y, x], side)
        difference = abs(depth[v, u] - depth[y, x])
        if difference <= smooth:
            sent = (1.0 - 2.0 * rho[0]) * p + rho[0]
        elif difference <= jump:
            sent = (1.0 - 2.0 * rho[1]) * p + rho[1]
        else:
            sent = min(1.0 - p, 0.5)
        heard = (side + 2) % 4
        change = max(change, abs(sent - messages[v, u, heard]))
        messages[v, u, heard] = sent
    return change


@kernel
def _belief(messages, but):
    """Return the likelihood that independent messages give together, all but one of them."""
    yes, no = 1.0, 1.0
    for side in range(4):
        if side != but:
            yes, no = yes * messages[side], no * (1.0 - messages[side])
    return yes / (yes + no) if yes + no > 0.0 else 0.5
