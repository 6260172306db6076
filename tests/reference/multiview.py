"""Plain twins of the kernels of several views, written from their definitions; slow."""

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
EMPTY = -1e30
DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))


def moved(warp: Floats, x: float, y: float, rho: float) -> tuple[float, float, float]:
    """Return where a point goes; far away if behind."""
    u, v, w = warp @ [x, y, 1.0, rho]
    return (u / w, v / w, w) if w >= 1e-6 else (-1e9, -1e9, w)


def bilinear(image: Floats, x: float, y: float) -> float:
    """Return the mean of the four samples around, by distance."""
    total = 0.0
    for i, j in itertools.product(range(image.shape[0]), range(image.shape[1])):
        total += max(0.0, 1 - abs(y - i)) * max(0.0, 1 - abs(x - j)) * float(image[i, j])
    return total


def rasterise(positions: Floats, skipped: NDArray[np.bool_], shape: tuple[int, int]) -> Floats:
    """Return the largest inverse depth at every pixel, from barycentric coordinates solved anew."""
    nearest = np.full(shape, EMPTY)
    for i, j in np.argwhere(~skipped):
        a, b, c, d = positions[i, j], positions[i, j + 1], positions[i + 1, j], positions[i + 1, j + 1]
        for triangle in ((a, b, c), (d, c, b)):
            corners = np.array(triangle)
            if (corners[:, 2] == EMPTY).any():
                continue
            edges = corners[1:, :2] - corners[0, :2]
            if np.linalg.det(edges) <= 1e-9:
                continue
            for y, x in np.ndindex(shape):
                s, t = np.linalg.solve(edges.T, np.array([x, y]) - corners[0, :2])
                if min(s, t, 1 - s - t) >= -1e-9:
                    rho = (1 - s - t) * corners[0, 2] + s * corners[1, 2] + t * corners[2, 2]
                    nearest[y, x] = max(nearest[y, x], rho)
    return nearest


def matching_cost(
    base: Floats, other: Floats, warp: Floats, rhos: Floats, limits: Floats, outside_cost: int
) -> NDArray[np.int16]:
    """Return the truncated differences of every pixel and hypothesis."""
    height, width = base.shape[1:]
    cost = np.empty((height, width, len(rhos)), np.int16)
    for y, x, k in np.ndindex(cost.shape):
        u, v, _ = moved(warp, x, y, rhos[k])
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            cost[y, x, k] = outside_cost
            continue
        parts = [min(abs(bilinear(other[m], u, v) - base[m, y, x]), limits[m]) for m in range(3)]
        cost[y, x, k] = int(sum(parts))
    return cost


def census_cost(
    base: tuple[Floats, NDArray[np.uint32]],
    other: tuple[Floats, NDArray[np.uint32]],
    warp: Floats,
    rhos: Floats,
    limit: float,
    bit_cost: int,
    outside_cost: int,
) -> NDArray[np.int16]:
    """Return the truncated differences of levels, and the cost of bits that differ at the nearest pixel."""
    height, width = base[0].shape
    cost = np.empty((height, width, len(rhos)), np.int16)
    for y, x, k in np.ndindex(cost.shape):
        u, v, _ = moved(warp, x, y, rhos[k])
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            cost[y, x, k] = outside_cost
            continue
        words = int(base[1][y, x]), int(other[1][int(np.floor(v + 0.5)), int(np.floor(u + 0.5))])
        level = min(abs(bilinear(other[0], u, v) - base[0][y, x]), limit)
        cost[y, x, k] = int(level) + bit_cost * (words[0] ^ words[1]).bit_count()
    return cost


def aggregate(cost: NDArray[np.int16], image: Floats, small: int, large: int) -> NDArray[np.int64]:
    """Return the path costs of all eight directions, by recursion over pixels."""
    height, width, count = cost.shape
    total = np.zeros(cost.shape, np.int64)
    for dy, dx in DIRECTIONS:
        known: dict[tuple[int, int], NDArray[np.int64]] = {}

        def path(
            y: int,
            x: int,
            dy: int = dy,
            dx: int = dx,
            known: dict[tuple[int, int], NDArray[np.int64]] = known,
        ) -> NDArray[np.int64]:
            if (y, x) not in known:
                here = cost[y, x].astype(np.int64)
                if 0 <= y - dy < height and 0 <= x - dx < width:
                    before = path(y - dy, x - dx)
                    jump = int(max(small, large / (1.0 + 0.1 * abs(image[y, x] - image[y - dy, x - dx]))))
                    ways = [
                        min(
                            before[m] + (0 if m == k else small if abs(m - k) == 1 else jump)
                            for m in range(count)
                        )
                        for k in range(count)
                    ]
                    here = here + np.minimum(ways, before.min() + jump) - before.min()
                known[y, x] = here
            return known[y, x]

        for y, x in np.ndindex(height, width):
            total[y, x] += path(y, x)
    return total


