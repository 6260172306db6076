"""Epipolar geometry of two known cameras, from its definition."""

import numpy as np
from numpy.typing import NDArray

from sequences.scene_cameras import Camera

Floats = NDArray[np.float64]


def fundamental_matrix(a: Camera, b: Camera) -> Floats:
    """Return `F` (3, 3) with ``x_b.T @ F @ x_a = 0`` for images of one point, scaled to unit norm."""
    b_from_a = b.cam_from_world[:, :3] @ a.cam_from_world[:, :3].T
    t = b.cam_from_world[:, 3] - b_from_a @ a.cam_from_world[:, 3]
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    matrix: Floats = np.linalg.inv(b.K).T @ cross @ b_from_a @ np.linalg.inv(a.K)
    return matrix / np.linalg.norm(matrix)
