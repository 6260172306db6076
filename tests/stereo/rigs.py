"""Random planar rigs of cameras, and their pictures of a textured plane."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvc.geometry.calibrated_cameras import Camera

Floats = NDArray[np.float64]

SIZE = 160, 120


def random_rig(
    seed: int, places: Sequence[tuple[float, float]], unit: float = 1.0, turn: float = 0.15
) -> list[Camera]:
    """Return verging cameras of random intrinsics on a random lattice."""
    rng = np.random.default_rng(seed)
    world = Rotation.random(random_state=rng).as_matrix()
    steps = np.array(
        [[1.0, rng.uniform(-0.1, 0.1), 0.0], [rng.uniform(-0.1, 0.1), rng.uniform(0.8, 1.25), 0.0]]
    )
    origin = rng.normal(size=3)
    cameras = []
    for index, (m, n) in enumerate(places):
        R = Rotation.from_rotvec(turn * rng.normal(size=3)).as_matrix() @ world
        centre = unit * (origin + world.T @ (m * steps[0] + n * steps[1]))
        focal = rng.uniform(120.0, 220.0)
        K = np.array([[focal, rng.normal(), 80.0 + rng.normal()], [0.0, focal * 1.02, 60.0], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"view{index}.png", K, R, -R @ centre, SIZE))
    return cameras


def pixels_of(size: tuple[int, int]) -> Floats:
    """Return the positions of all pixels of a picture, row by row."""
    y, x = np.mgrid[: size[1], : size[0]]
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)


def rays_of(camera: Camera) -> Floats:
    """Return the directions of all pixels in the world, one unit deep."""
    pixels = camera.undistorted(pixels_of(camera.size))
    return np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T @ camera.R
