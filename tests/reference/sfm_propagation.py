"""Plain twins of the loops of propagation along edges."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from tests.reference.sfm_neighbourhoods import free_mean_error, neighbourhood

Floats = NDArray[np.float64]


def epipolar_frame(
    fundamental: Floats, x: float, y: float, near: Floats
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Return foot, direction and similarity; the scale by moving the first point across its epipolar line."""
    epipole = np.linalg.svd(fundamental)[2][2]
    along = epipole[:2] - epipole[2] * np.array([x, y])
    along /= np.linalg.norm(along)
    across = np.array([-along[1], along[0]])

    def line_through(point: Floats) -> Floats:
        line = fundamental @ [*point, 1.0]
        return line / np.linalg.norm(line[:2])

    line = line_through(np.array([x, y]))
    foot = near - (line @ [*near, 1.0]) * line[:2]
    step = 1e-5
    moved = line_through(np.array([x, y]) + step * across)
    moved = moved if moved[:2] @ line[:2] > 0 else -moved
    rate = -(moved @ [*foot, 1.0]) / step
    normal = line[:2] if rate > 0 else -line[:2]
    direction = np.array([normal[1], -normal[0]])
    scale = np.clip(abs(rate), 0.5, 2.0)
    return foot, direction, scale * (np.outer(direction, along) + np.outer(normal, across))


def error_at(
    image: Floats, coefficients: Floats, x: int, y: int, place: Floats, affine: Floats, weights: Floats
) -> float:
    """Return the error between a neighbourhood and one of the second image, infinite outside it."""
    radius = weights.shape[0] // 2
    reach = radius * np.abs(affine).sum(axis=1)
    last = np.array(coefficients.shape[::-1]) - 1
    if (place < reach).any() or (place + reach > last).any():
        return np.inf
    target = image[y - radius : y + radius + 1, x - radius : x + radius + 1]
    return free_mean_error(target, neighbourhood(coefficients, *place, affine, radius), weights)


def follow(
    image: Floats, coefficients: Floats, fundamental: Floats, x: int, y: int, near: Floats, weights: Floats,
    search: tuple[float, float, float], min_error: float, error_share: float,
) -> tuple[Floats, float] | None:  # fmt: skip
    """Return second point and error of the least error nearby on the epipolar line, by a bounded search."""
    foot, direction, affine = epipolar_frame(fundamental, x, y, near)
    half, step, _ = search

    def error(position: float) -> float:
        return error_at(image, coefficients, x, y, foot + position * direction, affine, weights)

    coarse = step * np.arange(-np.ceil(half / step), np.ceil(half / step) + 1)
    errors = [error(position) for position in coarse]
    best = int(np.argmin(errors))
    if best in (0, len(coarse) - 1) or not np.isfinite(errors[best - 1 : best + 2]).all():
        return None
    least = minimize_scalar(
        error, bounds=(coarse[best - 1], coarse[best + 1]), method="bounded", options={"xatol": 1e-4}
    )
    radius = weights.shape[0] // 2
    target = image[y - radius : y + radius + 1, x - radius : x + radius + 1]
    variance = free_mean_error(target, np.zeros(target.size), weights)
    if least.fun > min_error + error_share * variance:
        return None
    return foot + least.x * direction, float(least.fun)


def propagate(
    image: Floats, coefficients: Floats, fundamental: Floats, tries: NDArray[np.int64], reach: int,
    weights: Floats, search: tuple[float, float, float], min_error: float, error_share: float,
    seeds: list[tuple[int, int, Floats]],
) -> dict[tuple[int, int], Floats]:  # fmt: skip
    """Return the second point of every pixel that was reached, seeds included, round by round."""
    radius = weights.shape[0] // 2
    height, width = image.shape
    tries = tries.copy()
    known = {(x, y): second for x, y, second in seeds}
    newest = list(known)
    while newest:
        near = {}
        for y in range(radius, height - radius):
            for x in range(radius, width - radius):
                square = [(x - u) ** 2 + (y - v) ** 2 for u, v in newest]
                if tries[y, x] > 0 and min(square) <= reach**2:
                    near[x, y] = newest[int(np.argmin(square))]
        newest = []
        found = {}
        for (x, y), owner in near.items():
            tries[y, x] -= 1
            start = np.array([x, y]) + known[owner] - owner
            result = follow(
                image, coefficients, fundamental, x, y, start, weights, search, min_error, error_share
            )
            if result is not None:
                tries[y, x] = 0
                found[x, y] = result[0]
        known |= found
        newest = list(found)
    return known


def disagreement(
    image: Floats, coefficients: Floats, fundamental: Floats, first: tuple[int, int], second: Floats,
    normal: Floats, distance_px: float, weights: Floats, half_range_px: float,
) -> list[float]:  # fmt: skip
    """Return the scores of both sides of a point; nan where a neighbourhood leaves the image."""
    _, direction, affine = epipolar_frame(fundamental, *first, second)
    radius, (height, width) = weights.shape[0] // 2, image.shape
    scores = []
    for side in (1.0, -1.0):
        offset = np.rint(side * distance_px * normal).astype(int)
        x, y = np.array(first) + offset
        if not (radius <= x <= width - 1 - radius and radius <= y <= height - 1 - radius):
            scores.append(np.nan)
            continue
        place = second + affine @ offset
        shifts = np.arange(-half_range_px, half_range_px + 0.25, 0.5)
        errors = np.array(
            [error_at(image, coefficients, x, y, place + s * direction, affine, weights) for s in shifts]
        )
        same, other = errors[np.abs(shifts) <= 0.5].min(), errors[np.abs(shifts) > 0.5].min()
        scores.append((same + 2.0) / (other + 2.0) if np.isfinite(same) and np.isfinite(other) else np.nan)
    return scores
