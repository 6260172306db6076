"""Compiled loops over cost volumes (rows, columns, labels); validated and described by their callers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.geometry._kernels import count_bits

BEFORE_Y, AFTER_Y, BEFORE_X, AFTER_X = 0, 1, 2, 3
"""Arms of a pixel: how many pixels up, down, to the left and to the right belong to it."""


class Region(NamedTuple):
    """Which labels of which pixels of a view are compared, and where another shows them."""

    shifts: NDArray[np.int64]  # of each label: phase, columns and rows to the other view
    origin: NDArray[np.int64]  # first label of each pixel
    top: int  # first row


class Smoothness(NamedTuple):
    """Truncated linear cost of a step of labels."""

    strength: np.float32  # factor on both
    slope: np.float32  # of a label
    limit: np.float32


@kernel
def sees(u, v, seen):
    """Tell whether a view shows something at a place."""
    return 0 <= u < seen.shape[1] and 0 <= v < seen.shape[0] and seen[v, u]


@kernel
def census_cost(own, other, region, census_table, level_table, cost, weight):
    """Robust distance of census bits and of levels, per pixel and label; weight 0 where nothing is seen."""
    shifts, origin, top = region
    image, bits = own
    others, other_bits, seen = other
    for i in range(cost.shape[0]):
        y = top + i
        for x in range(cost.shape[1]):
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            word, first = bits[y, x], origin[y, x]
            for k in range(cost.shape[2]):
                label = first + k
                cost[i, x, k] = 0.0
                weight[i, x, k] = 0.0
                if label < 0 or label >= shifts.shape[0]:
                    continue
                phase, u, v = shifts[label, 0], x + shifts[label, 1], y + shifts[label, 2]
                if not sees(u, v, seen):
                    continue
                pixel = others[phase, v, u]
                difference = abs(red - pixel[0]) + abs(green - pixel[1]) + abs(blue - pixel[2])
                different = count_bits(np.uint64(word ^ other_bits[phase, v, u]))
                cost[i, x, k] = census_table[different] + level_table[int(difference)]
                weight[i, x, k] = 1.0


@kernel
def squared_cost(image, others, seen, region, limit, cost, weight):
    """Truncated squared difference (2.18) over its limit, per pixel and label, as in `census_cost`."""
    shifts, origin, top = region
    for i in range(cost.shape[0]):
        y = top + i
        for x in range(cost.shape[1]):
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            first = origin[y, x]
            for k in range(cost.shape[2]):
                label = first + k
                cost[i, x, k] = 0.0
                weight[i, x, k] = 0.0
                if label < 0 or label >= shifts.shape[0]:
                    continue
                phase, u, v = shifts[label, 0], x + shifts[label, 1], y + shifts[label, 2]
                if not sees(u, v, seen):
                    continue
                pixel = others[phase, v, u]
                total = (red - pixel[0]) ** 2 + (green - pixel[1]) ** 2 + (blue - pixel[2]) ** 2
                cost[i, x, k] = min(total / np.float32(3.0), limit) / limit
                weight[i, x, k] = 1.0


@kernel
def colour_distance(image, y, x, i, j):
    """Largest difference of two pixels over the channels."""
    largest = np.int64(0)
    for channel in range(3):
        difference = abs(np.int64(image[y, x, channel]) - np.int64(image[i, j, channel]))
        largest = max(largest, difference)
    return largest


@kernel
def grow_arms(image, reach, near_reach, limit, far_limit, arms):
    """Length of the arms of each pixel: to where the colour changes, farther only at a smaller change."""
    height, width = image.shape[:2]
    for side in range(4):
        dy = (-1, 1, 0, 0)[side]
        dx = (0, 0, -1, 1)[side]
        for m in range(height):
            y = m if dy <= 0 else height - 1 - m
            for n in range(width):
                x = n if dx <= 0 else width - 1 - n
                # the neighbour is done: one pixel more follows without a step
                i, j = y + dy, x + dx
                even = 0
                if 0 <= i < height and 0 <= j < width and colour_distance(image, y, x, i, j) < limit:
                    even = arms[i, j, side] + 1
                arms[y, x, side] = even
    for y in range(height):
        for x in range(width):
            for side in range(4):
                dy = (-1, 1, 0, 0)[side]
                dx = (0, 0, -1, 1)[side]
                length, most = 0, min(arms[y, x, side], reach - 1)
                while length < most:
                    distance = colour_distance(image, y, x, y + dy * (length + 1), x + dx * (length + 1))
                    if distance >= limit or (length >= near_reach and distance >= far_limit):
                        break
                    length += 1
                arms[y, x, side] = length


@kernel
def cut_arms(arms, base, jump, cut):
    """Shorten arms to where the base surface jumps."""
    height, width = base.shape
    for side in range(4):
        dy = (-1, 1, 0, 0)[side]
        dx = (0, 0, -1, 1)[side]
        for m in range(height):
            y = m if dy <= 0 else height - 1 - m
            for n in range(width):
                x = n if dx <= 0 else width - 1 - n
                i, j = y + dy, x + dx
                even = 0
                if 0 <= i < height and 0 <= j < width and abs(base[i, j] - base[y, x]) <= jump:
                    even = cut[i, j, side] + 1
                cut[y, x, side] = even
    for y in range(height):
        for x in range(width):
            for side in range(4):
                cut[y, x, side] = min(cut[y, x, side], arms[y, x, side])


@kernel
def sum_line(values, base, before, after, sums, total):
    """Sum (n, labels) over each pixel's segment, labels counted from a base surface; others are 0."""
    length, count = values.shape
    lowest, highest = base[0], base[0]
    for n in range(length):
        lowest, highest = min(lowest, base[n]), max(highest, base[n])
    width = count + highest - lowest
    for j in range(width):
        sums[0, j] = 0.0
    for n in range(length):
        start = highest - base[n]
        for j in range(width):
            sums[n + 1, j] = sums[n, j]
        added = sums[n + 1, start : start + count]
        for k in range(count):
            added[k] += values[n, k]
    for n in range(length):
        start = highest - base[n]
        end = sums[n + after[n] + 1, start : start + count]
        first = sums[n - before[n], start : start + count]
        for k in range(count):
            total[n, k] = end[k] - first[k]


