"""Compiled loops of the geometry of several views; validated and described by their callers.

A *warp* is a 3x4 matrix ``[H | e]`` in pixels, infinite homography and epipole: the point x of one view with
inverse depth rho lies at ``H x + rho e`` (homogeneous) in another. A *depth map* is an inverse depth at every
point of a regular grid.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

Floats = NDArray[np.float64]

EMPTY = -1e30
"""Inverse depth where nothing was drawn."""
PADDING = 3
"""Samples on each side of an image that is interpolated."""
CONSISTENT, OUTSIDE, OCCLUDED = 0, 1, 2
"""Visibility of a point in another view: see `dvc.geometry.depth_maps.Visibility`."""
OUTSIDE_WEIGHT, OCCLUDED_WEIGHT, EDGE_WEIGHT = 1e-6, 1e-4, 0.02
"""Weight of a view for a point outside it, behind something, or beside something nearer; 1 elsewhere."""


class Hypotheses(NamedTuple):
    """Inverse depths to choose from."""

    lowest: float
    step: float


class CensusLimits(NamedTuple):
    """Costs of `census_cost`."""

    levels: np.float32  # that count at most
    bit_cost: int
    outside_cost: int


class Continuation(NamedTuple):
    """How surfaces are continued by `fill_depth`."""

    edge_levels: float  # a step that halves the weight of what lies behind it
    reach_px: float  # how far slopes are continued
    quantile: float  # which of the continued inverse depths is taken


class Median(NamedTuple):
    """Neighbourhood and bins of `guided_median`."""

    radius_px: int
    levels: float  # a difference that quarters the weight
    lowest: float  # inverse depth of the first bin
    step: float


class OtherView(NamedTuple):
    """What another view sees, and the warps there and back."""

    there: Floats
    back: Floats
    depth: Floats
    visibility: NDArray[np.int8]
    slack_px: float


class PicturePair(NamedTuple):
    """Two pictures of one scene, and the warps from a virtual view to them."""

    first: NDArray[np.float32]
    second: NDArray[np.float32]
    to_first: Floats
    to_second: Floats


@kernel
def warp_point(warp, x, y, rho):
    """Position in the other view, and the third homogeneous coordinate (positive before the camera)."""
    u = warp[0, 0] * x + warp[0, 1] * y + warp[0, 2] + rho * warp[0, 3]
    v = warp[1, 0] * x + warp[1, 1] * y + warp[1, 2] + rho * warp[1, 3]
    w = warp[2, 0] * x + warp[2, 1] * y + warp[2, 2] + rho * warp[2, 3]
    if w < 1e-6:
        return -1e9, -1e9, w
    return u / w, v / w, w


@kernel
def warp_grid(warp, depth, origin, step, positions):
    """Move the vertices of a depth map to another view: (x, y, inverse depth there); far away if behind."""
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            x, y, w = warp_point(warp, origin + j * step, origin + i * step, depth[i, j])
            positions[i, j, 0] = x
            positions[i, j, 1] = y
            positions[i, j, 2] = depth[i, j] / w if w >= 1e-6 else EMPTY


@kernel
def discontinuities(depth, warp, tolerance_px, found):
    """Mark the cells of a grid of pixels whose corners do not move alike."""
    height, width = depth.shape
    motion = np.empty((2, width, 2))
    for y in range(height):
        below, above = motion[y & 1], motion[1 - (y & 1)]
        for x in range(width):
            u, v, _ = warp_point(warp, x, y, depth[y, x])
            below[x, 0], below[x, 1] = u - x, v - y
        if y == 0:
            continue
        for x in range(width - 1):
            spread = 0.0
            for axis in range(2):
                a, b, c, d = above[x, axis], above[x + 1, axis], below[x, axis], below[x + 1, axis]
                spread = max(spread, max(a, b, c, d) - min(a, b, c, d))
            found[y - 1, x] = spread > tolerance_px


@kernel
def rasterise(positions, skipped, nearest):
    """Draw the triangles of a grid but for skipped cells; `nearest` keeps the largest inverse depth."""
    for i in range(positions.shape[0] - 1):
        for j in range(positions.shape[1] - 1):
            if skipped[i, j]:
                continue
            rasterise_triangle(positions[i, j], positions[i, j + 1], positions[i + 1, j], nearest)
            rasterise_triangle(positions[i + 1, j + 1], positions[i + 1, j], positions[i, j + 1], nearest)


@kernel
def rasterise_triangle(a, b, c, nearest):
    """Draw one triangle: inverse depth is affine in the image."""
    height, width = nearest.shape
    if a[2] == EMPTY or b[2] == EMPTY or c[2] == EMPTY:
        return
    left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
    top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    if right < 0 or bottom < 0 or left > width - 1 or top > height - 1:
        return
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if not 1e-9 < area < np.inf:
        return
    left, right = max(left, 0.0), min(right, width - 1.0)
    top, bottom = max(top, 0.0), min(bottom, height - 1.0)
    for y in range(int(np.ceil(top)), int(np.floor(bottom)) + 1):
        for x in range(int(np.ceil(left)), int(np.floor(right)) + 1):
            of_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
            of_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
            if of_b < -1e-9 or of_c < -1e-9 or of_b + of_c > 1.0 + 1e-9:
                continue
            rho = a[2] + of_b * (b[2] - a[2]) + of_c * (c[2] - a[2])
            nearest[y, x] = max(nearest[y, x], rho)


@kernel
def cubic_weights(s):
    """Six-point cubic convolution of fourth order at fraction s (Keys 1981)."""
    t = 1.0 - s
    outer, inner, near = _far(2.0 + s), _middle(1.0 + s), _near(s)
    return outer, inner, near, _near(t), _middle(1.0 + t), _far(2.0 + t)


@kernel
def _near(d):
    return np.float32((4.0 / 3.0 * d - 7.0 / 3.0) * d * d + 1.0)


@kernel
def _middle(d):
    return np.float32(((-7.0 / 12.0 * d + 3.0) * d - 59.0 / 12.0) * d + 2.5)


@kernel
def _far(d):
    return np.float32(((1.0 / 12.0 * d - 2.0 / 3.0) * d + 1.75) * d - 1.5)


@kernel
def sample_image(padded, positions, samples):
    """Interpolate at positions (x, y) an image that is `PADDING` wider on all sides; its border repeats."""
    height, width = padded.shape[0] - 2 * PADDING, padded.shape[1] - 2 * PADDING
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            x = min(max(positions[i, j, 0], 0.0), width - 1.0)
            y = min(max(positions[i, j, 1], 0.0), height - 1.0)
            left, top = int(x), int(y)
            down, across = cubic_weights(y - top), cubic_weights(x - left)
            a = b = c = d = e = f = np.float32(0.0)
            for k in range(6):
                line, weight = padded[top + k + PADDING - 2], down[k]
                column = left + PADDING - 2
                a += weight * line[column]
                b += weight * line[column + 1]
                c += weight * line[column + 2]
                d += weight * line[column + 3]
                e += weight * line[column + 4]
                f += weight * line[column + 5]
            total = (across[0] * a + across[1] * b) + (across[2] * c + across[3] * d)
            total += across[4] * e + across[5] * f
            samples[i, j] = min(max(total, np.float32(0.0)), np.float32(255.0))


STEPS = np.int32(32)
"""Parts of a pixel to which positions are rounded."""
LANE, LANE_MASK = np.uint64(21), (1 << 21) - 1
"""Bits for each of three numbers in a word; they hold 2047 times the square of the parts."""


@kernel
def warp_hypotheses(warp, x, y, low, step, us, vs):
    """Positions of a point in the other view, one for each hypothesis; far away if behind."""
    a = warp[0, 0] * x + warp[0, 1] * y + warp[0, 2]
    b = warp[1, 0] * x + warp[1, 1] * y + warp[1, 2]
    c = warp[2, 0] * x + warp[2, 1] * y + warp[2, 2]
    for k in range(us.size):
        rho = low + k * step
        w = c + rho * warp[2, 3]
        behind = w < 1e-6
        us[k] = -1e9 if behind else (a + rho * warp[0, 3]) / w
        vs[k] = -1e9 if behind else (b + rho * warp[1, 3]) / w


@kernel
def places_of(us, vs, width, height, places, fractions):
    """Round positions to parts of a pixel: that at the upper left (-1 outside), and the rest."""
    for k in range(us.size):
        inside = (us[k] >= 0.0) & (us[k] <= width - 1.0) & (vs[k] >= 0.0) & (vs[k] <= height - 1.0)
        u, v = us[k] if inside else 0.0, vs[k] if inside else 0.0
        u, v = np.int32(u * STEPS + 0.5), np.int32(v * STEPS + 0.5)
        column, row = min(u // STEPS, np.int32(width - 2)), min(v // STEPS, np.int32(height - 2))
        places[k] = row * np.int32(width) + column if inside else np.int32(-1)
        fractions[0, k], fractions[1, k] = u - STEPS * column, v - STEPS * row


@kernel
def matching_cost(base, other, warp, low, step, limits, outside_cost, cost):
    """Truncated difference of the features of a base view and another, per pixel and hypothesis.

    Features are three numbers in one word: that of the other view is interpolated in all three at once.
    """
    height, width = base.shape
    us, vs = np.empty(cost.shape[2]), np.empty(cost.shape[2])
    places, fractions = np.empty(us.size, np.int32), np.empty((2, us.size), np.int32)
    samples, line, mask = other.ravel(), np.uint64(width), np.uint64(LANE_MASK)
    most = limits * (2 * STEPS * STEPS)
    for y in range(height):
        for x in range(width):
            warp_hypotheses(warp, x, y, low, step, us, vs)
            places_of(us, vs, width, height, places, fractions)
            own = base[y, x] * np.uint64(STEPS * STEPS)
            one, two, three = (
                np.int64(own & mask),
                np.int64((own >> LANE) & mask),
                np.int64(own >> (LANE + LANE)),
            )
            for k in range(us.size):
                if places[k] < 0:
                    cost[y, x, k] = outside_cost
                    continue
                at, right, down = np.uint64(places[k]), np.uint64(fractions[0, k]), np.uint64(fractions[1, k])
                left, up = np.uint64(STEPS) - right, np.uint64(STEPS) - down
                upper = left * samples[at] + right * samples[at + np.uint64(1)]
                lower = left * samples[at + line] + right * samples[at + line + np.uint64(1)]
                there = up * upper + down * lower
                total = min(abs(np.int64(there & mask) - one), most[0])
                total += min(abs(np.int64((there >> LANE) & mask) - two), most[1])
                total += min(abs(np.int64(there >> (LANE + LANE)) - three), most[2])
                cost[y, x, k] = total // (2 * STEPS * STEPS)


@kernel
def box_mean(cost, mean):
    """Mean of each hypothesis over 3x3 pixels; those outside are as the nearest inside."""
    height, width, count = cost.shape
    rows = np.empty((width, count), np.int16)
    for y in range(height):
        above, here, below = cost[max(y - 1, 0)], cost[y], cost[min(y + 1, height - 1)]
        for x in range(width):
            for k in range(count):
                rows[x, k] = above[x, k] + here[x, k] + below[x, k]
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            for k in range(count):
                mean[y, x, k] = np.uint16(rows[left, k] + rows[x, k] + rows[right, k]) // np.uint16(9)


@kernel
def census(padded, radius, dead_zone, bits):
    """One bit for each neighbour, set where it is clearly darker; `padded` by the radius on all sides."""
    side = 2 * radius + 1
    for y in range(bits.shape[0]):
        for x in range(bits.shape[1]):
            word = np.uint64(0)
            level = padded[y + radius, x + radius] - dead_zone
            for i in range(side):
                for j in range(side):
                    if i != radius or j != radius:
                        word = (word << np.uint64(1)) | np.uint64(padded[y + i, x + j] < level)
            bits[y, x] = word


@kernel
def count_bits(word):
    """Number of ones of 64 bits."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def census_cost(base, other, warp, hypotheses, limits, cost):
    """Truncated difference of levels, and census bits that differ, per pixel and hypothesis."""
    low, step = hypotheses
    limit, bit_cost, outside_cost = limits
    levels, bits = base
    samples, words = other[0].ravel(), other[1].ravel()
    height, width = levels.shape
    line = np.uint64(width)
    us, vs = np.empty(cost.shape[2]), np.empty(cost.shape[2])
    places, nearest = np.empty(us.size, np.int32), np.empty(us.size, np.int32)
    for y in range(height):
        for x in range(width):
            warp_hypotheses(warp, x, y, low, step, us, vs)
            split_positions(us, vs, width, height, places, nearest)
            for k in range(us.size):
                if places[k] < 0:
                    cost[y, x, k] = outside_cost
                    continue
                at, right, down = np.uint64(places[k]), us[k], vs[k]
                upper = samples[at] + right * (samples[at + np.uint64(1)] - samples[at])
                at += line
                lower = samples[at] + right * (samples[at + np.uint64(1)] - samples[at])
                difference = min(abs(upper + down * (lower - upper) - levels[y, x]), limit)
                different = count_bits(bits[y, x] ^ words[np.uint64(nearest[k])])
                cost[y, x, k] = np.int16(difference) + np.int16(bit_cost * np.int64(different))


