"""Points of the scene, and where tracks, or else constant velocity, see them between key frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import homogeneous
from dvc.geometry.triangulation import inverse_depths
from sfm.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Points of the scene and where they are at one temporal position."""

    temporal_position: float  # 0 at the first and 1 at the second key frame
    points: Floats  # homogeneous points, as `Model.points` has them
    positions: Floats  # image points in pixels; nan where a point was not seen


def linear_tracks(first: Floats, second: Floats, temporal_position: float) -> Floats:
    """Move points evenly from one key frame to the other."""
    return (1.0 - temporal_position) * first + temporal_position * second


def linear_points(model: Model, temporal_position: float) -> TrackedPoints:
    """Guess where all points of a model are at a temporal position: the tracks of a codec that sends none."""
    pairs = model.correspondences
    positions = linear_tracks(pairs.first, pairs.second, temporal_position)
    return TrackedPoints(temporal_position, model.points, positions)


def tracked_points(
    model: Model, first: Floats, second: Floats, positions: Floats, temporal_position: float
) -> TrackedPoints:
    """Place points that were tracked from key frame to key frame in a scene."""
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
