"""Compiled loops of block matching; validated and described by their callers.

Images are uint8 arrays [row, column]; points are (x, y). A block of half side h has (2h + 1)^2 samples. All
of them are compared: to stop early takes longer than vectors of samples do. Half sides are constants where
kernels are called, so that there are no loops around these vectors.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel

UNKNOWN = np.int64(1) << 40
_AROUND = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if x or y])

HALF_BLOCK_PX = 5
QUARTER_HALF_BLOCK_PX = 4
"""Half sides of blocks, in images of full size and of a quarter of it."""
SAMPLED_PX = 8
"""Side of the blocks that are interpolated."""
NUM_NEAREST, NEAR_PX2 = 3, 16.0
"""Number of points that blend their motion, and squared distance of points with half the largest weight."""


class Matching(NamedTuple):
    """Blocks of a key frame, and an image to search for them."""

    image: NDArray[np.uint8]
    blocks: NDArray[np.uint8]
    counts: NDArray[np.int64]  # blocks compared, and samples of these


class Points(NamedTuple):
    """Points of a key frame."""

    first: NDArray[np.int64]  # positions in the key frame
    small: NDArray[np.int64]  # largest SAD of a match of each


class Movement(NamedTuple):
    """Motion of points up to the last frame."""

    last: NDArray[np.int64]
    velocity: NDArray[np.int64]
    alive: NDArray[np.bool_]


class Matches(NamedTuple):
    """Results of a search for points in a frame."""

    position: NDArray[np.int64]
    sads: NDArray[np.int64]
    adjacent: NDArray[np.int64]  # SADs to the left, right, above and below
    matched: NDArray[np.bool_]


@kernel
def cut_blocks(image, points, blocks):
    """Copy the block around each point; outside the image its border is repeated."""
    height, width = image.shape
    half = blocks.shape[1] // 2
    for i in range(points.shape[0]):
        for row in range(blocks.shape[1]):
            y = min(max(points[i, 1] - half + row, 0), height - 1)
            for column in range(blocks.shape[2]):
                x = min(max(points[i, 0] - half + column, 0), width - 1)
                blocks[i, row, column] = image[y, x]


@kernel
def min_shift_sads(matching, points, shift, min_sads):
    """Compute the smallest SAD of each block against itself, moved in four directions inside the image."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        min_sads[i] = UNKNOWN
        for k in range(4):
            moved = shift if k % 2 else -shift
            at_x, at_y = (x + moved, y) if k < 2 else (x, y + moved)
            min_sads[i] = min(min_sads[i], block_sad(matching, at_x, at_y, HALF_BLOCK_PX, i))


@inlined_kernel
def block_sad(matching, x, y, half, i):
    """Return the sum of absolute differences (SAD) of block `i` at a position; `UNKNOWN` off the image."""
    image, blocks, counts = matching
    if not is_within(image, x, y, half):
        return UNKNOWN
    side = 2 * half + 1
    total = np.int32(0)
    for column in range(8):
        mask = np.uint8(255) if column >= 16 - side else np.uint8(0)
        for row in range(side):
            at_x, at_y = np.uintp(x - half + column), np.uintp(y - half + row)
            sample, late = image[at_y, at_x], image[at_y, np.uintp(x + half - 7 + column)] & mask
            template, template_late = blocks[i, row, column], blocks[i, row, side - 8 + column] & mask
            total = np.int32(total + abs(np.int32(np.int32(sample) - np.int32(template))))
            total = np.int32(total + abs(np.int32(np.int32(late) - np.int32(template_late))))
    counts[0] += 1
    counts[1] += side * side
    return np.int64(total)


@inlined_kernel
def is_within(image, x, y, margin):
    """Return whether a point has at least this distance from the border of the image."""
    height, width = image.shape
    return margin <= x < width - margin and margin <= y < height - margin


@inlined_kernel
def descend(matching, x, y, i, sad, max_steps, around):
    """Follow the least SAD among the eight neighbours to a local minimum; return it and its SAD."""
    for step in range(max_steps + 1):
        best, step_x, step_y = sad, 0, 0
        for k in range(8):
            dx, dy = _AROUND[k, 0], _AROUND[k, 1]
            neighbour = block_sad(matching, x + dx, y + dy, HALF_BLOCK_PX, i)
            around[k] = neighbour
            if neighbour < best:
                best, step_x, step_y = neighbour, dx, dy
        if (step_x == 0 and step_y == 0) or step == max_steps:
            break
        x, y, sad = x + step_x, y + step_y, best
    return x, y, sad