@kernel
def split_positions(us, vs, width, height, places, nearest):
    """Split positions: the pixel at the upper left (-1 outside), the nearest one, and in place the rest."""
    for k in range(us.size):
        inside = (us[k] >= 0.0) & (us[k] <= width - 1.0) & (vs[k] >= 0.0) & (vs[k] <= height - 1.0)
        u, v = us[k] if inside else 0.0, vs[k] if inside else 0.0
        column, row = min(np.int32(u), np.int32(width - 2)), min(np.int32(v), np.int32(height - 2))
        places[k] = row * np.int32(width) + column if inside else np.int32(-1)
        nearest[k] = np.int32(v + 0.5) * np.int32(width) + np.int32(u + 0.5)
        us[k], vs[k] = u - column, v - row


@kernel
def add_prior(expected, known, low, step, weight, limit, cost):
    """Add the truncated distance of each hypothesis from an expected inverse depth, where there is one."""
    height, width, count = cost.shape
    for y in range(height):
        for x in range(width):
            if not known[y, x]:
                continue
            place = (expected[y, x] - low) / step
            for k in range(count):
                cost[y, x, k] += np.int16(min(weight * abs(k - place), limit))


@kernel
def aggregate_path(cost, image, direction, jumps, lines, total):
    """Add the costs of the best paths that reach each pixel along one direction (semi-global matching)."""
    (dy, dx), (small, large), (previous, current) = direction, jumps, lines
    height, width, count = cost.shape
    first_y, end_y, step_y = (0, height, 1) if dy > 0 or (dy == 0 and dx > 0) else (height - 1, -1, -1)
    first_x, end_x, step_x = (0, width, 1) if dx >= 0 else (width - 1, -1, -1)
    for y in range(first_y, end_y, step_y):
        for x in range(first_x, end_x, step_x):
            here = current[x]
            ny, nx = y - dy, x - dx
            if not (0 <= ny < height and 0 <= nx < width):
                for k in range(count):
                    here[k + 1] = cost[y, x, k]
            else:
                line = current[nx] if dy == 0 else previous[nx]
                lowest = line[count + 2]
                jump = np.int16(max(small, large / (1.0 + 0.1 * abs(image[y, x] - image[ny, nx]))))
                limit = np.int16(lowest + jump)
                one = np.int16(small)
                for k in range(count):
                    best = min(line[k + 1], limit, min(line[k], line[k + 2]) + one)
                    here[k + 1] = cost[y, x, k] + best - lowest
            lowest_here = here[1]
            for k in range(count):
                lowest_here = min(lowest_here, here[k + 1])
                total[y, x, k] += here[k + 1]
            here[count + 2] = lowest_here
        if dy != 0:
            previous, current = current, previous


