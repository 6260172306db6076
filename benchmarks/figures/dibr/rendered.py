"""Rendered scenes as rectified arrays of two by two cameras."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.thesis.scenes import Scene
from dvc.multiview.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from sequences.renderer import render_picture
from sequences.scenes import scene

WIDTH, HEIGHT = 320, 240
POSITIONS = ((0, 0), (1, 0), (0, 1), (1, 1))
STEP_M = 0.25
"""From camera to camera, right and down; the first stands where the sequence begins."""
RENDERED = "street", "stairway"


def rendered_array(name: str) -> Scene:
    """Render four views whose cameras have parallel axes."""
    built = scene(name)
    first = built.description.pose(0, 0)

    def _pose(index: float, seed: int) -> NDArray[np.float64]:
        del seed
        m, n = POSITIONS[int(index)]
        return np.column_stack([first[:, :3], first[:, 3] - STEP_M * np.array([m, n, 0.0])])

    array = replace(built, description=replace(built.description, pose=_pose))
    pictures = [render_picture(array, index, WIDTH, HEIGHT) for index in range(len(POSITIONS))]
    views = [
        ArrayView(f"{name}-{m}-{n}", image, LatticePosition(float(m), float(n)))
        for (m, n), (image, _, _) in zip(POSITIONS, pictures, strict=True)
    ]
    _, depth, camera = pictures[0]
    disparity = camera.K[0, 0] * STEP_M / depth
    low, high = math.floor(float(disparity.min())), math.ceil(float(disparity.max()))
    return Scene(name, CameraArray(tuple(views)), DisparityLabels(float(low), 1.0, high - low + 1))
