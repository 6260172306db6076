"""Whether the equations of the rectified space hold on random rigs of cameras."""

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figures.harness import Figure, Measured, Setting
from dvc.calibration.cameras import Camera
from dvc.stereo.rectification.rectified_space import (
    SWAP,
    first_homography,
    image_homography,
    rectified_projection,
)
from dvc.stereo.rectification.rectify import rectify

AREA = "stereo"
LIMIT = 1e-10


def random_cameras(rng: np.random.Generator) -> list[Camera]:
    """Draw verging cameras on a lattice, on a line, or two."""
    columns, rows = int(rng.integers(2, 4)), int(rng.integers(1, 4))
    world = Rotation.random(random_state=rng).as_matrix()
    skew = rng.uniform(-0.2, 0.2, 2)
    steps = np.array([[1.0, skew[0], 0.0], [skew[1], rng.uniform(0.7, 1.4), 0.0]])
    unit, cameras = float(np.exp(rng.normal(scale=2.0))), []
    for n in range(rows):
        for m in range(columns):
            R = Rotation.from_rotvec(0.12 * rng.normal(size=3)).as_matrix() @ world
            centre = unit * world.T @ (m * steps[0] + n * steps[1] + 3.0)
            focal = float(rng.uniform(400.0, 900.0))
            K = np.array([[focal, rng.normal(), 320.0], [0.0, 1.01 * focal, 240.0], [0.0, 0.0, 1.0]])
            cameras.append(Camera(f"{m}-{n}.png", K, R, -R @ centre, (640, 480)))
    return cameras


def identities(setting: Setting, clip: str) -> Measured:
    """Compare both sides of (2.10), and where points are seen with (2.5), on random rigs."""
    del clip
    rng = np.random.default_rng(0)
    matrices, points_px = 0.0, 0.0
    num_rigs = setting.choose(500, 20)
    for _ in range(num_rigs):
        cameras = random_cameras(rng)
        found = rectify(cameras)
        matrices = max(matrices, _matrix_difference(cameras))
        forward = np.mean([camera.R[2] for camera in cameras], axis=0)
        middle = np.mean([camera.centre for camera in cameras], axis=0)
        unit = float(np.linalg.norm(found.lattice.v1))
        points = middle + unit * (rng.uniform(6, 30, (20, 1)) * forward + rng.normal(size=(20, 3)))
        space = np.column_stack([points, np.ones(20)]) @ found.rectified_from_world.T
        xyd = space[:, :3] / space[:, 3:]
        for index, (camera, position) in enumerate(zip(cameras, found.positions, strict=True)):
            image = np.column_stack([points, np.ones(20)]) @ camera.projection.T
            seen = found.rectified_points(index, image[:, :2] / image[:, 2:])
            expected = xyd[:, :2] - xyd[:, 2:] * np.array(position)
            points_px = max(points_px, float(np.abs(seen - expected).max()) / 640.0)
    worst = max(matrices, points_px)
    text = f"{matrices:.1e} (matrices), {points_px:.1e} (points) on {num_rigs} rigs"
    return Measured(text, worst <= LIMIT, {"matrices": matrices, "points": points_px})


def _matrix_difference(cameras: list[Camera]) -> float:
    found = rectify(cameras)
    focal, worst = found.focal_length_px, 0.0
    for camera, position in zip(cameras, found.positions, strict=True):
        left = image_homography(camera, found.lattice, focal) @ camera.projection
        right = rectified_projection(position) @ SWAP @ first_homography(found.lattice, focal)
        worst = max(worst, float(np.abs(left - right).max() / np.abs(right).max()))
    return worst


FIGURES = (
    Figure(
        AREA,
        "rectification-identities",
        "(2.10) as matrices, (2.5) and (2.12) at points, random rigs of 2 to 9 verging cameras",
        "equal to 1e-10",
        identities,
    ),
)
