"""Cameras of the frames between two key frames: each independently, or all along a smooth path."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvc.arrays import Floats
from dvc.geometry.cameras import homogeneous, project
from dvc.geometry.triangulation import inverse_depths
from sfm.cameras.projective_basis import normalized_camera
from sfm.cameras.resection import ExpectedPoints, Resection, resection
from sfm.scene_model import Model

NUM_SWEEPS = 12
"""Largest number of passes; each estimates every camera again with constant neighbours."""
CONVERGED_PX = 0.01
"""Motion of the scene's points in the image, root mean square, below which the passes end."""
JERK_PX = 1.0
"""Second difference above which the cost is linear instead of quadratic: jerks are real."""
_NEAREST = 1e-3
"""Least depth of a point that constrains the path, relative to the median of a camera's points."""


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Points of the scene and their image positions at one temporal position."""

    temporal_position: float  # 0 at the first and 1 at the second key frame
    points: Floats  # homogeneous points, as `Model.points` has them
    positions: Floats  # image points in pixels; nan: not seen


def linear_tracks(first: Floats, second: Floats, temporal_position: float) -> Floats:
    """Interpolate points linearly from one key frame to the other."""
    return (1.0 - temporal_position) * first + temporal_position * second


def linear_points(model: Model, temporal_position: float) -> TrackedPoints:
    """Interpolate all points of a model, as the tracks of a codec that sends none."""
    pairs = model.correspondences
    positions = linear_tracks(pairs.first, pairs.second, temporal_position)
    return TrackedPoints(temporal_position, model.points, positions)


def tracked_points(
    model: Model, first: Floats, second: Floats, positions: Floats, temporal_position: float
) -> TrackedPoints:
    """Triangulate points that were tracked from key frame to key frame."""
    frame = model.pixel_frame
    known = np.asarray(np.isfinite(np.hstack([first, second])).all(axis=1))
    x0 = frame.to_normalized(np.where(known[:, None], first, 0.0))
    x1 = frame.to_normalized(np.where(known[:, None], second, 0.0))
    inverse, quotient = inverse_depths(x0, model.second_camera, x1)
    known &= (inverse > 0) & (quotient > 0)
    depth = 1.0 / np.where(known, inverse, 1.0)
    points = np.column_stack([depth[:, None] * homogeneous(x0), np.ones(len(x0))])
    points[~known] = np.nan
    return TrackedPoints(temporal_position, points, np.where(known[:, None], positions, np.nan))


def interpolated_camera(model: Model, temporal_position: float) -> Floats:
    """Interpolate the camera of a temporal position between those of the key frames."""
    first, second = (1.0 - temporal_position) * model.first_camera, temporal_position * model.second_camera
    return normalized_camera(first + second)


def intermediate_cameras(model: Model, instants: Sequence[TrackedPoints]) -> list[Resection]:
    """Estimate the cameras of any instants, from tracked or interpolated points."""
    return [_camera(model, instant) for instant in instants]


def _camera(model: Model, instant: TrackedPoints, expected: ExpectedPoints | None = None) -> Resection:
    prior = interpolated_camera(model, instant.temporal_position)
    return resection(instant.points, instant.positions, model.pixel_frame, prior, expected)


def regular_cameras(model: Model, instants: Sequence[TrackedPoints], regularity: float) -> list[Resection]:
    """Estimate the cameras of evenly spaced instants along a smooth path."""
    if not regularity >= 0:
        raise ValueError(f"`regularity` must not be negative, got {regularity}")
    found = intermediate_cameras(model, instants)
    if regularity == 0 or not instants:
        return found
    path = _Path(model, instants[0].points, found)
    if path.num_points == 0:
        return found
    for _ in range(NUM_SWEEPS):
        moved_px = 0.0
        for t, instant in enumerate(instants, 1):
            expected = path.expected(t, regularity)
            if expected is None:
                continue
            again = _camera(model, instant, expected)
            if again.success:
                found[t - 1] = again
                moved_px = max(moved_px, path.update(t, again.camera))
        if moved_px < CONVERGED_PX:
            break
    return found


class _Path:
    """Image positions of the scene's points in all frames, key frames included."""

    def __init__(self, model: Model, points: Floats, found: Sequence[Resection]) -> None:
        self._frame = model.pixel_frame
        cameras = [camera.camera if camera.success else None for camera in found]
        every = [model.first_camera, *cameras, model.second_camera]
        known = np.isfinite(points).all(axis=1)
        for camera in every:
            if camera is not None:
                depth = np.where(known, points @ camera[2], 0.0)
                usual = np.median(depth[known]) if known.any() else 0.0
                known &= depth > _NEAREST * usual
        self._points = points[known]
        self._seen = [None if camera is None else self._project(camera) for camera in every]

    @property
    def num_points(self) -> int:
        """Number of points in front of all cameras."""
        return len(self._points)

    def _project(self, camera: Floats) -> Floats:
        positions: Floats = self._frame.to_pixels(project(camera, self._points)[0])
        return positions

    def update(self, t: int, camera: Floats) -> float:
        """Replace a camera; return the motion of the points, root mean square in pixels."""
        before, after = self._seen[t], self._project(camera)
        self._seen[t] = after
        return 0.0 if before is None else _rms(after - before)

    def expected(self, t: int, regularity: float) -> ExpectedPoints | None:
        """Return the points' positions expected from the neighbours of a frame; None without neighbours."""
        here = self._seen[t]
        if here is None:
            return None
        total, positions = 0.0, np.zeros((self.num_points, 2))
        for centre, own in ((t - 1, 1.0), (t, -2.0), (t + 1, 1.0)):
            if not 0 < centre < len(self._seen) - 1:
                continue
            three = self._seen[centre - 1], self._seen[centre], self._seen[centre + 1]
            if three[0] is None or three[1] is None or three[2] is None:
                continue
            difference = three[0] - 2.0 * three[1] + three[2]
            weight = own * own / max(1.0, _rms(difference) / JERK_PX)
            positions += weight * (here - difference / own)
            total += weight
        if total == 0.0:
            return None
        return ExpectedPoints(self._points, positions / total, regularity * total)


def _rms(offsets: Floats) -> float:
    return float(np.sqrt((offsets * offsets).sum(axis=1).mean()))