@kernel
def smallest(line, first, end):
    """Smallest of some entries."""
    lowest = line[first]
    for k in range(first + 1, end):
        lowest = min(lowest, line[k])
    return lowest


@kernel
def best_hypothesis(total, hypothesis, confidence):
    """Choose the hypothesis of smallest cost with a parabola through its neighbours."""
    height, width, count = total.shape
    for y in range(height):
        for x in range(width):
            line = total[y, x]
            lowest = smallest(line, 0, count)
            best = 0
            while line[best] != lowest:
                best += 1
            hypothesis[y, x] = best
            if 0 < best < count - 1:
                left = float(total[y, x, best - 1]) - total[y, x, best]
                right = float(total[y, x, best + 1]) - total[y, x, best]
                if max(left, right) > 0:
                    hypothesis[y, x] += 0.5 * (left - right) / max(left, right)
            second = np.int64(1) << 30
            if best > 2:
                second = min(second, np.int64(smallest(line, 0, best - 2)))
            if best + 3 < count:
                second = min(second, np.int64(smallest(line, best + 3, count)))
            confidence[y, x] = second - np.int64(lowest)


@kernel
def bilinear(plane, x, y):
    """Interpolate a plane inside the image."""
    height, width = plane.shape
    x0, y0 = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - x0, y - y0
    upper = plane[y0, x0] + fx * (plane[y0, x0 + 1] - plane[y0, x0])
    lower = plane[y0 + 1, x0] + fx * (plane[y0 + 1, x0 + 1] - plane[y0 + 1, x0])
    return upper + fy * (lower - upper)


