"""Views to code: a textured square before a smooth background, by cameras in a row."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

NEAR, FAR = 6, 2
"""Disparities of the square and of the background, in pixels per unit of m."""
FOCAL_PX = 60.0
"""Of calibrated cameras, which stand a unit apart: depth is ``FOCAL_PX`` over disparity."""


def views_of_square(
    places: tuple[int, ...] = (0, 1), height: int = 32, width: int = 48
) -> list[NDArray[np.uint8]]:
    """Return what cameras at (m, 0) see, shape (H, W, 3), red first."""
    rng = np.random.default_rng(11)
    noise = rng.normal(0.0, 1.0, (height, width + 40, 3))
    ground = 120.0 + 260.0 * cv2.GaussianBlur(noise, (0, 0), 3.0)
    square = rng.integers(40, 216, (height // 2, width // 3, 3)).astype(np.float64)
    square = cv2.GaussianBlur(square, (0, 0), 1.0)
    views = []
    for m in places:
        start = 20 + FAR * m
        view = ground[:, start : start + width].copy()
        left = width // 3 - NEAR * m
        view[height // 4 : height // 4 + square.shape[0], left : left + square.shape[1]] = square
        views.append(np.clip(np.rint(view), 0, 255).astype(np.uint8))
    return views


def true_disparity(height: int = 32, width: int = 48) -> NDArray[np.float64]:
    """Return the disparity of the view at (0, 0)."""
    disparity = np.full((height, width), float(FAR))
    disparity[height // 4 : height // 4 + height // 2, width // 3 : width // 3 + width // 3] = NEAR
    return disparity


def write_views(folder: Path, names: str, places: tuple[int, ...]) -> None:
    """Write views under names of one letter, and their cameras as ``cameras.json``."""
    for name, view in zip(names, views_of_square(places), strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), view[:, :, ::-1])


def cameras(names: str, places: tuple[int, ...]) -> list[dict[str, Any]]:
    """Return the cameras of views as `dvc.geometry.camera_files` reads them."""
    intrinsic = [[FOCAL_PX, 0.0, 24.0], [0.0, FOCAL_PX, 16.0], [0.0, 0.0, 1.0]]
    return [
        {"file": f"{name}.png", "K": intrinsic, "R": np.eye(3).tolist(), "t": [-float(m), 0.0, 0.0]}
        for name, m in zip(names, places, strict=True)
    ]
