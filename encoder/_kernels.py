"""Compiled loops of block matching; validated and described by their callers.

Images are uint8 arrays [row, column]; points are (x, y). A block of half side h has (2h + 1)^2 samples.
"""

import numpy as np

from dvc._jit import kernel

UNKNOWN = np.int64(1) << 40

# ---- blocks ----


@kernel
def cut_blocks(image, points, blocks):
    """Copy the block around each point; what lies outside the image repeats its border."""
    height, width = image.shape
    half = blocks.shape[1] // 2
    for i in range(points.shape[0]):
        for row in range(blocks.shape[1]):
            y = min(max(points[i, 1] - half + row, 0), height - 1)
            for column in range(blocks.shape[2]):
                x = min(max(points[i, 0] - half + column, 0), width - 1)
                blocks[i, row, column] = image[y, x]


@kernel
def min_shift_sads(image, points, blocks, shift, min_sads, counts):
    """Smallest SAD of each block against itself, moved to the left, right, up and down; inside the image.

    `counts` adds up blocks compared and samples compared.
    """
    half = blocks.shape[1] // 2
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        min_sads[i] = block_sad(image, x - shift, y, half, blocks[i], UNKNOWN, counts)
        for dx, dy in ((shift, 0), (0, -shift), (0, shift)):
            min_sads[i] = min(
                min_sads[i], block_sad(image, x + dx, y + dy, half, blocks[i], min_sads[i], counts)
            )


