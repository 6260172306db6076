"""True correspondences between two frames of a rendered scene, with occlusion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats
from sequences import _kernels
from sequences.rendered_scenes import Scene
from sequences.scene_cameras import Camera, back_project, project, ray_directions, transformed

DEPTH_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of one frame and their positions in another.

    Attributes
    ----------
    points_a, points_b : ndarray of shape (P, 2), float64
        Image points (x, y) in pixels; nan in b for points behind its camera.
    depth_a : ndarray of shape (P,), float64
        Depth in a, metres; inf for the sky.
    visible : ndarray of shape (P,), bool
        Whether the point is inside frame b and not occluded there.
    """

    points_a: Floats
    points_b: Floats
    depth_a: Floats
    visible: NDArray[np.bool_]


def pixel_grid(width: int, height: int, step: int = 1) -> Floats:
    """Return the pixel centres (P, 2) of every `step`-th column and row as (x, y), row by row."""
    x, y = np.meshgrid(np.arange(0, width, step), np.arange(0, height, step))
    return np.stack([x.ravel(), y.ravel()], axis=-1).astype(np.float64)


def depth_at(scene: Scene, camera: Camera, points: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Return depth and triangle of image points (P, 2), which need not be pixel centres; -1 for the sky."""
    height, width = camera.height_px, camera.width_px
    depth, triangle = np.full(len(points), np.nan), np.full(len(points), -1, dtype=np.int32)
    inside = np.flatnonzero(in_image(camera, points))
    if inside.size == 0:
        return depth, triangle
    xy = np.ascontiguousarray(points[inside])
    cells = np.floor(xy + 0.5).astype(np.int64)
    cell = np.minimum(cells[:, 1], height - 1) * width + np.minimum(cells[:, 0], width - 1)
    order = np.argsort(cell, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=width * height))])
    start = ends[np.arange(height)[:, None] * width + np.arange(width + 1)]
    projected = transformed(camera.projection, scene.surface.points)
    nearest, ids = np.full(len(xy), np.inf), np.full(len(xy), -1, dtype=np.int32)
    _kernels.cast_points(projected, scene.surface.triangles, xy, start, order, nearest, ids)
    depth[inside], triangle[inside] = nearest, ids
    return depth, triangle


def in_image(camera: Camera, points: Floats) -> NDArray[np.bool_]:
    """Return whether image points (P, 2) lie on a pixel of the camera; nan does not."""
    size = np.array([camera.width_px, camera.height_px])
    return np.asarray(((points >= -0.5) & (points <= size - 0.5)).all(axis=1))


def correspondences(
    scene: Scene,
    frame_a: float,
    frame_b: float,
    points: Floats | None = None,
    width: int = 352,
    height: int = 288,
) -> Correspondences:
    """Follow points from one frame to another through the true geometry.

    Parameters
    ----------
    scene : Scene
        Scene from `sequences.rendered_scenes.scene`.
    frame_a, frame_b : float
        Frame numbers.
    points : ndarray of shape (P, 2), float64, optional
        Image points (x, y) of frame a; all pixel centres if None.
    width, height : int
        Image size in pixels.

    Returns
    -------
    Correspondences
        Positions and visibility of the points in frame b.

    Raises
    ------
    ValueError
        If `points` has a wrong shape.
    """
    at = pixel_grid(width, height) if points is None else np.asarray(points, dtype=np.float64)
    if at.ndim != 2 or at.shape[1] != 2:
        raise ValueError(f"`points` must have shape (P, 2), got {at.shape}")
    a, b = scene.camera(frame_a, width, height), scene.camera(frame_b, width, height)
    depth_a, triangle_a = depth_at(scene, a, at)
    sky = np.isinf(depth_a)
    in_b, expected = project(b, back_project(a, at, np.where(sky, 1.0, depth_a)))
    far = ray_directions(a, at[sky]) @ b.cam_from_world[:, :3].T @ b.K.T
    in_b[sky], expected[sky] = far[:, :2] / far[:, 2:], np.where(far[:, 2] > 0, np.inf, -1.0)
    in_b[~(expected > _kernels.NEAR_M)] = np.nan
    depth_b, triangle_b = depth_at(scene, b, in_b)
    with np.errstate(invalid="ignore"):
        near = np.abs(depth_b - expected) <= DEPTH_TOLERANCE * expected
    same = (triangle_a == triangle_b) & (np.isfinite(depth_b) | sky)
    visible = in_image(b, in_b) & ((near & ~sky) | (same & (np.isinf(depth_b) == sky)))
    return Correspondences(at, in_b, depth_a, visible)
