"""Compiled loops over cost volumes (rows, columns, labels); validated and described by their callers."""

import numpy as np

from dvc._jit import kernel

BEFORE_Y, AFTER_Y, BEFORE_X, AFTER_X = 0, 1, 2, 3
"""Arms of a pixel: how many pixels up, down, to the left and to the right belong to it."""


@kernel
def census(grey, radius, dead_zone, bits):
    """One bit for each neighbour, set where it is clearly darker; the border repeats."""
    height, width = grey.shape
    for y in range(height):
        for x in range(width):
            word = np.uint32(0)
            for dy in range(-radius, radius + 1):
                for dx in range(-radius, radius + 1):
                    if dy == 0 and dx == 0:
                        continue
                    i, j = min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)
                    word = (word << np.uint32(1)) | np.uint32(grey[i, j] < grey[y, x] - dead_zone)
            bits[y, x] = word


@kernel
def count_bits(word):
    """Number of ones of 32 bits."""
    word = word - ((word >> np.uint32(1)) & np.uint32(0x55555555))
    word = (word & np.uint32(0x33333333)) + ((word >> np.uint32(2)) & np.uint32(0x33333333))
    word = (word + (word >> np.uint32(4))) & np.uint32(0x0F0F0F0F)
    return ((word * np.uint32(0x01010101)) >> np.uint32(24)) & np.uint32(0xFF)


@kernel
def sees(u, v, seen):
    """Tell whether a view shows something at a place."""
    return 0 <= u < seen.shape[1] and 0 <= v < seen.shape[0] and seen[v, u]


@kernel
def census_cost(own, other, shifts, origin, top, census_table, level_table, cost, weight):
    """Robust distance of census bits and of levels, per pixel and label; weight 0 where nothing is seen.

    `own`: picture and its bits; `other`: the same at each phase, and what is seen; `shifts`: (labels, 3)
    phase, columns and rows; `origin`: first label of each pixel of the view.
    """
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
                different = count_bits(word ^ other_bits[phase, v, u])
                cost[i, x, k] = census_table[different] + level_table[int(difference)]
                weight[i, x, k] = 1.0


@kernel
def squared_cost(image, others, seen, shifts, origin, top, limit, cost, weight):
    """Truncated squared difference (2.18) over its limit, per pixel and label, as in `census_cost`."""
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
    for y in range(height):
        for x in range(width):
            for side in range(4):
                dy = (-1, 1, 0, 0)[side]
                dx = (0, 0, -1, 1)[side]
                length = 0
                while length + 1 < reach:
                    i, j = y + dy * (length + 1), x + dx * (length + 1)
                    if i < 0 or j < 0 or i >= height or j >= width:
                        break
                    distance = colour_distance(image, y, x, i, j)
                    if distance >= limit or colour_distance(image, i - dy, j - dx, i, j) >= limit:
                        break
                    if length + 1 > near_reach and distance >= far_limit:
                        break
                    length += 1
                arms[y, x, side] = length


@kernel
def cut_arms(arms, base, jump, cut):
    """Shorten arms to where the base surface jumps."""
    height, width = base.shape
    for y in range(height):
        for x in range(width):
            for side in range(4):
                dy = (-1, 1, 0, 0)[side]
                dx = (0, 0, -1, 1)[side]
                length = 0
                while length < arms[y, x, side]:
                    i, j = y + dy * (length + 1), x + dx * (length + 1)
                    if i < 0 or i >= height or abs(base[i, j] - base[i - dy, j - dx]) > jump:
                        break
                    length += 1
                cut[y, x, side] = length


