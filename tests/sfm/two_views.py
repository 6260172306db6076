"""Two views of random points with exact cameras, noise and outliers, for the tests of camera estimation."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from dvc.arrays import Floats, Mask
from dvc.geometry.cameras import PixelFrame, homogeneous, project
from sfm.estimation.epipolar import fundamental_from_camera, fundamental_to_pixels, unit_norm
from sfm.estimation.two_view_estimators import TwoViewEstimator
from sfm.scene_model import Correspondences, Model

FRAME = PixelFrame(352, 288)
K = np.diag([1.15, 1.15, 1.0])
TURN = np.array([0.01, 0.03, 0.005])
MOVE = np.array([0.25, 0.05, 0.1])
FOCAL_LENGTH = 1.1


@dataclass(frozen=True, eq=False)
class TwoViews:
    """What two cameras see: exactly, and as it is measured."""

    exact: Correspondences
    measured: Correspondences
    outliers: Mask
    depths: Floats
    camera: Floats

    @property
    def fundamental(self) -> Floats:
        return fundamental_to_pixels(fundamental_from_camera(self.camera), FRAME)

    @property
    def model(self) -> Model:
        return Model(FRAME, self.fundamental, self.camera, self.exact, self.depths)


def camera_at(time: float, motion: float = 1.0, shake: float = 0.0, turn_only: bool = False) -> Floats:
    """Return the camera (3, 4) of an instant of a path, off it by `shake` radians."""
    rotation = Rotation.from_rotvec(motion * (time * TURN) + shake * np.array([1.0, -0.5, 0.7])).as_matrix()
    translation = np.zeros(3) if turn_only else motion * time * MOVE
    camera = np.column_stack([K @ rotation @ np.linalg.inv(K), K @ translation])
    return camera * np.sqrt(3.0 / (camera * camera).sum())


def two_views(
    num_points: int = 200,
    kind: Literal["general", "planar", "rotation"] = "general",
    motion: float = 1.0,
    noise_px: float = 0.0,
    outlier_share: float = 0.0,
    seed: int = 0,
) -> TwoViews:
    """Make a scene of points, or of a plane, before a camera that moves or only turns."""
    rng = np.random.default_rng(seed)
    x = rng.uniform([-0.5, -0.4], [0.5, 0.4], (num_points, 2))
    depths = rng.uniform(3.0, 15.0, num_points)
    if kind == "planar":
        depths = 1.0 / (0.15 + 0.1 * x[:, 0] - 0.05 * x[:, 1])
    camera = camera_at(1.0, motion, turn_only=kind == "rotation")
    points = np.column_stack([depths[:, None] * homogeneous(x), np.ones(num_points)])
    first, second = FRAME.to_pixels(x), FRAME.to_pixels(project(camera, points)[0])
    outliers = rng.random(num_points) < outlier_share
    moved = second + rng.normal(0.0, noise_px, second.shape)
    moved[outliers] += rng.uniform(-30.0, 30.0, (np.count_nonzero(outliers), 2))
    none = np.zeros(num_points)
    seen = Correspondences(first + rng.normal(0.0, noise_px, first.shape), moved, none)
    return TwoViews(Correspondences(first, second, none), seen, outliers, depths, camera)


def in_shared_scale(estimator: TwoViewEstimator, fundamental: Floats) -> Floats:
    """Convert a fundamental matrix from pixels: the inverse of `FundamentalEstimator.to_pixels`."""
    a, b = estimator.matrices()
    return unit_norm(np.linalg.inv(b).T @ fundamental @ np.linalg.inv(a))


def odd_correspondences() -> dict[str, Correspondences]:
    """Return inputs from which nothing can be estimated, by what is wrong with them."""
    rng = np.random.default_rng(3)
    line = np.column_stack([np.arange(40.0), 2.0 * np.arange(40.0)])
    noise = rng.uniform(0.0, 300.0, (40, 2))
    found = {f"{n} points": (noise[:n], noise[:n] + 2.0) for n in range(9)}
    found |= {
        "all equal": (np.full((40, 2), 7.0), np.full((40, 2), 9.0)),
        "collinear": (line, line + 3.0),
        "collinear and stretched": (line, 1.1 * line),
        "no motion": (noise, noise),
        "nan": (np.full((40, 2), np.nan), noise),
        "some infinite": (np.where(noise > 150.0, np.inf, noise), noise),
        "random": (noise, rng.uniform(0.0, 300.0, (40, 2))),
        "huge": (1e9 * noise, 1e9 * noise[::-1]),
    }
    return {name: Correspondences(a, b, np.zeros(len(a))) for name, (a, b) in found.items()}


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
