"""Compiled loops of layered depth images: verdicts on surfaces, points in cells, and votes."""

import numpy as np

from dvc._jit import kernel

REFUTED, HIDDEN, CONFIRMED = 0, 1, 2
"""Verdicts of a camera on a surface."""
JUST_BELOW = 0.999
"""Factor on limits that rounding may miss."""
NO_CAMERA = -1
"""Owner of cells that no camera sees first."""


@kernel
def judge(disparity, other, dm, dn, tolerance, verdict):
    """Raise verdicts on a surface by the verdict of another camera, (dm, dn) away."""
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            d = disparity[y, x]
            u, v = x - dm * d, y - dn * d
            left, top = int(np.floor(u + 1e-6)), int(np.floor(v + 1e-6))
            right, bottom = int(np.ceil(u - 1e-6)), int(np.ceil(v - 1e-6))
            seen = HIDDEN if right < 0 or left >= width or bottom < 0 or top >= height else REFUTED
            for row in range(max(top, 0), min(bottom, height - 1) + 1):
                for column in range(max(left, 0), min(right, width - 1) + 1):
                    difference = other[row, column] - d
                    if abs(difference) <= tolerance:
                        seen = CONFIRMED
                    elif difference > 0.0 and seen == REFUTED:
                        seen = HIDDEN
            verdict[y, x] = max(verdict[y, x], seen)


@kernel
def splat(disparity, votes, m, n, corner, shape, jump, camera, next_free, points, cameras):
    """Enter the voting pixels of a camera at (m, n) into cells of a canvas; count them without `points`."""
    height, width = disparity.shape
    x4, y4, d4 = np.empty(4), np.empty(4), np.empty(4)
    for y in range(height):
        for x in range(width):
            if not votes[y, x]:
                continue
            d = disparity[y, x]
            column = int(np.floor(x + m * d - corner[0] + 0.5))
            row = int(np.floor(y + n * d - corner[1] + 0.5))
            _enter(row, column, d, shape, camera, next_free, points, cameras)
            if y + 1 == height or x + 1 == width:
                continue
            low, high, whole = np.inf, -np.inf, True
            for k in range(4):
                v, u = y + k // 2, x + k % 2
                d4[k] = disparity[v, u]
                x4[k], y4[k] = u + m * d4[k] - corner[0], v + n * d4[k] - corner[1]
                low, high, whole = min(low, d4[k]), max(high, d4[k]), whole and votes[v, u]
            if whole and 0.0 < high - low <= jump:
                _fill(x4, y4, d4, shape, camera, next_free, points, cameras)


@kernel
def _enter(row, column, d, shape, camera, next_free, points, cameras):
    """Enter a point at `next_free` of its cell."""
    if 0 <= row < shape[0] and 0 <= column < shape[1]:
        cell = row * shape[1] + column
        if points.size:
            points[next_free[cell]] = d
            cameras[next_free[cell]] = camera
        next_free[cell] += 1


@kernel
def _fill(x4, y4, d4, shape, camera, next_free, points, cameras):
    """Enter points into the cells between four neighbours."""
    for row in range(int(np.ceil(y4.min() - 1e-6)), int(np.floor(y4.max() + 1e-6)) + 1):
        for column in range(int(np.ceil(x4.min() - 1e-6)), int(np.floor(x4.max() + 1e-6)) + 1):
            taken = False
            for k in range(4):
                taken = taken or (np.floor(x4[k] + 0.5) == column and np.floor(y4[k] + 0.5) == row)
            if not taken:
                d = _inside(x4, y4, d4, 0, 1, 2, column, row)
                d = _inside(x4, y4, d4, 3, 2, 1, column, row) if np.isnan(d) else d
                if not np.isnan(d):
                    _enter(row, column, d, shape, camera, next_free, points, cameras)


@kernel
def _inside(x4, y4, d4, a, b, c, x, y):
    """Return the disparity at a point of a triangle; NaN outside it, or if it is seen from behind."""
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
def vote(starts, points, cameras, lowest, step, reach, positions, images, frame, reference, layers):
    """Peel the values of every cell (2.21): disparity, votes, and the median colour of the voters."""
    disparity, votes, colour = layers
    width = disparity.shape[2]
    longest = 1
    for cell in range(starts.size - 1):
        longest = max(longest, starts[cell + 1] - starts[cell])
    levels, samples = np.empty(longest, np.int64), np.empty((positions.shape[0], 3))
    alive, chosen = np.empty(longest, np.bool_), np.empty(longest, np.bool_)
    seen = np.empty(positions.shape[0], np.bool_)
    left, top, right, bottom = frame
    baselines = np.maximum(np.abs(positions[:, 0]), np.abs(positions[:, 1]))
    for cell in range(starts.size - 1):
        start, count = starts[cell], starts[cell + 1] - starts[cell]
        row, column = cell // width, cell % width
        in_frame = top <= row < bottom and left <= column < right
        d, c = points[start : start + count], cameras[start : start + count]
        for i in range(count):
            levels[i], alive[i] = int(np.floor((d[i] - lowest) / step + 0.5)), True
        for layer in range(disparity.shape[0]):
            owner = reference if in_frame and layer == 0 else NO_CAMERA
            value, number = peel(d, c, levels, step, reach, baselines, owner, seen, alive, chosen)
            if number == 0:
                break
            slot = layer
            while slot > 0 and disparity[slot - 1, row, column] < value:
                disparity[slot, row, column] = disparity[slot - 1, row, column]
                votes[slot, row, column] = votes[slot - 1, row, column]
                colour[slot, row, column] = colour[slot - 1, row, column]
                slot -= 1
            disparity[slot, row, column], votes[slot, row, column] = value, min(number, 255)
            number = 0
            for i in range(count):
                if chosen[i]:
                    x = column - left - positions[c[i], 0] * d[i]
                    y = row - top - positions[c[i], 1] * d[i]
                    _sample(images[c[i]], x, y, samples[number])
                    number += 1
            for channel in range(3):
                median = np.median(samples[:number, channel])
                colour[slot, row, column, channel] = int(np.floor(median + 0.5))


@kernel
def peel(points, cameras, levels, step, reach, baselines, owner, seen, alive, chosen):
    """Choose the next value of a cell by (2.21), and remove its points and impossible ones from `alive`."""
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
def _sample(image, x, y, sample):
    """Interpolate a picture linearly, with a repeated border."""
    height, width = image.shape[:2]
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
    s, t = x - left, y - top
    for channel in range(3):
        above = (1.0 - s) * image[top, left, channel] + s * image[top, right, channel]
        below = (1.0 - s) * image[bottom, left, channel] + s * image[bottom, right, channel]
        sample[channel] = (1.0 - t) * above + t * below
