"""Two views of a textured square before a textured background."""

import cv2
import numpy as np

from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition

LABELS = DisparityLabels(0.0, 1.0, 10)
NEAR, FAR = 6, 2


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