@kernel
def sum_line(values, base, before, after, sums, total):
    """Sum (n, labels) over each pixel's segment, labels counted from a base surface; outside them is nothing.

    `sums`: work space (n + 1, labels and the range of the base, or more).
    """
    length, count = values.shape
    lowest, highest = base[0], base[0]
    for n in range(length):
        lowest, highest = min(lowest, base[n]), max(highest, base[n])
    width = count + highest - lowest
    for j in range(width):
        sums[0, j] = 0.0
    for n in range(length):
        start = highest - base[n]
        for j in range(start):
            sums[n + 1, j] = sums[n, j]
        for k in range(count):
            sums[n + 1, start + k] = sums[n, start + k] + values[n, k]
        for j in range(start + count, width):
            sums[n + 1, j] = sums[n, j]
    for n in range(length):
        first, end, start = n - before[n], n + after[n] + 1, highest - base[n]
        for k in range(count):
            total[n, k] = sums[end, start + k] - sums[first, start + k]


@kernel
def sum_rows(volume, base, arms, total):
    """`sum_line` along each row."""
    sums = np.empty((volume.shape[1] + 1, volume.shape[2] + base.max() - base.min()), np.float32)
    for y in range(volume.shape[0]):
        sum_line(volume[y], base[y], arms[y, :, BEFORE_X], arms[y, :, AFTER_X], sums, total[y])


@kernel
def sum_columns(volume, base, arms, total):
    """`sum_line` along each column."""
    sums = np.empty((volume.shape[0] + 1, volume.shape[2] + base.max() - base.min()), np.float32)
    for x in range(volume.shape[1]):
        before, after = arms[:, x, BEFORE_Y], arms[:, x, AFTER_Y]
        sum_line(volume[:, x], base[:, x], before, after, sums, total[:, x])


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
def send(cost, first, second, third, strength, slope, limit, shift, message, work):
    """Message to a neighbour whose base surface is `shift` labels higher; truncated linear smoothness."""
    count = cost.shape[0]
    lowest = np.float32(1e30)
    for k in range(count):
        work[k] = cost[k] + first[k] + second[k] + third[k]
        lowest = min(lowest, work[k])
    step, highest = slope * strength, lowest + limit * strength
    for k in range(1, count):
        work[k] = min(work[k], work[k - 1] + step)
    for k in range(count - 2, -1, -1):
        work[k] = min(work[k], work[k + 1] + step)
    if shift == 0:
        for k in range(count):
            message[k] = min(work[k], highest) - lowest
        return
    for k in range(count):
        source = k - shift
        if source < 0:
            value = work[0] - step * source
        elif source >= count:
            value = work[count - 1] + step * (source - count + 1)
        else:
            value = work[source]
        message[k] = min(value, highest) - lowest


@kernel
def exchange(cost, strengths, messages, slope, limit, parity):
    """Let every second pixel send to its four neighbours.

    `strengths`: of edges to the right and downwards, and the rise of the base surface along them; `messages`:
    those that go up, down, to the left and to the right.
    """
    across, down, rise_x, rise_y = strengths
    up, downwards, left, right = messages
    height, width, count = cost.shape
    work = np.empty(count, np.float32)
    for y in range(height):
        for x in range((y + parity) % 2, width, 2):
            here = cost[y, x]
            a, b, c, d = up[y, x], downwards[y, x], left[y, x], right[y, x]
            if y > 0:
                rise = -rise_y[y - 1, x]
                send(here, a, c, d, down[y - 1, x], slope, limit, rise, up[y - 1, x], work)
            if y < height - 1:
                send(here, b, c, d, down[y, x], slope, limit, rise_y[y, x], downwards[y + 1, x], work)
            if x > 0:
                rise = -rise_x[y, x - 1]
                send(here, a, b, c, across[y, x - 1], slope, limit, rise, left[y, x - 1], work)
            if x < width - 1:
                send(here, a, b, d, across[y, x], slope, limit, rise_x[y, x], right[y, x + 1], work)


@kernel
def choose(total, label, offset, margin):
    """Label of smallest cost, place of the parabola's minimum beside it, and by how much it beats others."""
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
            second = np.float32(1e30)
            for k in range(count):
                if abs(k - best) > 1:
                    second = min(second, total[y, x, k])
            margin[y, x] = second - total[y, x, best]
