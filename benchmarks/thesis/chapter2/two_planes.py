"""Figure 2.4: a dark square before a bright background, seen by three cameras in a row."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition

HEIGHT, WIDTH = 60, 96
FAR, NEAR = 2, 10
TOP, LEFT, SIDE = 15, 33, 30
"""The square, in the middle view."""
LABELS = DisparityLabels(0.0, 1.0, 13)
_BACKGROUND, _SQUARE, _TEXTURE = 200.0, 60.0, 18.0
"""Mean levels, and the deviation of the texture by which surfaces are told apart."""


def two_planes() -> tuple[CameraArray, list[NDArray[np.float64]]]:
    """Make the three views."""
    rng = np.random.default_rng(24)
    far = np.clip(rng.normal(_BACKGROUND, _TEXTURE, (HEIGHT, WIDTH + 2 * FAR)), 0, 255).astype(np.uint8)
    near = np.clip(rng.normal(_SQUARE, _TEXTURE, (SIDE, SIDE)), 0, 255).astype(np.uint8)
    views, truth = [], []
    for m in (-1, 0, 1):
        image = far[:, FAR * (m + 1) : FAR * (m + 1) + WIDTH].copy()
        disparity = np.full((HEIGHT, WIDTH), float(FAR))
        place = slice(TOP, TOP + SIDE), slice(LEFT - m * NEAR, LEFT - m * NEAR + SIDE)
        image[place], disparity[place] = near, NEAR
        name = ("left", "middle", "right")[m + 1]
        views.append(ArrayView(name, np.repeat(image[:, :, None], 3, axis=2), LatticePosition(float(m), 0.0)))
        truth.append(disparity)
    return CameraArray(tuple(views)), truth
