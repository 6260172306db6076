"""Views to be coded: pictures of one size with their viewpoints, on a lattice or of calibrated cameras."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS
from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import NO_DISTORTION, CalibratedViews, Camera
from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint, distance, warp_between
from dvc.images.colour import Picture, luma

_FAR_ORIGIN = 1000.0
"""Largest distance of the origin from the cameras, relative to their baseline: parallax is right to 1e-4."""
_GRID = 9
"""Points along each side of a picture at which parallax is measured."""
_MARGIN = 0.05
"""Margin of depths around those of known points, relative to their range of inverse depths."""


@dataclass(frozen=True, eq=False)
class Views:
    """Pictures of one scene."""

    pictures: tuple[Picture, ...]  # all gray, or all red, green and blue; tuple of (H, W) or (H, W, 3)
    viewpoints: tuple[Viewpoint, ...]  # one for each picture, of one kind
    references: tuple[int, ...] = (0,)  # indices of the views that are coded; the rest is predicted

    def __post_init__(self) -> None:
        if len(self.pictures) < 2 or len(self.pictures) != len(self.viewpoints):
            raise ConfigError(f"{len(self.pictures)} views: at least two are accepted, with a position each")
        if any(picture.shape != self.pictures[0].shape for picture in self.pictures):
            raise ConfigError("views of different sizes: one size is accepted")
        if not self.references or not set(self.references) <= set(range(len(self.pictures))):
            raise ConfigError(f"references {self.references} of {len(self.pictures)} views")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.pictures[0].shape[0], self.pictures[0].shape[1]

    def predicted_from(self, reference: int) -> list[int]:
        """Return the views that a reference predicts: those with no nearer reference."""
        views = []
        for view, viewpoint in enumerate(self.viewpoints):
            distances = {other: distance(self.viewpoints[other], viewpoint) for other in self.references}
            if view != reference and distances[reference] <= min(distances.values()):
                views.append(view)
        return views or [view for view in range(len(self.pictures)) if view != reference]


def views_of_array(array: CameraArray, references: Sequence[int] = (0,), *, gray: bool = False) -> Views:
    """Return the views of a camera array."""
    pictures, positions = [view.image for view in array], [view.position for view in array]
    return views_of_pictures(pictures, positions, references, gray=gray)


def views_of_pictures(
    pictures: Sequence[Picture],
    viewpoints: Sequence[Viewpoint],
    references: Sequence[int] = (0,),
    *,
    gray: bool = False,
) -> Views:
    """Return views; only their luma if no picture has any colour."""
    gray = gray or all(picture.ndim == 2 or not np.ptp(picture, axis=2).any() for picture in pictures)
    planes = tuple(luma(picture) if gray else picture for picture in pictures)
    return Views(planes, tuple(viewpoints), tuple(references))


def views_of_cameras(
    pictures: Sequence[Picture],
    cameras: Sequence[Camera],
    references: Sequence[int] = (0,),
    *,
    gray: bool = False,
) -> Views:
    """Return the views of calibrated cameras."""
    distorted = next((camera.name for camera in cameras if camera.distortion != NO_DISTORTION), None)
    if distorted is not None:
        raise ConfigError(f"camera of {distorted}: lens distortion; pictures without it are accepted")
    viewpoints = tuple(
        CalibratedViewpoint(camera.K, np.column_stack([camera.R, camera.t])) for camera in cameras
    )
    views = views_of_pictures(pictures, viewpoints, references, gray=gray)
    if max(distance(viewpoints[0], other) for other in viewpoints[1:]) <= 0.0:
        raise ConfigError("all cameras have the same position: no depth can be seen")
    return views


def with_near_origin(given: CalibratedViews) -> CalibratedViews:
    """Move the origin to the first camera if single precision would lose the positions of cameras."""
    centres = np.array([camera.centre for camera in given.cameras])
    first = centres[0]
    span = float(np.linalg.norm(centres - first, axis=1).max())
    if not 0.0 < _FAR_ORIGIN * span < float(np.linalg.norm(centres, axis=1).max()):
        return given
    cameras = tuple(replace(camera, t=camera.t + camera.R @ first) for camera in given.cameras)
    return CalibratedViews(cameras, given.points - first if len(given.points) else given.points)


def depths_of_points(views: Views, points: NDArray[np.float64]) -> tuple[float, float]:
    """Return the range of depths of known points."""
    depths = []
    for index in views.references:
        viewpoint = views.viewpoints[index]
        assert isinstance(viewpoint, CalibratedViewpoint)
        depths.append(points @ viewpoint.pose[2, :3] + viewpoint.pose[2, 3])
    values = np.concatenate(depths)
    inverse = 1.0 / values[values > 0.0]
    if inverse.size < 2 or inverse.min() == inverse.max():
        raise ConfigError("--depths NEAR:FAR is needed: no points of the scene are known")
    margin = _MARGIN * float(np.ptp(inverse))
    lowest = float(inverse.min()) - margin
    return 1.0 / (float(inverse.max()) + margin), 1.0 / lowest if lowest > 0.0 else math.inf


def labels_of_depths(views: Views, near: float, far: float, num_labels: int | None = None) -> DisparityLabels:
    """Return labels that are even in inverse depth, by default at most a pixel of parallax apart."""
    lowest, highest = 1.0 / far, 1.0 / near
    if num_labels is None:
        parallax = _largest_parallax(views, lowest, highest)
        if not parallax <= MAX_LABELS - 1:
            raise ConfigError(
                f"depths from {near:g} to {far:g}: more than {MAX_LABELS} labels a pixel apart; "
                "--depths NEAR:FAR:LABELS sets their number"
            )
        num_labels = max(math.ceil(parallax), 1) + 1
    return DisparityLabels(lowest, (highest - lowest) / (num_labels - 1), num_labels)


def _largest_parallax(views: Views, lowest: float, highest: float) -> float:
    """Return the parallax in pixels over all inverse depths, for the two views farthest apart."""
    pairs = [(a, b) for a in views.viewpoints for b in views.viewpoints if a is not b]
    warp = warp_between(*max(pairs, key=lambda pair: distance(*pair)))
    height, width = views.shape
    x, y = np.meshgrid(np.linspace(0.0, width - 1.0, _GRID), np.linspace(0.0, height - 1.0, _GRID))
    start = warp[:, :3] @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    move = warp[:, 3:]
    fastest = 0.0
    for inverse_depth in (lowest, highest):
        scale = start[2] + inverse_depth * move[2]
        in_front = scale > 1e-9
        speed = np.hypot(*(move[:2] * start[2] - start[:2] * move[2]))[in_front] / scale[in_front] ** 2
        fastest = max(fastest, float(speed.max(initial=0.0)))
    return fastest * (highest - lowest)
