"""Plain twin of the prediction of sampled blocks from two frames around theirs, moved as points nearby."""

import numpy as np


def sample(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return samples between those of an image, of which borders are repeated."""
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, above = np.floor(x).astype(int), np.floor(y).astype(int)
    right, below = np.minimum(left + 1, width - 1), np.minimum(above + 1, height - 1)
    u, v = x - left, y - above
    upper = (1 - u) * image[above, left] + u * image[above, right]
    lower = (1 - u) * image[below, left] + u * image[below, right]
    return (1 - v) * upper + v * lower


def motion_at(place: tuple[float, float], positions: np.ndarray) -> np.ndarray:
    """Return the motion to both other frames: that of the three nearest points, weighed by distance."""
    if not len(positions):
        return np.zeros((2, 2))
    squares = ((positions[:, 0] - place) ** 2).sum(axis=1)
    nearest = np.argsort(squares, kind="stable")[:3]
    weights = 1 / (squares[nearest] + 16.0)
    moved = positions[nearest, 1:] - positions[nearest, :1]
    return (weights[:, None, None] * moved).sum(axis=0) / weights.sum()


def error(
    frame: np.ndarray, around: tuple[np.ndarray, np.ndarray], positions: np.ndarray, spacing: int
) -> tuple[float, int]:
    """Return the mean squared error of blocks of 8x8 samples, and how many blocks there are."""
    squares = []
    for top in range(0, frame.shape[0] - 7, spacing):
        for left in range(0, frame.shape[1] - 7, spacing):
            motion = motion_at((left + 4.0, top + 4.0), positions)
            y, x = np.mgrid[top : top + 8, left : left + 8]
            found = [sample(image, x + dx, y + dy) for image, (dx, dy) in zip(around, motion, strict=True)]
            squares.append((frame[top : top + 8, left : left + 8] - sum(found) / 2) ** 2)
    return (float(np.mean(squares)) if squares else 0.0), len(squares)