def best_hypothesis(total: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return the hypothesis of least cost, refined by a V through its neighbours, and its lead."""
    shape = total.shape[:2]
    hypothesis, confidence = np.empty(shape), np.empty(shape)
    for at in np.ndindex(shape):
        line = total[at]
        best = int(line.argmin())
        hypothesis[at] = best
        if 0 < best < len(line) - 1:
            left, right = line[best - 1] - line[best], line[best + 1] - line[best]
            if max(left, right) > 0:
                hypothesis[at] += 0.5 * (left - right) / max(left, right)
        others = [int(line[k]) for k in range(len(line)) if abs(k - best) > 2]
        confidence[at] = min([*others, 1 << 30]) - line[best]
    return hypothesis, confidence


def consistency(
    depth: Floats, other: Floats, there: Floats, back: Floats, tolerance: float
) -> NDArray[np.int8]:
    """Return 0 where both depth maps agree, 1 outside, 2 elsewhere."""
    height, width = depth.shape
    state = np.empty(depth.shape, np.int8)
    for y, x in np.ndindex(depth.shape):
        u, v, _ = moved(there, x, y, depth[y, x])
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            state[y, x] = 1
            continue
        near = [
            moved(back, u, v, other[i, j])
            for i, j in np.ndindex(other.shape)
            if abs(i - v) + abs(j - u) <= 1.5
            and abs(i - np.floor(v + 0.5)) <= 1
            and abs(j - np.floor(u + 0.5)) <= 1
        ]
        state[y, x] = 0 if any(abs(a - x) + abs(b - y) <= tolerance for a, b, _ in near) else 2
    return state


def weighted_quantile(values: Floats, weights: Floats, quantile: float) -> float:
    """Return the first value, in order, up to which the share of the weight is reached."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order])
    return float(values[order][np.flatnonzero(reached >= quantile * weights.sum())[0]])


def visibility(
    positions: Floats, depth: Floats, state: NDArray[np.int8], back: Floats, halo: int, tolerance: float
) -> NDArray[np.object_]:
    """Return, per point, one of outside, occluded, edge and seen."""
    height, width = depth.shape
    found = np.empty(positions.shape[:2], object)
    for at in np.ndindex(found.shape):
        u, v, rho = positions[at]
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            found[at] = "outside"
            continue
        a, b, _ = moved(back, u, v, rho)
        row, column = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
        blocked = {}
        for y, x in itertools.product(
            range(row - halo, row + halo + 1), range(column - halo, column + halo + 1)
        ):
            if 0 <= y < height and 0 <= x < width:
                c, d, _ = moved(back, u, v, depth[y, x])
                far = abs(c - a) + abs(d - b) > tolerance
                blocked[y, x] = bool(depth[y, x] > rho and state[y, x] == 0 and far)
        close = [value for (y, x), value in blocked.items() if max(abs(y - row), abs(x - column)) <= 1]
        found[at] = "occluded" if all(close) else "edge" if any(blocked.values()) else "seen"
    return found


def window_error(
    first: Floats, second: Floats, to_keys: list[Floats], x: float, y: float, rho: float, half: int
) -> float:
    """Return the mean squared difference of two keys over a window."""
    total, count = 0.0, 0
    height, width = first.shape
    for dy, dx in itertools.product(range(-half, half + 1), repeat=2):
        (a, b, _), (c, d, _) = (moved(warp, x + dx, y + dy, rho) for warp in to_keys)
        if not all(0 <= p <= width - 1 and 0 <= q <= height - 1 for p, q in ((a, b), (c, d))):
            return 1e9
        total += (bilinear(first, a, b) - bilinear(second, c, d)) ** 2
        count += 1
    return total / count


def membrane(
    number: NDArray[np.int32], depth: Floats, limit: Floats, image: Floats, stiffness: float
) -> tuple[Floats, Floats]:
    """Return the matrix (K, K) of the Laplace equation in holes, and what bounds them, (C, K)."""
    count = int(number.max()) + 1
    matrix, right = stiffness * np.eye(count), np.zeros((image.shape[2], count))
    for y, x in np.argwhere(number >= 0):
        for i, j in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
            if not (0 <= i < number.shape[0] and 0 <= j < number.shape[1]):
                continue
            row, beside = number[y, x], number[i, j]
            if beside >= 0:
                matrix[row, beside] -= 1.0
            if beside >= 0 or depth[i, j] <= limit[y, x]:
                matrix[row, row] += 1.0
            if beside < 0 and depth[i, j] <= limit[y, x]:
                right[:, row] += image[i, j]
    return matrix, right