@kernel
def check_consistency(depth, other, there, back, tolerance, visibility):
    """Compare a depth map with that of another view: consistent, outside it, or occluded (or wrong)."""
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            u, v, _ = warp_point(there, x, y, depth[y, x])
            if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
                visibility[y, x] = OUTSIDE
                continue
            visibility[y, x] = OCCLUDED
            column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if abs(i - v) + abs(j - u) > 1.5:
                        continue
                    a, b, _ = warp_point(back, u, v, other[i, j])
                    if abs(a - x) + abs(b - y) <= tolerance:
                        visibility[y, x] = CONSISTENT
                        break


@kernel
def local_slopes(depth, reliable, wanted, radius, spacing, limit, slopes):
    """Slope (x, y) of the plane through the reliable neighbours of like depth, around each wanted point."""
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            slopes[y, x, 0] = 0.0
            slopes[y, x, 1] = 0.0
            if not wanted[y, x]:
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


@kernel
def fill_depth(depth, visibility, image, slopes, how, other, filled):
    """Continue the planes of reliable points in eight directions into what is not reliable."""
    sigma, reach, quantile = how
    values, weights = np.empty(8), np.empty(8)
    steps = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
    nearest = np.empty((8, *depth.shape), np.int32)
    edges = np.empty((8, *depth.shape))
    for direction in range(8):
        dy, dx = steps[direction]
        nearest_reliable(visibility, image, dy, dx, nearest[direction], edges[direction])
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            filled[y, x] = depth[y, x]
            if visibility[y, x] == CONSISTENT:
                continue
            count = 0
            for direction in range(8):
                distance = nearest[direction, y, x]
                if distance < 0:
                    continue
                dy, dx = steps[direction]
                i, j = y + distance * dy, x + distance * dx
                length = float(max(abs(i - y), abs(j - x)))
                slope = slopes[i, j, 0] * (x - j) + slopes[i, j, 1] * (y - i)
                values[count] = depth[i, j] + min(1.0, reach / length) * slope
                crossed = edges[direction, y, x] / sigma
                weights[count] = 1.0 / ((1.0 + crossed * crossed) * (length + 1.0))
                if is_transparent(other, x, y, values[count]):
                    weights[count] *= 0.001
                count += 1
            if count > 0:
                filled[y, x] = weighted_quantile(values, weights, count, quantile)


