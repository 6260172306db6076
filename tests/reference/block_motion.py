"""Plain twins of the block-motion kernels: every candidate tried in full, in the order that decides ties."""

import numpy as np
from numpy.typing import NDArray

Planes = NDArray[np.uint8]


def sample_at(plane: NDArray[np.uint8], row: int, column: int) -> int:
    """Return a sample at a position in quarter samples: the mean of its two neighbours, down then across."""
    if row % 4 in (0, 2) and column % 4 in (0, 2):
        return half_sample(plane, row // 2, column // 2)
    if row % 2 == 0:
        return (sample_at(plane, row, column - 1) + sample_at(plane, row, column + 1) + 1) // 2
    if column % 2 == 0:
        return (sample_at(plane, row - 1, column) + sample_at(plane, row + 1, column) + 1) // 2
    left = sample_at(plane, row - 1, column - 1) + sample_at(plane, row + 1, column - 1) + 1
    right = sample_at(plane, row - 1, column + 1) + sample_at(plane, row + 1, column + 1) + 1
    return (left // 2 + right // 2 + 1) // 2


def half_sample(plane: NDArray[np.uint8], row: int, column: int) -> int:
    """Return the sample at a position in half samples: six taps in each direction that is not whole."""
    taps = (1, -5, 20, 20, -5, 1)

    def whole(y: int, x: int) -> int:
        return int(plane[min(max(y, 0), plane.shape[0] - 1), min(max(x, 0), plane.shape[1] - 1)])

    def across(y: int) -> int:
        return sum(tap * whole(y, column // 2 - 2 + k) for k, tap in enumerate(taps))

    if row % 2 == 0 and column % 2 == 0:
        return whole(row // 2, column // 2)
    if row % 2 == 0:
        total, shift = across(row // 2), 5
    elif column % 2 == 0:
        total, shift = sum(tap * whole(row // 2 - 2 + k, column // 2) for k, tap in enumerate(taps)), 5
    else:
        total, shift = sum(tap * across(row // 2 - 2 + k) for k, tap in enumerate(taps)), 10
    return min(max((total + 2 ** (shift - 1)) >> shift, 0), 255)


def block_at(planes: Planes, row: int, column: int, size: int) -> NDArray[np.int64]:
    """Cut a block out of phase planes, position in quarter samples."""
    plane = planes[row % 4, column % 4].astype(np.int64)
    return plane[row // 4 : row // 4 + size, column // 4 : column // 4 + size]


def clamp(position: int, size: int, length: int) -> int:
    """Keep a block inside its plane, with one sample to spare for interpolation."""
    return min(max(position, 0), 4 * (length - size - 1))


def difference(
    a: Planes, a_at: tuple[int, int], b: Planes, b_at: tuple[int, int], size: int
) -> int:  # fmt: skip
    """Return the sum of absolute differences of two blocks."""
    return int(np.abs(block_at(a, *a_at, size) - block_at(b, *b_at, size)).sum())


def corner(
    number: tuple[int, int], planes: Planes, margin: int, block: int, window: int
) -> tuple[int, int]:  # fmt: skip
    """Return where the window of a block starts, in quarter samples."""
    row, column = (4 * (margin + k * block - (window - block) // 2) for k in number)
    return clamp(row, window, planes.shape[2]), clamp(column, window, planes.shape[3])


def square(radius: int) -> list[tuple[int, int]]:
    """Return the steps of a full search, row by row."""
    return [(v, h) for v in range(-radius, radius + 1) for h in range(-radius, radius + 1)]


def forward_search(
    a: Planes, b: Planes, margin: int, block: int, window: int, radius: int, step: int, smoothness: float,
    starts: NDArray[np.int64],
) -> NDArray[np.int64]:  # fmt: skip
    """Return the displacement from a to b of each block of b with the least weighted difference."""
    vectors = np.empty_like(starts)
    for i, j in np.ndindex(*starts.shape[:2]):
        row, column = corner((i, j), a, margin, block, window)
        costs = []
        for v, h in square(radius):
            dv, dh = int(starts[i, j, 0]) + v * step, int(starts[i, j, 1]) + h * step
            source = clamp(row - dv, window, a.shape[2]), clamp(column - dh, window, a.shape[3])
            sad = difference(b, (row, column), a, source, window)
            costs.append(((sad + window) * (1.0 + smoothness * float(np.hypot(v, h))), dv, dh))
        vectors[i, j] = min(costs, key=lambda cost: cost[0])[1:]
    return vectors


def refine_bilateral(
    a: Planes, b: Planes, margin: int, block: int, window: int, radius: int, step: int, smoothness: int,
    numerator: int, denominator: int, candidates: NDArray[np.int64],
) -> NDArray[np.int64]:  # fmt: skip
    """Return the best displacement of each block: among its candidates, then around the best of them."""
    height, width = a.shape[2:]

    def cost(number: tuple[int, int], dv: int, dh: int) -> float:
        row, column = corner(number, a, margin, block, window)
        distances = np.abs(candidates[number][1:9] - (dv, dh)).sum(axis=1)
        regularity = (int(np.minimum(distances, 32).sum()) * smoothness) >> 5
        row_a = row - int(np.floor(dv * numerator / denominator + 0.5))
        column_a = column - int(np.floor(dh * numerator / denominator + 0.5))
        for position, length in (
            (row_a, height),
            (row_a + dv, height),
            (column_a, width),
            (column_a + dh, width),
        ):
            if not 0 <= position <= 4 * (length - window - 1):
                return float("inf")
        return regularity + difference(a, (row_a, column_a), b, (row_a + dv, column_a + dh), window)

    vectors = np.empty((*candidates.shape[:2], 2), np.int64)
    for number in np.ndindex(*candidates.shape[:2]):
        tried = [tuple(map(int, candidate)) for candidate in candidates[number]]
        best = min(tried, key=lambda vector: cost(number, *vector))
        around = [(best[0] + v * step, best[1] + h * step) for v, h in square(radius)]
        vectors[number] = min([best, *around], key=lambda vector: cost(number, *vector))
    return vectors


def search_target(
    target: NDArray[np.uint8], planes: Planes, margin: int, block: int, window: int, radius: int, step: int,
    smoothness: int, offsets: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    """Return the best offset of each block into a reference, and its cost; no correction wins ties."""
    height, width = planes.shape[2:]
    found, costs = np.empty_like(offsets), np.empty(offsets.shape[:2], np.int64)
    for i, j in np.ndindex(*offsets.shape[:2]):
        row = min(margin + i * block - (window - block) // 2, height - window - 1)
        column = min(margin + j * block - (window - block) // 2, width - window - 1)
        wanted = target[row : row + window, column : column + window].astype(np.int64)
        tried = []
        for v, h in [(0, 0), *square(radius)]:
            dv, dh = int(offsets[i, j, 0]) + v * step, int(offsets[i, j, 1]) + h * step
            at = clamp(4 * row + dv, window, height), clamp(4 * column + dh, window, width)
            sad = int(np.abs(wanted - block_at(planes, *at, window)).sum())
            tried.append((sad + smoothness * step * (abs(v) + abs(h)), dv, dh))
        costs[i, j], *found[i, j] = min(tried, key=lambda cost: cost[0])
    return found, costs


def accumulate_blocks(
    planes: Planes, margin: int, block: int, taper: NDArray[np.float64], offsets: NDArray[np.int64],
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Return the weighted sum of overlapping displaced blocks, and the sum of their weights."""
    rows, columns = weights.shape
    total = np.zeros(((rows + 1) * block, (columns + 1) * block))
    mass = np.zeros_like(total)
    for i, j in np.ndindex(rows, columns):
        row = 4 * (margin + i * block - block // 2) + int(offsets[i, j, 0])
        column = 4 * (margin + j * block - block // 2) + int(offsets[i, j, 1])
        at = clamp(row, 2 * block, planes.shape[2]), clamp(column, 2 * block, planes.shape[3])
        part = np.s_[i * block : (i + 2) * block, j * block : (j + 2) * block]
        total[part] += weights[i, j] * taper * block_at(planes, *at, 2 * block)
        mass[part] += weights[i, j] * taper
    return total, mass
