"""Inference of one label for each pixel from a cost volume, smooth except at discontinuities.

[Felzenszwalb2006] "Efficient belief propagation for early vision", Int. J. Comput. Vis. 70(1);
[Hirschmuller2008] "Stereo processing by semiglobal matching and mutual information", IEEE PAMI 30(2).
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers, Singles

Volume = Singles
Labels = Integers

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
UNREACHED = 20000
"""Cost before the first and after the last hypothesis: above all sums of a path, below 2^15."""
UNITS = 100.0
"""Integer steps in a cost of 1."""


class Inferred(NamedTuple):
    """Labels of all pixels."""

    label: Labels  # the best one
    offset: Singles  # position of the smallest cost between its neighbours, from -0.5 to 0.5

    def rows(self, rows: slice) -> "Inferred":
        """Return some rows."""
        return Inferred(self.label[rows], self.offset[rows])


class Inference(Protocol):
    """Chooses labels of small cost that are smooth except at discontinuities (2.13)."""

    def infer(self, cost: Volume, image: Bytes, base: Labels, origin: Labels) -> Inferred:
        """Choose labels.

        Parameters
        ----------
        cost : ndarray of shape (rows, columns, labels), float32
            Cost of each label, from 0 to about 2.
        image : ndarray of shape (rows, columns, 3), uint8
            Picture; jumps across its edges are cheap.
        base : ndarray of shape (rows, columns), int64
            Labels of a base surface; methods may let its slopes cost nothing.
        origin : ndarray of shape (rows, columns), int64
            Label of the first cost of each pixel.

        Returns
        -------
        Inferred
            Labels.
        """


def semi_global(
    cost: NDArray[np.int16], guide: Bytes, small_jump: int, large_jump: int
) -> tuple[Floats, Floats]:
    """Choose hypotheses with small cost and few jumps, by dynamic programming along eight scanlines."""
    columns, count = cost.shape[1:]
    total = np.zeros(cost.shape, np.int16)
    levels, jumps = guide.astype(np.float32), (small_jump, large_jump)
    for direction in DIRECTIONS:
        lines = np.full((2, columns, count + 3), UNREACHED, np.int16)
        _aggregate_path(cost, levels, *direction, *jumps, lines[0], lines[1], total)
    return _best_hypothesis(total)


@kernel
def _aggregate_path(cost, image, dy, dx, small, large, previous, current, total):
    """Add the costs of the best paths to each pixel along one direction (semi-global matching)."""
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
def _best_hypothesis(total: NDArray[np.int16]) -> tuple[Floats, Floats]:
    """Choose the hypothesis of smallest cost, refined by a parabola through its neighbours; its lead, too."""
    height, width, count = total.shape
    hypothesis, confidence = np.empty((height, width)), np.empty((height, width))
    for y in range(height):
        for x in range(width):
            line = total[y, x]
            lowest = _smallest_of(line, np.int64(0), count)
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
                second = min(second, np.int64(_smallest_of(line, np.int64(0), best - 2)))
            if best + 3 < count:
                second = min(second, np.int64(_smallest_of(line, best + 3, count)))
            confidence[y, x] = second - np.int64(lowest)
    return hypothesis, confidence


@kernel
def _smallest_of(line, first, end):
    """Return the smallest entry of a range."""
    lowest = line[first]
    for k in range(first + 1, end):
        lowest = min(lowest, line[k])
    return lowest


@dataclass(frozen=True)
class SemiGlobal:
    """Dynamic programming along eight scanlines: fast, and even if costs are uncertain."""

    small_jump: float = 0.3  # cost of a change by one label, and of a larger one between equal levels
    large_jump: float = 2.0

    def infer(self, cost: Volume, image: Bytes, base: Labels, origin: Labels) -> Inferred:
        """Choose labels; see `Inference`. The base surface is ignored: even surfaces cost nothing."""
        del base
        small, large = round(self.small_jump * UNITS), round(self.large_jump * UNITS)
        red, green, blue = np.moveaxis(image.astype(np.int64), 2, 0)
        luma = ((299 * red + 587 * green + 114 * blue + 500) // 1000).astype(np.uint8)
        hypothesis, _ = semi_global((cost * UNITS).astype(np.int16), luma, small, large)
        label = np.floor(hypothesis + 0.5).astype(np.int64)
        return Inferred(label + origin, (hypothesis - label).astype(np.float32))


@dataclass(frozen=True)
class BeliefPropagation:
    """Inference by messages between neighbours, from coarse grids to fine ones."""

    slope: float = 0.2  # cost of a change by one label, and its limit: alpha and beta of (2.13)
    limit: float = 0.6
    max_jump: int = 2  # labels by which a base surface may change from pixel to pixel at no cost
    # smoothness falls with ``exp(-difference / edge_levels)`` of colours, down to `edge_strength`
    edge_levels: float = 5.0
    edge_strength: float = 0.05
    iterations: int = 3  # rounds of messages on each grid, and number of grids
    levels: int = 5

    def infer(self, cost: Volume, image: Bytes, base: Labels, origin: Labels) -> Inferred:
        """Choose labels; see `Inference`."""
        # grids from fine to coarse: costs, strengths and rises of the base surface to the right and down
        smoothness, rises = [], []
        for axis in (1, 0):
            difference = np.abs(np.diff(image.astype(np.float32), axis=axis)).max(axis=2)
            falling = (1.0 - self.edge_strength) * np.exp(-difference / np.float32(self.edge_levels))
            smoothness.append((self.edge_strength + falling).astype(np.float32))
            rise = np.diff(base, axis=axis)
            rises.append(np.where(np.abs(rise) > self.max_jump, 0, rise) - np.diff(origin, axis=axis))
        (across, down), coarsest = smoothness, cost
        grids = [(cost, across, down, rises[0], rises[1])]
        while len(grids) < self.levels and min(coarsest.shape[:2]) > 1:
            rows, columns = (coarsest.shape[0] + 1) // 2, (coarsest.shape[1] + 1) // 2
            coarse = np.zeros((rows, columns, coarsest.shape[2]), np.float32)
            for dy, dx in np.ndindex(2, 2):
                part = coarsest[dy::2, dx::2]
                coarse[: part.shape[0], : part.shape[1]] += part
            coarsest = coarse
            across = np.ascontiguousarray(across[::2, 1::2][:, : columns - 1])
            down = np.ascontiguousarray(down[1::2, ::2][: rows - 1])
            flat = np.zeros(across.shape, np.int64), np.zeros(down.shape, np.int64)
            grids.append((coarsest, across, down, *flat))
        messages = [np.zeros(grids[-1][0].shape, np.float32) for _ in range(4)]
        slope, limit = np.float32(self.slope), np.float32(self.limit)
        for level, (costs, across, down, rise_x, rise_y) in reversed(list(enumerate(grids))):
            if level < len(grids) - 1:
                rows, columns = (np.arange(size) // 2 for size in costs.shape[:2])
                messages = [message[rows[:, None], columns] for message in messages]
            up, downwards, left, right = messages
            for turn in range(self.iterations):
                strengths, parity = (across, down, rise_x, rise_y), (turn + level) % 2
                _exchange(costs, *strengths, up, downwards, left, right, slope, limit, parity)
        total = cost.copy()
        for message in messages:
            total += message
        return chosen(total, origin)


@kernel
def _exchange(cost, across, down, rise_x, rise_y, up, downwards, left, right, slope, limit, parity):
    """Send messages from every second pixel to its four neighbours."""
    height, width, count = cost.shape
    work = _message_space(count, slope, limit)
    for y in range(height):
        for x in range((y + parity) % 2, width, 2):
            here = cost[y, x]
            a, b, c, d = up[y, x], downwards[y, x], left[y, x], right[y, x]
            if y > 0:
                rise = -rise_y[y - 1, x]
                _send(here, a, c, d, down[y - 1, x], slope, limit, rise, up[y - 1, x], work)
            if y < height - 1:
                _send(here, b, c, d, down[y, x], slope, limit, rise_y[y, x], downwards[y + 1, x], work)
            if x > 0:
                rise = -rise_x[y, x - 1]
                _send(here, a, b, c, across[y, x - 1], slope, limit, rise, left[y, x - 1], work)
            if x < width - 1:
                _send(here, a, b, d, across[y, x], slope, limit, rise_x[y, x], right[y, x + 1], work)


@kernel
def _send(cost, first, second, third, strength, slope, limit, shift, message, work):
    """Send a message under truncated linear smoothness to a neighbour with a base `shift` labels higher."""
    count = cost.shape[0]
    margin = (work.shape[1] - count) // 2
    beliefs, other = work[0, margin : margin + count], 1
    for k in range(count):
        beliefs[k] = cost[k] + first[k] + second[k] + third[k]
    lowest = _smallest(beliefs)
    step, highest = slope * strength, lowest + limit * strength
    distance = 1
    while distance <= margin:
        # this step covers all distances below twice this one
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
def _smallest(values):
    """Return the smallest of some numbers, by four independent minima for speed."""
    a = b = c = d = values[0]
    quarters = values.shape[0] // 4
    for m in range(quarters):
        a, b = min(a, values[4 * m]), min(b, values[4 * m + 1])
        c, d = min(c, values[4 * m + 2]), min(d, values[4 * m + 3])
    for k in range(4 * quarters, values.shape[0]):
        a = min(a, values[k])
    return min(a, b, c, d)


@kernel
def _message_space(count, slope, limit):
    """Return the work space of `_send`: two lines of labels between infinite costs up to the limit."""
    margin = 1
    while 2 * margin < count and 2 * margin * slope <= limit:
        margin *= 2
    return np.full((2, count + 2 * margin), np.inf, np.float32)


@kernel
def chosen(total: Volume, origin: Labels) -> Inferred:
    """Choose the label of smallest cost, and the offset of the minimum of a parabola from it."""
    height, width, count = total.shape
    label, offset = np.empty((height, width), np.int64), np.zeros((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            best = 0
            for k in range(1, count):
                if total[y, x, k] < total[y, x, best]:
                    best = k
            label[y, x] = best + origin[y, x]
            if 0 < best < count - 1:
                before = total[y, x, best - 1] - total[y, x, best]
                after = total[y, x, best + 1] - total[y, x, best]
                if max(before, after) > 0.0:
                    offset[y, x] = 0.5 * (before - after) / max(before, after)
    return Inferred(label, offset)