@inlined_kernel
def spiral_search(matching, x, y, half, i, small, spiral):
    """Compare along a spiral until the first small SAD; return the position of the least SAD, and it."""
    best, best_x, best_y = UNKNOWN, x, y
    for k in range(spiral.shape[0]):
        at_x, at_y = x + spiral[k, 0], y + spiral[k, 1]
        sad = block_sad(matching, at_x, at_y, half, i)
        if sad < best:
            best, best_x, best_y = sad, at_x, at_y
            if best <= small:
                break
    return best_x, best_y, best


@kernel
def move_as_nearest(points, ends, squares, velocity):
    """Compute squared distances of points from the nearest track, and its last motion back in time."""
    count = points.shape[0]
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    nearest = np.full(count, -1)
    squares[:] = np.inf
    for j in range(ends.shape[0]):
        at_x, at_y = ends[j, 1, 0], ends[j, 1, 1]
        for i in range(count):
            square = (x[i] - at_x) * (x[i] - at_x) + (y[i] - at_y) * (y[i] - at_y)
            nearest[i] = j if square < squares[i] else nearest[i]
            squares[i] = square if square < squares[i] else squares[i]
    for i in range(count):
        for axis in range(2):
            velocity[i, axis] = 0
            if nearest[i] >= 0:
                velocity[i, axis] = np.int64(np.rint(ends[nearest[i], 0, axis] - ends[nearest[i], 1, axis]))


@inlined_kernel
def offer_motion(first_x, first_y, j, begin, nearest_match):
    """Enter the match of point `j` as the nearest one of points from `begin` on that it is closest to."""
    for k in range(begin, nearest_match.size):
        i = np.uintp(k)
        dx, dy = np.int32(first_x[i] - first_x[j]), np.int32(first_y[i] - first_y[j])
        square = np.int32(np.int32(dx * dx) + np.int32(dy * dy))
        nearest_match[i] = min(nearest_match[i], (np.int64(square) << 20) + j)


@inlined_kernel
def best_candidate(matching, i, candidates):
    """Compare a block at several positions; return the first with the least SAD, and that SAD."""
    best, best_x, best_y = UNKNOWN, candidates[0, 0], candidates[0, 1]
    for k in range(candidates.shape[0]):
        x, y, seen = candidates[k, 0], candidates[k, 1], False
        for j in range(k):
            seen |= candidates[j, 0] == x and candidates[j, 1] == y
        if not seen:
            sad = block_sad(matching, x, y, HALF_BLOCK_PX, i)
            if sad < best:
                best, best_x, best_y = sad, x, y
    return best_x, best_y, best


@kernel
def coarse_to_fine_search(matching, quarter, i, last, spirals, around):
    """Search in images of a quarter of the size, then around the result, and descend to a local minimum."""
    x, y, half = (last[i, 0] + 2) // 4, (last[i, 1] + 2) // 4, QUARTER_HALF_BLOCK_PX
    x, y, sad = spiral_search(quarter, x, y, half, i, -1, spirals[1])
    if sad < UNKNOWN:
        x, y, sad = spiral_search(matching, 4 * x, 4 * y, HALF_BLOCK_PX, i, -1, spirals[0][:49])
    if sad < UNKNOWN:
        x, y, sad = descend(matching, x, y, i, sad, spirals[0].shape[0], around)
    return x, y, sad


@kernel
def track_frame(matching, quarter, points, movement, spirals, max_coarse_searches, search):
    """Search for each live point in a frame, and return the number of matches."""
    image, (first, small), (last, velocity, alive) = matching.image, points, movement
    position, sads, adjacent, matched = search
    candidates = np.empty((3, 2), np.int64)
    around = np.empty(8, np.int64)
    first_x, first_y = first[:, 0].astype(np.int32), first[:, 1].astype(np.int32)
    nearest_match = np.full(matched.size, UNKNOWN << 20)  # nearest matched point, by distance and number
    for j in range(matched.size):
        if matched[j]:
            offer_motion(first_x, first_y, j, 0, nearest_match)
    num_matched, coarse_searches = np.int64(matched.sum()), 0
    for i in range(alive.size):
        if matched[i] or not alive[i]:
            continue
        has_neighbour = nearest_match[i] < UNKNOWN << 20
        j = nearest_match[i] & (1 << 20) - 1
        for axis in range(2):
            candidates[0, axis] = last[i, axis]
            candidates[1, axis] = last[i, axis] + velocity[i, axis]
            motion = position[j, axis] - last[j, axis] if has_neighbour else velocity[i, axis]
            candidates[2, axis] = last[i, axis] + motion
        x, y, sad = best_candidate(matching, i, candidates)
        if sad > small[i]:
            if has_neighbour and not is_within(image, candidates[2, 0], candidates[2, 1], HALF_BLOCK_PX):
                continue  # it has left with its neighbours
            x, y, sad = spiral_search(matching, x, y, HALF_BLOCK_PX, i, small[i], spirals[0])
        if sad < UNKNOWN:
            x, y, sad = descend(matching, x, y, i, sad, spirals[0].shape[0], around)
        if sad > small[i] and coarse_searches < max_coarse_searches:
            coarse_searches += 1
            x, y, sad = coarse_to_fine_search(matching, quarter, i, last, spirals, around)
        position[i, 0], position[i, 1], sads[i] = x, y, sad
        if sad <= small[i] and is_within(image, x, y, HALF_BLOCK_PX + 1):
            matched[i] = True
            num_matched += 1
            for k in range(4):
                adjacent[i, k] = around[(3, 4, 1, 6)[k]]
            offer_motion(first_x, first_y, i, i + 1, nearest_match)
    return num_matched


