"""A scene of random points before two calibrated cameras, seen through any projective frame."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvc.arrays import Floats
from dvc.geometry.cameras import PixelFrame, homogeneous, project
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels, unit_norm
from sfm.scene_model import Correspondences, Model

FRAME = PixelFrame(352, 288)
FOCAL_LENGTH = 1.1


@dataclass(frozen=True, eq=False)
class Truth:
    """The Euclidean truth, and a model of it in another projective frame."""

    rotation: Floats
    translation: Floats
    model: Model


def euclidean_scene(
    num_points: int = 120, plane: tuple[float, float, float] = (0.0, 0.0, 0.0), noise_px: float = 0.0
) -> Truth:
    """Make a scene; `plane` is the plane at infinity of the model's frame."""
    rng = np.random.default_rng(5)
    k = np.diag([FOCAL_LENGTH, FOCAL_LENGTH, 1.0])
    rotation = Rotation.from_rotvec([0.02, 0.1, -0.05]).as_matrix()
    translation = np.array([0.3, 0.05, 0.1])
    camera = np.column_stack([k @ rotation @ np.linalg.inv(k), k @ translation])
    first = rng.uniform(-0.4, 0.4, (num_points, 2))
    depths = rng.uniform(2.0, 6.0, num_points)
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(num_points)])
    second, _ = project(camera, points)
    a = np.array(plane)
    camera[:, :3] -= np.outer(camera[:, 3], a)
    matches = Correspondences(
        FRAME.to_pixels(first),
        FRAME.to_pixels(second) + noise_px * rng.standard_normal((num_points, 2)),
        np.zeros(num_points),
    )
    model = Model(
        FRAME,
        unit_norm(fundamental_to_pixels(fundamental_from_camera(camera), FRAME)),
        camera * np.sqrt(3.0) / np.linalg.norm(camera),
        matches,
        depths / (1.0 + points[:, :3] @ a),
    )
    return Truth(rotation, translation, model)