@kernel
def nearest_reliable(visibility, image, dy, dx, distance, edge):
    """Steps from each point to the nearest consistent one in a direction (-1: none), and the highest edge."""
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
def along_epipolar_lines(depth, epipole, far, near):
    """Farthest and nearest depth where the epipolar line through a hole leaves it; infinite if alone."""
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            if depth[y, x] > EMPTY:
                far[y, x] = near[y, x] = depth[y, x]
                continue
            dx, dy = epipole[0] - x * epipole[2], epipole[1] - y * epipole[2]
            length = max(abs(dx), abs(dy))
            found = 0
            for side in (-1.0, 1.0):
                k = 0
                while length > 0.0:
                    k += 1
                    i = int(np.floor(y + side * k * dy / length + 0.5))
                    j = int(np.floor(x + side * k * dx / length + 0.5))
                    if not (0 <= i < height and 0 <= j < width):
                        break
                    if depth[i, j] > EMPTY:
                        far[y, x] = min(far[y, x], depth[i, j]) if found else depth[i, j]
                        near[y, x] = max(near[y, x], depth[i, j]) if found else depth[i, j]
                        found += 1
                        break
            if found == 0:
                far[y, x] = near[y, x] = EMPTY
            if found < 2:
                near[y, x] = np.inf


@kernel
def nearest_drawn(holes, rows, columns):
    """Place of the nearest pixel that is no hole, for each pixel; not all may be holes."""
    height, width = holes.shape
    for x in range(width):
        above = -1
        for y in range(height):
            above = above if holes[y, x] else y
            rows[y, x] = above
        below = -1
        for y in range(height - 1, -1, -1):
            below = below if holes[y, x] else y
            if below >= 0 and (rows[y, x] < 0 or below - y < y - rows[y, x]):
                rows[y, x] = below
    kept, found = np.empty(width, np.int64), np.empty(width, np.int64)
    for y in range(height):
        last = -1
        for x in range(width):
            if rows[y, x] < 0:
                continue
            away = (rows[y, x] - y) ** 2
            while last >= 1:
                first, second = kept[last - 1], kept[last]
                left, right = second - first, x - second
                before, between = (rows[y, first] - y) ** 2, (rows[y, second] - y) ** 2
                both = left + right
                if both * between - right * before - left * away - left * right * both <= 0:
                    break
                last -= 1
            last += 1
            kept[last] = x
        here = 0
        for x in range(width):
            distance = (rows[y, kept[here]] - y) ** 2 + (kept[here] - x) ** 2
            while here < last:
                following = (rows[y, kept[here + 1]] - y) ** 2 + (kept[here + 1] - x) ** 2
                if distance <= following:
                    break
                distance = following
                here += 1
            columns[y, x] = kept[here]
            found[x] = rows[y, kept[here]]
        rows[y] = found