@kernel
def finish_frame(points, last, search, scale, velocity, path):
    """Set `velocity` and `path` (N, 2), nan for lost points; return the largest squared path."""
    (first, _), (position, sads, adjacent, matched) = points, search
    longest = 0
    for i in range(matched.size):
        square = 0
        for axis in range(2):
            velocity[i, axis] = position[i, axis] - last[i, axis]
            moved = position[i, axis] - first[i, axis]
            square += moved * moved
            path[i, axis] = np.nan
            if matched[i]:
                offset, before, after = 0.0, adjacent[i, 2 * axis], adjacent[i, 2 * axis + 1]
                steepest = max(before, after) - sads[i]
                if scale > 1.0 and min(before, after) >= sads[i] and steepest > 0:
                    offset = 0.5 * (before - after) / steepest  # the tip of a V through three SADs
                path[i, axis] = np.rint((position[i, axis] + offset) * scale) / scale
        longest = max(longest, square if matched[i] else 0)
    return longest


@kernel
def follow(
    matching, quarter, points, movement, spirals, max_coarse_searches, least, search, scale, velocity, path
):
    """Search for points without a match; finish the frame if `least` points have one; return both results."""
    num_matched = track_frame(matching, quarter, points, movement, spirals, max_coarse_searches, search)
    if num_matched < least:
        return num_matched, 0
    return num_matched, finish_frame(points, movement.last, search, scale, velocity, path)


@inlined_kernel
def sample_at(image, x, y):
    """Interpolate an image bilinearly at a position; borders are repeated."""
    height, width = image.shape
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    left, above = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    right, below = min(left + 1, width - 1), min(above + 1, height - 1)
    x, y = x - left, y - above
    upper = (1.0 - x) * image[above, left] + x * image[above, right]
    lower = (1.0 - x) * image[below, left] + x * image[below, right]
    return (1.0 - y) * upper + y * lower


@kernel
def blended_motion(x, y, positions, motion):
    """Blend the motion of the points nearest to a position, from the first instant to each later one."""
    nearest, squares = np.full(NUM_NEAREST, -1), np.full(NUM_NEAREST, np.inf)
    for i in range(positions.shape[0]):
        square, number = (positions[i, 0, 0] - x) ** 2 + (positions[i, 0, 1] - y) ** 2, i
        for rank in range(NUM_NEAREST):
            if square < squares[rank]:
                squares[rank], square = square, squares[rank]
                nearest[rank], number = number, nearest[rank]
    motion[:] = 0.0
    total = 0.0
    for rank in range(NUM_NEAREST):
        if nearest[rank] >= 0:
            weight = 1.0 / (squares[rank] + NEAR_PX2)
            total += weight
            for instant in range(motion.shape[0]):
                for axis in range(2):
                    moved = positions[nearest[rank], instant + 1, axis] - positions[nearest[rank], 0, axis]
                    motion[instant, axis] += weight * moved
    if total > 0.0:
        for instant in range(motion.shape[0]):
            for axis in range(2):
                motion[instant, axis] /= total


@kernel
def interpolation_error(frame, before, after, positions, spacing):
    """Compute the mean squared difference of blocks of a frame from two frames moved as nearby points."""
    height, width = frame.shape
    motion = np.empty((2, 2))
    total, count = 0.0, 0
    for top in range(0, height - SAMPLED_PX + 1, spacing):
        for left in range(0, width - SAMPLED_PX + 1, spacing):
            blended_motion(left + 0.5 * SAMPLED_PX, top + 0.5 * SAMPLED_PX, positions, motion)
            for y in range(top, top + SAMPLED_PX):
                for x in range(left, left + SAMPLED_PX):
                    first = sample_at(before, x + motion[0, 0], y + motion[0, 1])
                    second = sample_at(after, x + motion[1, 0], y + motion[1, 1])
                    error = frame[y, x] - 0.5 * (first + second)
                    total += error * error
            count += SAMPLED_PX * SAMPLED_PX
    return total / max(count, 1), count // (SAMPLED_PX * SAMPLED_PX)
