"""Plain twins of the kernels of layers and sprites, written from their definitions; slow."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SIDES = ((0, 1), (1, 0), (0, -1), (-1, 0))


def judged(disparity: Floats, other: Floats, dm: float, dn: float, tolerance: float) -> NDArray[np.int64]:
    """Return 2 where the other camera has the same surface, 1 where it cannot, 0 where it sees through."""
    height, width = disparity.shape
    verdict = np.zeros(disparity.shape, np.int64)
    for y, x in np.ndindex(height, width):
        d = disparity[y, x]
        around = [
            other[v, u] - d
            for v, u in np.ndindex(height, width)
            if abs(u - (x - dm * d)) < 1 - 2e-6 and abs(v - (y - dn * d)) < 1 - 2e-6
        ]
        if not around or max(around) > tolerance:
            verdict[y, x] = 1
        if any(abs(difference) <= tolerance for difference in around):
            verdict[y, x] = 2
    return verdict


def splatted(
    disparity: Floats,
    votes: NDArray[np.bool_],
    m: float,
    n: float,
    corner: tuple[int, int],
    shape: tuple[int, int],
    jump: float,
) -> dict[tuple[int, int], list[float]]:
    """Return the disparities that fall into each cell, and those between pixels of one surface."""
    height, width = disparity.shape
    cells: dict[tuple[int, int], list[float]] = {cell: [] for cell in np.ndindex(shape)}
    place = {}
    for y, x in np.ndindex(height, width):
        d = disparity[y, x]
        place[y, x] = np.array([x + m * d - corner[0], y + n * d - corner[1], d])
        if votes[y, x]:
            column, row = (int(np.floor(value + 0.5)) for value in place[y, x][:2])
            if (row, column) in cells:
                cells[row, column].append(d)
    for y, x in np.ndindex(height - 1, width - 1):
        corners = [(y, x), (y, x + 1), (y + 1, x), (y + 1, x + 1)]
        four = np.array([place[pixel] for pixel in corners])
        if not all(votes[pixel] for pixel in corners) or not 0 < np.ptp(four[:, 2]) <= jump:
            continue
        taken = {tuple(pair) for pair in np.floor(four[:, :2] + 0.5)}
        for (row, column), values in cells.items():
            if (column, row) in taken:
                continue
            for triangle in (four[[0, 1, 2]], four[[3, 2, 1]]):
                edges = (triangle[1:, :2] - triangle[0, :2]).T
                if np.linalg.det(edges) <= 1e-9:
                    continue
                s, t = np.linalg.solve(edges, np.array([column, row]) - triangle[0, :2])
                if min(s, t) >= -1e-6 and s + t <= 1 + 1e-6:
                    steps = triangle[1:, 2] - triangle[0, 2]
                    values.append(triangle[0, 2] + s * steps[0] + t * steps[1])
                    break
    return cells


def peeled(
    points: list[tuple[float, int]],
    lowest: float,
    step: float,
    reach: int,
    baselines: Sequence[float],
    owner: int,
) -> list[tuple[float, int]]:
    """Return the values of one cell and their votes in the order of (2.21), from disparities and cameras."""
    values = []
    while points:
        front: dict[int, float] = {}
        for d, camera in points:
            front[camera] = max(front.get(camera, -np.inf), d)
        ballots: dict[int, list[float]] = {}
        for d in front.values():
            ballots.setdefault(label_of(d, lowest, step), []).append(d)
        best = max(ballots, key=lambda level: (len(ballots[level]), level))
        near = [abs(label_of(d, lowest, step) - best) <= reach for d in front.values()]
        value = float(np.mean(ballots[best]))
        values.append((value, sum(near)))
        left = []
        for d, camera in points:
            away = abs(label_of(d, lowest, step) - best) > reach
            second = d < front[camera] and value - d > 0.999 * step
            second = second and (value - d) * baselines[camera] > 0.999
            before = owner >= 0 and label_of(d, lowest, step) > best
            if camera != owner and (away or second) and not before:
                left.append((d, camera))
        points = left
        owner = -1
    return values


def label_of(d: float, lowest: float, step: float) -> int:
    """Return the nearest label."""
    return int(np.floor((d - lowest) / step + 0.5))


def likelihoods(
    depth: Floats, mask: NDArray[np.bool_], smooth: float, jump: float, rho: tuple[float, float], rounds: int
) -> Floats:
    """Return beliefs after all pixels have sent their messages at once, many times."""
    shape = depth.shape
    heard = {(p, q): 0.5 for p, q in itertools.product(np.ndindex(shape), repeat=2) if _touch(p, q)}

    def belief(p: tuple[int, ...], but: tuple[int, ...] | None = None) -> float:
        if mask[p]:
            return 1.0
        told = np.array([value for (at, by), value in heard.items() if at == p and by != but])
        yes, no = told.prod(), (1 - told).prod()
        return float(yes / (yes + no)) if yes + no > 0 else 0.5

    for _ in range(rounds):
        heard = {(p, q): _moved(belief(q, p), abs(depth[p] - depth[q]), smooth, jump, rho) for p, q in heard}
    return np.array([belief(p) for p in np.ndindex(shape)]).reshape(shape)


def _touch(p: tuple[int, ...], q: tuple[int, ...]) -> bool:
    return abs(p[0] - q[0]) + abs(p[1] - q[1]) == 1


def _moved(p: float, difference: float, smooth: float, jump: float, rho: tuple[float, float]) -> float:
    if difference > jump:
        return min(1 - p, 0.5)
    chosen = rho[0] if difference <= smooth else rho[1]
    return (1 - 2 * chosen) * p + chosen