@kernel
def membrane_equations(number, depth, limit, image, stiffness, neighbours, diagonal, right):
    """Set up the Laplace equation in holes; what is drawn nearer than the limit does not bound them."""
    height, width = number.shape
    for y in range(height):
        for x in range(width):
            row = number[y, x]
            if row < 0:
                continue
            diagonal[row] = stiffness
            for side in range(4):
                i = y + (-1 if side == 0 else 1 if side == 1 else 0)
                j = x + (-1 if side == 2 else 1 if side == 3 else 0)
                neighbours[row, side] = -1
                if not (0 <= i < height and 0 <= j < width):
                    continue
                if number[i, j] >= 0:
                    neighbours[row, side] = number[i, j]
                    diagonal[row] += 1.0
                elif depth[i, j] <= limit[y, x]:
                    diagonal[row] += 1.0
                    for c in range(image.shape[2]):
                        right[c, row] += image[i, j, c]


@kernel
def membrane_product(neighbours, diagonal, levels, product):
    """Multiply levels by the matrix of the equations; return the product of that with the levels."""
    form = 0.0
    for row in range(levels.shape[0]):
        total = diagonal[row] * levels[row]
        for side in range(4):
            column = neighbours[row, side]
            if column >= 0:
                total -= levels[column]
        product[row] = total
        form += levels[row] * total
    return form


@kernel
def solve_membrane(neighbours, diagonal, right, tolerance, levels):
    """Solve the equations of one channel by conjugate gradients, from levels that are about right."""
    product = np.empty_like(levels)
    membrane_product(neighbours, diagonal, levels, product)
    residual = right - product
    direction = residual.copy()
    squared = float((residual * residual).sum())
    limit = tolerance * tolerance * levels.shape[0]
    for _ in range(10 * levels.shape[0]):
        if squared <= limit:
            break
        step = squared / membrane_product(neighbours, diagonal, direction, product)
        before, squared = squared, 0.0
        for row in range(levels.shape[0]):
            levels[row] += step * direction[row]
            residual[row] -= step * product[row]
            squared += residual[row] * residual[row]
        share = squared / before
        for row in range(levels.shape[0]):
            direction[row] = residual[row] + share * direction[row]


