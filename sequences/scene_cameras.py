"""Pinhole cameras: projection, back-projection, aiming, and the tremor of a hand.

World axes are x right, y forward, z up, in metres. Camera axes are x right, y down, z forward. The centre of
the first pixel is at (0, 0), as in OpenCV; image points are (x, y) = (column, row).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dvc.arrays import Floats


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion.

    Attributes
    ----------
    K : ndarray of shape (3, 3), float64
        Intrinsic matrix in pixels.
    cam_from_world : ndarray of shape (3, 4), float64
        Rotation and translation ``[R | t]``, metres.
    width_px, height_px : int
        Image size.
    """

    K: Floats
    cam_from_world: Floats
    width_px: int
    height_px: int

    @property
    def centre(self) -> Floats:
        """Camera centre in the world, shape (3,), metres."""
        return -self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3]

    @property
    def projection(self) -> Floats:
        """Projection matrix ``K [R | t]``, shape (3, 4)."""
        return self.K @ self.cam_from_world

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as plain numbers for JSON."""
        return {
            "K": self.K.tolist(),
            "cam_from_world": self.cam_from_world.tolist(),
            "width_px": self.width_px,
            "height_px": self.height_px,
        }


def transformed(matrix: Floats, points: Floats) -> Floats:
    """Return ``matrix @ (x, y, z, 1)`` of points (N, 3), with the same rounding on every processor."""
    x, y, z = points[:, :1], points[:, 1:2], points[:, 2:]
    return np.asarray(x * matrix[:, 0] + y * matrix[:, 1] + z * matrix[:, 2] + matrix[:, 3])


def project(camera: Camera, points_in_world: Floats) -> tuple[Floats, Floats]:
    """Project world points into the image.

    Parameters
    ----------
    camera : Camera
        The view.
    points_in_world : ndarray of shape (N, 3), float64
        Points in metres.

    Returns
    -------
    xy : ndarray of shape (N, 2), float64
        Image points in pixels.
    depth_m : ndarray of shape (N,), float64
        Depth along the optical axis; negative behind the camera.
    """
    homogeneous = transformed(camera.projection, points_in_world)
    depth = homogeneous[:, 2]
    return homogeneous[:, :2] / depth[:, None], depth


def ray_directions(camera: Camera, xy: Floats) -> Floats:
    """Return the world directions (N, 3) of image points (N, 2), each one metre of depth long."""
    rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(camera.K).T
    return np.asarray(rays @ camera.cam_from_world[:, :3])


def back_project(camera: Camera, xy: Floats, depth_m: Floats) -> Floats:
    """Return the world points (N, 3) seen at image points (N, 2) with given depth; inverse of `project`.

    Parameters
    ----------
    camera : Camera
        The view.
    xy : ndarray of shape (N, 2), float64
        Image points in pixels.
    depth_m : ndarray of shape (N,), float64
        Depth along the optical axis, metres.

    Returns
    -------
    ndarray of shape (N, 3), float64
        Points in the world, metres.
    """
    return camera.centre + ray_directions(camera, xy) * depth_m[:, None]


def intrinsics(width_px: int, height_px: int, field_of_view_deg: float) -> Floats:
    """Return `K` (3, 3) of square pixels and a centred principal point for a horizontal field of view."""
    focal = 0.5 * width_px / math.tan(math.radians(field_of_view_deg) / 2)
    x, y = (width_px - 1) / 2, (height_px - 1) / 2
    return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])


def look_at(centre: ArrayLike, target: ArrayLike, turn_deg: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
    """Return ``cam_from_world`` (3, 4) of a level camera that looks at a point, and turns."""
    eye = np.asarray(centre, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    turn = np.radians(np.asarray(turn_deg, dtype=np.float64))
    for axis, (sine, cosine) in enumerate(zip(np.sin(turn), np.cos(turn), strict=True)):
        step = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step[i, i], step[i, j], step[j, i], step[j, j] = cosine, -sine, sine, cosine
        rotation = step @ rotation
    return np.column_stack([rotation, -rotation @ eye])


def tremor(time_s: float, seed: int, min_hz: float, max_hz: float, count: int = 6) -> float:
    """Return a smooth pseudo-random function of time with unit variance: a sum of sinusoids."""
    rng = np.random.default_rng([seed, 77])
    frequency = rng.uniform(min_hz, max_hz, count)
    phase = rng.uniform(0.0, 2 * math.pi, count)
    return float(math.sqrt(2 / count) * np.sum(np.sin(2 * math.pi * frequency * time_s + phase)))


def there_and_back(time: float, period: float, ease: float) -> float:
    """Fold time into ``[0, period]``, so that a finite path serves a sequence of any length."""
    phase = (time + ease) % (2 * period)
    to_turn = abs(phase - period)
    rounded = min(to_turn, period - to_turn)
    if rounded >= ease:
        return period - to_turn
    bulge = (rounded - ease) ** 2 / (2 * ease)
    return period - to_turn + (bulge if to_turn > period / 2 else -bulge)
