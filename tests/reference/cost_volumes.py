"""Plain twins of the kernels of cost volumes, written from their definitions; slow."""

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]


def census(grey: Floats, radius: int, dead_zone: float) -> NDArray[np.object_]:
    """Return the bits of each pixel's neighbours, row by row, as text."""
    padded = np.pad(grey, radius, mode="edge")
    reach = range(2 * radius + 1)
    bits = np.full(grey.shape, "", object)
    for y, x in np.ndindex(grey.shape):
        around = [
            padded[y + i, x + j] for i, j in itertools.product(reach, reach) if (i, j) != (radius, radius)
        ]
        bits[y, x] = "".join("1" if level < grey[y, x] - dead_zone else "0" for level in around)
    return bits


def hamming(first: str, second: str) -> int:
    """Return in how many bits two texts differ."""
    return sum(a != b for a, b in zip(first, second, strict=True))


def arms(
    image: NDArray[np.uint8], reach: int, near_reach: int, limit: int, far_limit: int
) -> NDArray[np.int64]:
    """Return how many pixels up, down, left and right belong to a pixel; one does in any case."""
    height, width = image.shape[:2]
    levels = image.astype(np.int64)
    lengths = np.zeros((height, width, 4), np.int64)
    for y, x in np.ndindex(height, width):
        for side, (dy, dx) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
            line = [(y + k * dy, x + k * dx) for k in range(reach)]
            line = [at for at in line if 0 <= at[0] < height and 0 <= at[1] < width]
            belongs = []
            for k in range(1, len(line)):
                whole = np.abs(levels[line[k]] - levels[y, x]).max()
                last = np.abs(levels[line[k]] - levels[line[k - 1]]).max()
                belongs.append(whole < limit and last < limit and (k <= near_reach or whole < far_limit))
            length = belongs.index(False) if False in belongs else len(belongs)
            lengths[y, x, side] = length
    return lengths


def cut(lengths: NDArray[np.int64], base: Labels, jump: int) -> NDArray[np.int64]:
    """Return arms that end at the border and where the base surface jumps."""
    shortened = np.zeros_like(lengths)
    for y, x, side in np.ndindex(lengths.shape):
        dy, dx = ((-1, 0), (1, 0), (0, -1), (0, 1))[side]
        for k in range(1, lengths[y, x, side] + 1):
            if not 0 <= y + k * dy < base.shape[0]:
                break
            if abs(base[y + k * dy, x + k * dx] - base[y + (k - 1) * dy, x + (k - 1) * dx]) > jump:
                break
            shortened[y, x, side] = k
    return shortened


def line_sums(volume: Floats, base: Labels, lengths: NDArray[np.int64], axis: int) -> Floats:
    """Return sums over the arms of rows (axis 1) or columns (0), labels counted from the base surface."""
    total = np.zeros(volume.shape)
    for y, x, k in np.ndindex(volume.shape):
        before, after = lengths[y, x, 2 * axis], lengths[y, x, 2 * axis + 1]
        for step in range(-before, after + 1):
            v, u = (y + step, x) if axis == 0 else (y, x + step)
            label = k - base[y, x] + base[v, u]
            if 0 <= label < volume.shape[2]:
                total[y, x, k] += volume[v, u, label]
    return total


def aggregate(
    cost: Floats, weight: Floats, lengths: NDArray[np.int64], base: Labels, iterations: int
) -> tuple[Floats, Floats]:
    """Return weighted means over cross-shaped regions, and the share of them that is known."""
    flat = np.zeros_like(base)
    for iteration in range(iterations):
        axes = (1, 0) if iteration % 2 == 0 else (0, 1)
        sums = [cost * weight, weight, np.ones((*base.shape, 1))]
        for axis in axes:
            sums = [
                line_sums(volume, surface, lengths, axis)
                for volume, surface in zip(sums, (base, base, flat), strict=True)
            ]
        cost = np.where(sums[1] > 0.0, sums[0] / np.where(sums[1] > 0.0, sums[1], 1.0), 0.0)
        weight = np.minimum(sums[1] / sums[2], 1.0)
    return cost, weight


def message(belief: Floats, strength: float, slope: float, limit: float, shift: int) -> Floats:
    """Return the least cost of each label of a neighbour, whose base surface is `shift` labels higher."""
    count = len(belief)
    sent = np.empty(count)
    for k in range(count):
        ways = [belief[j] + strength * min(slope * abs(k - shift - j), limit) for j in range(count)]
        sent[k] = min(ways)
    return sent - belief.min()


def jump_cost(first: int, second: int, rise: int, slope: float, limit: float) -> float:
    """Return what a change between two neighbours costs beyond the rise of the base surface."""
    return min(slope * abs(second - first - rise), limit)


def energy(
    cost: Floats,
    label: Labels,
    strengths: tuple[Floats, Floats],
    rises: tuple[Labels, Labels],
    slope: float,
    limit: float,
) -> float:
    """Return the energy of labels (2.13): strengths and rises of the edges to the right, and downwards."""
    total = float(np.take_along_axis(cost, label[:, :, None], axis=2).sum())
    for axis, strength, rise in zip((1, 0), strengths, rises, strict=True):
        steps = np.minimum(slope * np.abs(np.diff(label, axis=axis) - rise), limit)
        total += float((strength * steps).sum())
    return total


def viterbi(cost: Floats, strength: Floats, rise: Labels, slope: float, limit: float) -> tuple[Labels, float]:
    """Return the best labels of a chain, costs (pixels, labels), and their energy."""
    length, count = cost.shape
    best = cost[0]
    origins = []
    for n in range(1, length):
        ways = np.array(
            [
                [best[j] + strength[n - 1] * jump_cost(j, k, rise[n - 1], slope, limit) for j in range(count)]
                for k in range(count)
            ]
        )
        origins.append(ways.argmin(axis=1))
        best = ways.min(axis=1) + cost[n]
    label = [int(best.argmin())]
    for origin in reversed(origins):
        label.append(int(origin[label[-1]]))
    return np.array(label[::-1]), float(best.min())