@kernel
def is_transparent(other, x, y, rho):
    """Tell whether another view looks through a point: sees something consistent behind it."""
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
def weighted_quantile(values, weights, count, quantile):
    """Value below which a share of the weight lies; sorts both arrays."""
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


@kernel
def visibility_weights(positions, depth, visibility, back, halo, tolerance, weights):
    """Weigh how well a view sees points (x, y, inverse depth in it): 1, edge, occluded or outside."""
    height, width = depth.shape
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            u, v, rho = positions[i, j, 0], positions[i, j, 1], positions[i, j, 2]
            weights[i, j] = OUTSIDE_WEIGHT
            if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
                continue
            a, b, _ = warp_point(back, u, v, rho)
            column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
            free, near = 0, 0
            for y in range(max(row - halo, 0), min(row + halo + 1, height)):
                for x in range(max(column - halo, 0), min(column + halo + 1, width)):
                    blocked = False
                    if depth[y, x] > rho and visibility[y, x] == CONSISTENT:
                        c, d, _ = warp_point(back, u, v, depth[y, x])
                        blocked = abs(c - a) + abs(d - b) > tolerance
                    if blocked:
                        near = 1
                    elif abs(y - row) <= 1 and abs(x - column) <= 1:
                        free += 1
            if free == 0:
                weights[i, j] = OCCLUDED_WEIGHT
            else:
                weights[i, j] = EDGE_WEIGHT if near else 1.0


@kernel
def _weights_of_neighbours(window, by_level, by_place):
    """Tabulate weights of differences of level, and of places in the window."""
    radius, levels, _, _ = window
    for difference in range(by_level.size):
        r = difference / levels
        by_level[difference] = 1.0 / ((1.0 + r * r) * (1.0 + r * r))
    for i in range(-radius, radius + 1):
        for j in range(-radius, radius + 1):
            by_place[i + radius, j + radius] = 1.0 / (1.0 + 2.0 * (i * i + j * j) / (radius * radius))


