"""Views and depth maps with exact geometry: textured squares by cameras in a row, and slanted discs."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition

LABELS = DisparityLabels(0.0, 1.0, 10)
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


def planes(height: int, width: int) -> CameraArray:
    """Return a left and a right view; the square is a quarter in, half as high and a third as wide."""
    rng = np.random.default_rng(5)
    back, front = (
        cv2.GaussianBlur(rng.integers(0, 256, (height, width + NEAR, 3)).astype(np.uint8), (0, 0), 1.5)
        for _ in range(2)
    )
    back, front = (cv2.normalize(one, None, 0, 255, cv2.NORM_MINMAX) for one in (back, front))
    top, left = height // 4, width // 3
    views = []
    for camera, name in enumerate(("left", "right")):
        view = back[:, FAR * camera : FAR * camera + width].copy()
        at = left - NEAR * camera
        view[top : top + height // 2, at : at + width // 3] = front[: height // 2, : width // 3]
        views.append(ArrayView(name, np.ascontiguousarray(view), LatticePosition(float(camera), 0.0)))
    return CameraArray(tuple(views))


def two_discs(height=96, width=120):
    """Return a slanted background with two discs in front of it: (H, W), float64."""
    y, x = np.mgrid[:height, :width].astype(float)
    depth = 10.0 + 0.05 * x + 0.02 * y
    for row, column, radius, level in ((40, 45, 25, 30.0), (60, 80, 18, 42.0)):
        inside = np.hypot(y - row, x - column) < radius
        depth[inside] = level - 0.03 * x[inside]
    return depth


def texture(height=96, width=120, seed=0):
    """Return a smooth random picture: (H, W), uint8."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    levels = sum(
        rng.uniform(10, 30) * np.cos(rng.uniform(-0.5, 0.5) * x + rng.uniform(-0.5, 0.5) * y + k)
        for k in range(6)
    )
    return np.clip(128 + levels, 0, 255).astype(np.uint8)
