"""Views of general cameras, and inverse depths to choose from."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS
from dvc.dibr.view_set import Views, views_of_pictures
from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import NO_DISTORTION, CalibratedViews, Camera
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import CalibratedViewpoint, distance, warp_between
from dvc.images.colour import Picture

Floats = NDArray[np.float64]

_FAR_ORIGIN = 1000.0
"""Times the cameras' distance from each other; nearer origins are kept, parallax is then right to 1e-4."""
_GRID = 9
"""Points along each side of a picture at which parallax is looked at."""
_MARGIN = 0.05
"""By how much of the range of known points depths may be nearer or farther, in inverse depth."""


def with_near_origin(given: CalibratedViews) -> CalibratedViews:
    """Move the world to the first camera if it is so far that single precision loses where cameras stand."""
    centres = np.array([camera.centre for camera in given.cameras])
    first = centres[0]
    span = float(np.linalg.norm(centres - first, axis=1).max())
    if not 0.0 < _FAR_ORIGIN * span < float(np.linalg.norm(centres, axis=1).max()):
        return given
    cameras = tuple(replace(camera, t=camera.t + camera.R @ first) for camera in given.cameras)
    return CalibratedViews(cameras, given.points - first if len(given.points) else given.points)


def views_of_cameras(
    pictures: Sequence[Picture],
    cameras: Sequence[Camera],
    references: Sequence[int] = (0,),
    *,
    gray: bool = False,
) -> Views:
    """Return the views of calibrated cameras."""
    bent = next((camera.name for camera in cameras if camera.distortion != NO_DISTORTION), None)
    if bent is not None:
        raise ConfigError(f"camera of {bent}: lens distortion; pictures without it are accepted")
    viewpoints = tuple(
        CalibratedViewpoint(camera.K, np.column_stack([camera.R, camera.t])) for camera in cameras
    )
    views = views_of_pictures(pictures, viewpoints, references, gray=gray)
    if max(distance(viewpoints[0], other) for other in viewpoints[1:]) <= 0.0:
        raise ConfigError("all cameras stand at one place: no depth can be seen")
    return views


def depths_of_points(views: Views, points: Floats) -> tuple[float, float]:
    """Return the range of depths that known points have."""
    depths = np.concatenate([_depths(views.viewpoints[number], points) for number in views.references])
    inverse = 1.0 / depths[depths > 0.0]
    if inverse.size < 2 or inverse.min() == inverse.max():
        raise ConfigError("--depths NEAR:FAR is needed: no points of the scene are known")
    margin = _MARGIN * float(np.ptp(inverse))
    least = float(inverse.min()) - margin
    return 1.0 / (float(inverse.max()) + margin), 1.0 / least if least > 0.0 else math.inf


def _depths(viewpoint: object, points: Floats) -> Floats:
    assert isinstance(viewpoint, CalibratedViewpoint)
    depths: Floats = points @ viewpoint.pose[2, :3] + viewpoint.pose[2, 3]
    return depths


def labels_of_depths(views: Views, near: float, far: float, num_labels: int | None = None) -> DisparityLabels:
    """Return inverse depths to choose from."""
    lowest, highest = 1.0 / far, 1.0 / near
    if num_labels is None:
        parallax = _largest_parallax(views, lowest, highest)
        if not parallax <= MAX_LABELS - 1:
            raise ConfigError(
                f"depths from {near:g} to {far:g}: more than {MAX_LABELS} labels a pixel apart; "
                "--depths NEAR:FAR:LABELS says how many"
            )
        num_labels = max(math.ceil(parallax), 1) + 1
    return DisparityLabels(lowest, (highest - lowest) / (num_labels - 1), num_labels)


def _largest_parallax(views: Views, lowest: float, highest: float) -> float:
    """Pixels that all inverse depths span where they span most, at the pace where that is largest."""
    pairs = [(a, b) for a in views.viewpoints for b in views.viewpoints if a is not b]
    warp = warp_between(*max(pairs, key=lambda pair: distance(*pair)))
    height, width = views.shape
    x, y = np.meshgrid(np.linspace(0.0, width - 1.0, _GRID), np.linspace(0.0, height - 1.0, _GRID))
    start = warp[:, :3] @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    move = warp[:, 3:]
    pace = 0.0
    for inverse_depth in (lowest, highest):
        scale = start[2] + inverse_depth * move[2]
        before = scale > 1e-9
        speed = np.hypot(*(move[:2] * start[2] - start[:2] * move[2]))[before] / scale[before] ** 2
        pace = max(pace, float(speed.max(initial=0.0)))
    return pace * (highest - lowest)