@kernel
def median_motion(velocity, alive, median):
    """Median of each component over the live points, of which there is at least one."""
    for axis in range(2):
        ordered = np.sort(velocity[alive, axis])
        median[axis] = ordered[ordered.size // 2]


@kernel
def block_sad(image, x, y, half, block, limit, counts):
    """Sum of absolute differences; stops after the row that reaches `limit`; `UNKNOWN` off the image.

    `counts` adds up blocks compared and samples compared.
    """
    height, width = image.shape
    if x < half or y < half or x >= width - half or y >= height - half:
        return UNKNOWN
    total, side, rows = np.int64(0), 2 * half + 1, 0
    while rows < side and total < limit:
        samples = image[y - half + rows, x - half : x + half + 1]
        line = np.int32(0)
        for column in range(side):
            line += abs(np.int32(samples[column]) - np.int32(block[rows, column]))
        total += line
        rows += 1
    counts[0] += 1
    counts[1] += rows * side
    return total


@kernel
def is_within(image, x, y, margin):
    """Tell whether a point is so far inside the image that all places around it can be compared."""
    height, width = image.shape
    return margin <= x < width - margin and margin <= y < height - margin


@kernel
def descend(image, x, y, half, block, sad, max_steps, counts):
    """Follow the least SAD among the eight neighbours to a local minimum; return it and its SAD."""
    from_x, from_y = 0, 0
    for _ in range(max_steps):
        best, step_x, step_y = sad, 0, 0
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                # What the last step has left behind was compared before it.
                seen = (from_x != 0 or from_y != 0) and max(abs(dx + from_x), abs(dy + from_y)) <= 1
                if (dx == 0 and dy == 0) or seen:
                    continue
                found = block_sad(image, x + dx, y + dy, half, block, best, counts)
                if found < best:
                    best, step_x, step_y = found, dx, dy
        if step_x == 0 and step_y == 0:
            break
        x, y, sad, from_x, from_y = x + step_x, y + step_y, best, step_x, step_y
    return x, y, sad


@kernel
def spiral_search(image, x, y, half, block, small, spiral, counts):
    """Compare along a spiral until the first small SAD; return where the least one is, and that SAD."""
    best, best_x, best_y = UNKNOWN, x, y
    for k in range(spiral.shape[0]):
        at_x, at_y = x + spiral[k, 0], y + spiral[k, 1]
        sad = block_sad(image, at_x, at_y, half, block, best, counts)
        if sad < best:
            best, best_x, best_y = sad, at_x, at_y
            if best <= small:
                break
    return best_x, best_y, best


# ---- tracks ----


@kernel
def nearest_found(first, found, i):
    """Return which of the points found already in this frame started nearest to point `i`; -1 if none."""
    min_distance, nearest = UNKNOWN, -1
    for j in range(found.size):
        if found[j]:
            distance = (first[i, 0] - first[j, 0]) ** 2 + (first[i, 1] - first[j, 1]) ** 2
            if distance < min_distance:
                min_distance, nearest = distance, j
    return nearest


@kernel
def best_candidate(image, half, block, candidates, counts):
    """Compare a block at several places; return the first of least SAD, and that SAD."""
    best, best_x, best_y = UNKNOWN, candidates[0, 0], candidates[0, 1]
    for k in range(candidates.shape[0]):
        seen = False
        for j in range(k):
            if candidates[j, 0] == candidates[k, 0] and candidates[j, 1] == candidates[k, 1]:
                seen = True
        if not seen:
            sad = block_sad(image, candidates[k, 0], candidates[k, 1], half, block, best, counts)
            if sad < best:
                best, best_x, best_y = sad, candidates[k, 0], candidates[k, 1]
    return best_x, best_y, best


@kernel
def coarse_to_fine_search(
    image, quarter, block, quarter_block, last_x, last_y, spiral, quarter_spiral, counts
):
    """Search in images of a quarter of the size, then around what was found there."""
    x, y, sad = spiral_search(
        quarter,
        (last_x + 2) // 4,
        (last_y + 2) // 4,
        quarter_block.shape[0] // 2,
        quarter_block,
        -1,
        quarter_spiral,
        counts,
    )
    if sad < UNKNOWN:
        x, y, sad = spiral_search(image, 4 * x, 4 * y, block.shape[0] // 2, block, -1, spiral, counts)
    return x, y, sad


@kernel
def track_frame(
    image,
    blocks,
    small,
    first,
    last,
    velocity,
    alive,
    spiral,
    quarter,
    quarter_blocks,
    quarter_spiral,
    max_coarse_searches,
    position,
    sads,
    found,
    counts,
):
    """Find each live point in a frame; `position`, `sads` and `found` receive what came of it.

    `small` bounds the SAD of a point that is found. `last` and `velocity` are positions in the frame before
    and the motion into it. Points that are `found` already show the others where to look. Coarse-to-fine
    searches are for points whose neighbours do not tell the motion. A minimum at the border of the image is
    none: it may go on outside.
    """
    half = blocks.shape[1] // 2
    candidates = np.empty((3, 2), np.int64)
    coarse_searches = 0
    for i in range(alive.size):
        if found[i] or not alive[i]:
            continue
        j = nearest_found(first, found, i)
        for axis in range(2):
            candidates[0, axis] = last[i, axis]
            candidates[1, axis] = last[i, axis] + velocity[i, axis]
            motion = velocity[i, axis] if j < 0 else position[j, axis] - last[j, axis]
            candidates[2, axis] = last[i, axis] + motion
        x, y, sad = best_candidate(image, half, blocks[i], candidates, counts)
        if sad > small[i] and j >= 0 and not is_within(image, candidates[2, 0], candidates[2, 1], half):
            continue  # it has left with its neighbours
        if sad > small[i]:
            x, y, sad = spiral_search(image, x, y, half, blocks[i], small[i], spiral, counts)
        if sad < UNKNOWN:
            x, y, sad = descend(image, x, y, half, blocks[i], sad, spiral.shape[0], counts)
        if sad > small[i] and coarse_searches < max_coarse_searches:
            coarse_searches += 1
            x, y, sad = coarse_to_fine_search(
                image,
                quarter,
                blocks[i],
                quarter_blocks[i],
                last[i, 0],
                last[i, 1],
                spiral[:49],
                quarter_spiral,
                counts,
            )
            if sad < UNKNOWN:
                x, y, sad = descend(image, x, y, half, blocks[i], sad, spiral.shape[0], counts)
        found[i] = sad <= small[i] and is_within(image, x, y, half + 1)
        position[i, 0], position[i, 1], sads[i] = x, y, sad


@kernel
def subpixel_offsets(image, blocks, position, alive, sads, counts, offsets):
    """Place the minimum between pixels, where the two sides of a V through three SADs meet."""
    half = blocks.shape[1] // 2
    for i in range(alive.size):
        if not alive[i]:
            continue
        x, y = position[i, 0], position[i, 1]
        for axis in range(2):
            dx, dy = 1 - axis, axis
            before = block_sad(image, x - dx, y - dy, half, blocks[i], UNKNOWN, counts)
            after = block_sad(image, x + dx, y + dy, half, blocks[i], UNKNOWN, counts)
            steepest = max(before, after) - sads[i]
            offsets[i, axis] = 0.0
            if max(before, after) < UNKNOWN and min(before, after) >= sads[i] and steepest > 0:
                offsets[i, axis] = 0.5 * (before - after) / steepest