@kernel
def sum_rows(volume, base, arms, total):
    """`sum_line` along each row."""
    sums = np.empty((volume.shape[1] + 1, volume.shape[2] + base.max() - base.min()), np.float32)
    for y in range(volume.shape[0]):
        sum_line(volume[y], base[y], arms[y, :, BEFORE_X], arms[y, :, AFTER_X], sums, total[y])


@kernel
def sum_columns(volume, base, arms, total):
    """`sum_line` along each column."""
    height, width, count = volume.shape
    sums = np.empty((height + 1, count + base.max() - base.min()), np.float32)
    column, summed = np.empty((height, count), np.float32), np.empty((height, count), np.float32)
    for x in range(width):
        for y in range(height):
            for k in range(count):
                column[y, k] = volume[y, x, k]
        sum_line(column, base[:, x], arms[:, x, BEFORE_Y], arms[:, x, AFTER_Y], sums, summed)
        for y in range(height):
            for k in range(count):
                total[y, x, k] = summed[y, k]


@kernel
def apply_weights(cost, weight):
    """Multiply costs by their weights."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                cost[y, x, k] *= weight[y, x, k]


@kernel
def normalise(cost, weight, support):
    """Divide sums by the sum of weights, and this by the number of pixels."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                total = weight[y, x, k]
                cost[y, x, k] = cost[y, x, k] / total if total > 0.0 else np.float32(0.0)
                weight[y, x, k] = min(total / support[y, x], np.float32(1.0))


@kernel
def keep_smaller(cost, weight, other_cost, other_weight):
    """Replace costs by the smaller of two, as far as both are known; the better known one else."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                mine, theirs = weight[y, x, k], other_weight[y, x, k]
                # half known is as good as known: windows at borders and occlusions
                known = np.float32(0.5) * max(mine, theirs)
                if mine < known or (theirs >= known and other_cost[y, x, k] < cost[y, x, k]):
                    cost[y, x, k] = other_cost[y, x, k]
                    weight[y, x, k] = theirs


@kernel
def keep_mean(cost, weight, other_cost, other_weight):
    """Replace costs by the weighted mean of two, and weights by their larger one."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                mine, theirs = weight[y, x, k], other_weight[y, x, k]
                if theirs > 0.0:
                    total = mine * cost[y, x, k] + theirs * other_cost[y, x, k]
                    cost[y, x, k] = total / (mine + theirs)
                    weight[y, x, k] = max(mine, theirs)