@kernel
def guided_median(depth, trust, image, chosen, window, other, median):
    """Replace the chosen depths by the median of every second neighbour, weighted by likeness of level."""
    radius, _, low, step = window
    height, width = depth.shape
    by_level, by_place = np.empty(256), np.empty((2 * radius + 1, 2 * radius + 1))
    _weights_of_neighbours(window, by_level, by_place)
    bins, sums, number = np.zeros(256), np.zeros(256), np.empty((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            number[y, x] = min(max(int((depth[y, x] - low) / step), 0), 255)
    for y in range(height):
        for x in range(width):
            median[y, x] = depth[y, x]
            if not chosen[y, x]:
                continue
            first = last = np.int64(number[y, x])
            total, level = 0.0, np.int64(image[y, x])
            left, right = max(x - radius, 0), min(x + radius + 1, width)
            for i in range(max(y - radius, 0), min(y + radius + 1, height)):
                for j in range(left + ((left + x + i + y) & 1), right, 2):
                    weight = trust[i, j] * by_level[abs(image[i, j] - level)]
                    weight *= by_place[i - y + radius, j - x + radius]
                    k = np.int64(number[i, j])
                    first, last = min(first, k), max(last, k)
                    bins[k] += weight
                    sums[k] += weight * depth[i, j]
                    total += weight
            reached, k = bins[first], first
            while reached < 0.5 * total and k < last:
                k += 1
                reached += bins[k]
            if bins[k] > 0.0:
                value = sums[k] / bins[k]
                if not is_transparent(other, x, y, value):
                    median[y, x] = value
            bins[first : last + 1] = 0.0
            sums[first : last + 1] = 0.0


@kernel
def rasterise_discontinuities(warp, depth, chosen, reach, nearest):
    """Draw the pieces of discontinuous cells: each at its own corner's depth, `reach` of a cell wide."""
    corners = np.empty((4, 3))
    for i in range(chosen.shape[0]):
        for j in range(chosen.shape[1]):
            if not chosen[i, j]:
                continue
            for k in range(4):
                y, x = i + k // 2, j + k % 2
                rho = depth[y, x]
                dy, dx = reach * (1 - 2 * (k // 2)), reach * (1 - 2 * (k % 2))
                top, bottom = y + min(0.0, dy), y + max(0.0, dy)
                left, right = x + min(0.0, dx), x + max(0.0, dx)
                for m in range(4):
                    u, v, w = warp_point(
                        warp, right if m % 2 == 1 else left, bottom if m // 2 == 1 else top, rho
                    )
                    corners[m, 0], corners[m, 1] = u, v
                    corners[m, 2] = rho / w if w >= 1e-6 else EMPTY
                rasterise_triangle(corners[0], corners[1], corners[2], nearest)
                rasterise_triangle(corners[3], corners[2], corners[1], nearest)


@kernel
def inside(x, y, width, height):
    """Tell whether bilinear interpolation has all it needs."""
    return 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0


@kernel
def block_cost(pair, hypotheses, block, spacing, limits, outside_cost, cost):
    """Compare two pictures along the epipolar lines through each block of a view, per hypothesis."""
    first, second, to_first, to_second = pair
    low, step = hypotheses
    height, width = first.shape[1:]
    for i in range(cost.shape[0]):
        for j in range(cost.shape[1]):
            left = (j + 0.5) * block - 0.5 - 1.5 * spacing
            top = (i + 0.5) * block - 0.5 - 1.5 * spacing
            for hypothesis in range(cost.shape[2]):
                total = 0.0
                rho = low + hypothesis * step
                for k in range(16):
                    x, y = left + (k % 4) * spacing, top + (k // 4) * spacing
                    a, b, _ = warp_point(to_first, x, y, rho)
                    c, d, _ = warp_point(to_second, x, y, rho)
                    if not (inside(a, b, width, height) and inside(c, d, width, height)):
                        total += outside_cost
                        continue
                    for m in range(3):
                        difference = bilinear(first[m], a, b) - bilinear(second[m], c, d)
                        total += min(abs(difference), limits[m])
                cost[i, j, hypothesis] = np.int16(total / 16.0)


@kernel
def block_error(pair, x, y, rho, half):
    """Mean squared difference of two pictures over a window around a point; huge where it leaves one."""
    first, second, to_first, to_second = pair
    height, width = first.shape
    total = 0.0
    for dy in range(-half, half + 1):
        for dx in range(-half, half + 1):
            a, b, _ = warp_point(to_first, x + dx, y + dy, rho)
            c, d, _ = warp_point(to_second, x + dx, y + dy, rho)
            if not (inside(a, b, width, height) and inside(c, d, width, height)):
                return 1e9
            difference = bilinear(first, a, b) - bilinear(second, c, d)
            total += difference * difference
    return total / ((2 * half + 1) * (2 * half + 1))


@kernel
def golden_search(pair, block, half, reach, min_px, count, depth):
    """Refine each block's inverse depth within `reach` by golden sections, where it moves enough."""
    golden = 0.6180339887498949
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            x, y, rho = (j + 0.5) * block - 0.5, (i + 0.5) * block - 0.5, depth[i, j]
            low, high = rho - reach, rho + reach
            if parallax(pair.to_first, pair.to_second, x, y, low, high) < min_px:
                continue
            start = block_error(pair, x, y, rho, half)
            a, b = high - golden * (high - low), low + golden * (high - low)
            at_a = block_error(pair, x, y, a, half)
            at_b = block_error(pair, x, y, b, half)
            for _ in range(count):
                if at_a <= at_b:
                    high, b, at_b = b, a, at_a
                    a = high - golden * (high - low)
                    at_a = block_error(pair, x, y, a, half)
                else:
                    low, a, at_a = a, b, at_b
                    b = low + golden * (high - low)
                    at_b = block_error(pair, x, y, b, half)
            if min(at_a, at_b) < start:
                depth[i, j] = a if at_a <= at_b else b


@kernel
def parallax(to_first, to_second, x, y, low, high):
    """How far a change of depth moves the point in one picture against the other, at most."""
    a, b, _ = warp_point(to_first, x, y, low)
    c, d, _ = warp_point(to_first, x, y, high)
    e, f, _ = warp_point(to_second, x, y, low)
    g, h, _ = warp_point(to_second, x, y, high)
    return abs(c - a) + abs(d - b) + abs(g - e) + abs(h - f)
