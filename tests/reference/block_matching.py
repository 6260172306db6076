"""Plain twins of block matching."""

import numpy as np
from numpy.typing import NDArray

from dvc.video.frames import Plane


def sad(image: Plane, x: int, y: int, block: Plane) -> int | None:
    """Return the sum of absolute differences of a block around a point; None off the image."""
    half = block.shape[0] // 2
    if min(x, y) < half or x + half >= image.shape[1] or y + half >= image.shape[0]:
        return None
    cut = image[y - half : y + half + 1, x - half : x + half + 1].astype(int)
    return int(np.abs(cut - block.astype(int)).sum())


def descend(image: Plane, x: int, y: int, block: Plane, max_steps: int) -> tuple[int, int, int | None]:
    """Follow the least SAD of the eight neighbours, in raster order where equal, until none is less."""
    for _ in range(max_steps):
        around = [(x + dx, y + dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0)]
        found = [(value, place) for place in around if (value := sad(image, *place, block)) is not None]
        here = sad(image, x, y, block)
        least = min((value for value, _ in found), default=None)
        if here is None or least is None or least >= here:
            break
        x, y = next(place for value, place in found if value == least)
    return x, y, sad(image, x, y, block)


def spiral_search(
    image: Plane, x: int, y: int, block: Plane, small: int, spiral: NDArray[np.int64]
) -> tuple[int, int, int | None]:
    """Compare along a spiral; stop at the first least SAD that is small."""
    best: tuple[int, int, int | None] = (x, y, None)
    for dx, dy in spiral.tolist():
        value = sad(image, x + dx, y + dy, block)
        if value is not None and (best[2] is None or value < best[2]):
            best = (x + dx, y + dy, value)
            if value <= small:
                break
    return best


def nearest_found(first: NDArray[np.int64], found: NDArray[np.bool_], i: int) -> int:
    """Return which point that is found started nearest to another, the first of equals; -1 if none."""
    squares = ((first - first[i]) ** 2).sum(axis=1)
    return int(np.argmin(np.where(found, squares, 2**40))) if found.any() else -1


def between_pixels(before: int, here: int, after: int) -> float:
    """Return where the two sides of a V through three SADs meet; 0 where there is no V."""
    if min(before, after) < here or before == after == here:
        return 0.0
    return (before - after) / (2 * (max(before, after) - here))


def last_motion(point: NDArray[np.int64], ends: NDArray[np.float64]) -> tuple[float, list[int]]:
    """Return the squared distance of the nearest of tracks (K, 2, 2), and its motion back in time."""
    known = ends[np.isfinite(ends[:, 1, 0])]
    if not len(known):
        return np.inf, [0, 0]
    squares = ((known[:, 1] - point) ** 2).sum(axis=1)
    nearest = known[np.argmin(squares)]
    return float(squares.min()), np.rint(nearest[0] - nearest[1]).astype(int).tolist()