@kernel
def fill_undefined(cost, weight, constant, share):
    """Mix a constant into costs, as if this share of the support had it."""
    for y in range(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                w = weight[y, x, k]
                cost[y, x, k] = (cost[y, x, k] * w + share * constant) / (w + share)


@kernel
def send(cost, heard, smoothness, shift, message, work):
    """Message to a neighbour whose base surface is `shift` labels higher; truncated linear smoothness."""
    first, second, third = heard
    strength, slope, limit = smoothness
    count = cost.shape[0]
    margin = (work.shape[1] - count) // 2
    beliefs, other = work[0, margin : margin + count], 1
    for k in range(count):
        beliefs[k] = cost[k] + first[k] + second[k] + third[k]
    lowest = smallest(beliefs)
    step, highest = slope * strength, lowest + limit * strength
    distance = 1
    while distance <= margin:
        # covers all distances below twice this one
        source, spread = work[1 - other], work[other, margin : margin + count]
        below, here, above = source[margin - distance :], source[margin:], source[margin + distance :]
        rise = np.float32(distance) * step
        for k in range(count):
            spread[k] = min(here[k], min(below[k], above[k]) + rise)
        beliefs, other = spread, 1 - other
        distance *= 2
    if shift == 0:
        for k in range(count):
            message[k] = min(beliefs[k], highest) - lowest
        return
    for k in range(count):
        source = k - shift
        if source < 0:
            value = beliefs[0] - step * source
        elif source >= count:
            value = beliefs[count - 1] + step * (source - count + 1)
        else:
            value = beliefs[source]
        message[k] = min(value, highest) - lowest


@kernel
def smallest(values):
    """Smallest of some numbers: four at a time, so that they need not wait for each other."""
    a = b = c = d = values[0]
    quarters = values.shape[0] // 4
    for m in range(quarters):
        a, b = min(a, values[4 * m]), min(b, values[4 * m + 1])
        c, d = min(c, values[4 * m + 2]), min(d, values[4 * m + 3])
    for k in range(4 * quarters, values.shape[0]):
        a = min(a, values[k])
    return min(a, b, c, d)


@kernel
def message_space(count, slope, limit):
    """Work space of `send`: two lines of labels between infinite costs, as far as smoothness reaches."""
    margin = 1
    while 2 * margin < count and 2 * margin * slope <= limit:
        margin *= 2
    return np.full((2, count + 2 * margin), np.inf, np.float32)


@kernel
def exchange(cost, strengths, messages, slope, limit, parity):
    """Let every second pixel send to its four neighbours."""
    across, down, rise_x, rise_y = strengths
    up, downwards, left, right = messages
    height, width, count = cost.shape
    work = message_space(count, slope, limit)
    for y in range(height):
        for x in range((y + parity) % 2, width, 2):
            here = cost[y, x]
            a, b, c, d = up[y, x], downwards[y, x], left[y, x], right[y, x]
            if y > 0:
                rise = -rise_y[y - 1, x]
                send(here, (a, c, d), Smoothness(down[y - 1, x], slope, limit), rise, up[y - 1, x], work)
            if y < height - 1:
                smoothness = Smoothness(down[y, x], slope, limit)
                send(here, (b, c, d), smoothness, rise_y[y, x], downwards[y + 1, x], work)
            if x > 0:
                rise = -rise_x[y, x - 1]
                send(here, (a, b, c), Smoothness(across[y, x - 1], slope, limit), rise, left[y, x - 1], work)
            if x < width - 1:
                smoothness = Smoothness(across[y, x], slope, limit)
                send(here, (a, b, d), smoothness, rise_x[y, x], right[y, x + 1], work)


@kernel
def choose(total, label, offset):
    """Label of smallest cost, and place of the parabola's minimum beside it."""
    height, width, count = total.shape
    for y in range(height):
        for x in range(width):
            best = 0
            for k in range(1, count):
                if total[y, x, k] < total[y, x, best]:
                    best = k
            label[y, x] = best
            offset[y, x] = 0.0
            if 0 < best < count - 1:
                before = total[y, x, best - 1] - total[y, x, best]
                after = total[y, x, best + 1] - total[y, x, best]
                if max(before, after) > 0.0:
                    offset[y, x] = 0.5 * (before - after) / max(before, after)
