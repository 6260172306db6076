"""Corners of a frame that are worth tracking, spread over the frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.corners import SENT_WINDOW_PX, is_local_max, quick_corner_response, spaced
from dvc.tracks import FeaturePoints
from dvc.tracks.point_sets import column_scan
from dvc.video.frames import Plane
from encoder.clock import coding_time_s

Points = NDArray[np.int64]

_CANDIDATES = 20  # for each corner wanted: those that are too near to stronger ones are left out
_SPARSE_GRID_PX = 4  # on which every place is a candidate
_MARGIN_PX = 3  # where the gradients see the repeated border


@dataclass(frozen=True)
class CornerSettings:
    """How corners are chosen."""

    # Corners lie where both coordinates are multiples of this. From 4 on, a corner is a block that can be
    # tracked rather than a place where edges meet: half the resolution is enough to find it.
    grid_px: int = 1
    window_px: int = SENT_WINDOW_PX  # of the gradients that count, at the resolution that is looked at
    min_response: float = 1e-7  # of a corner, at least 0; gradients are in units of the full range of luma
    min_distance: float = 0.4  # of two corners, in units of their distance if they were evenly spread

    def __post_init__(self) -> None:
        """Refuse a grid that half the resolution does not have."""
        if self.grid_px < 1 or (self.grid_px >= _SPARSE_GRID_PX and self.grid_px % 2):
            raise ValueError(f"the grid of corners must be 1, 2, 3 or even, got {self.grid_px}")
        if self.min_response < 0:
            raise ValueError(f"the response to a corner must be at least 0, got {self.min_response}")


TRACKED_CORNERS = CornerSettings(grid_px=4, window_px=3, min_distance=0.65)
"""Corners to be tracked: on a grid, for the sake of their cost, because any place nearby tracks as well; and
far from one another, so that no part of the scene has nearly all of them."""


def find_corners(
    luma: Plane, max_corners: int, margin_px: int, settings: CornerSettings | None = None
) -> Points:
    """Find corners: where the gradients of a window point in more than one direction."""
    settings = settings or CornerSettings()
    grid = settings.grid_px
    first = -(-margin_px // grid) * grid
    last_y, last_x = (side - 1 - margin_px for side in luma.shape)
    if min(last_x, last_y) < first:
        return np.empty((0, 2), np.int64)
    response, shrink = _response(luma, settings)
    step = grid // shrink
    response = response[first // shrink :: step, first // shrink :: step]
    response = response[: (last_y - first) // grid + 1, : (last_x - first) // grid + 1]
    worthy = response > settings.min_response
    if grid < _SPARSE_GRID_PX:
        worthy &= is_local_max(response, 1)
    rows, columns = np.divmod(_strongest(response, worthy, _CANDIDATES * max_corners), response.shape[1])
    points = np.stack([columns, rows], axis=-1) * grid + first
    min_distance_px = settings.min_distance * (luma.size / max_corners) ** 0.5
    return points[spaced(points, max_corners, min_distance_px)]


def _strongest(response: NDArray[np.float32], worthy: NDArray[np.bool_], most: int) -> Points:
    """Return the places in raster order of the largest positive responses, from the largest on."""
    places = np.flatnonzero(worthy)
    # Positive numbers are in the order of their bits; of equal ones the first place comes first.
    keys = response[worthy].view(np.int32).astype(np.int64) << 32
    keys -= places
    keys.sort()
    strongest: Points = -keys[: -most - 1 : -1] & 0xFFFFFFFF
    return strongest


@dataclass
class TrackingWork:
    """What tracking takes: operations of the tracker, and processor time."""

    num_corners: int = 0  # points found
    num_blocks: int = 0  # blocks whose SAD was begun, and samples compared in them
    num_samples: int = 0
    num_frames: int = 0  # frames that were searched
    num_starts: int = 0  # frames in which points to be tracked were found
    num_pairs: int = 0  # pairs of points of which one may be a spatial motion candidate of the other
    num_positions: int = 0  # positions of tracks that were coded after their first
    num_interpolated: int = 0  # blocks compared with what tracks predict of them, and points near to these
    num_near: int = 0
    cpu_s: float = 0.0  # processor time of all that, and of coding tracks or points, in seconds


class CornerDetector:
    """Finds the corners of Wyner-Ziv frames, each frame by itself."""

    def __init__(
        self, num_points: int, settings: CornerSettings | None = None, work: TrackingWork | None = None
    ) -> None:
        self._num_points = num_points
        self._settings = settings or CornerSettings()
        self.work = TrackingWork() if work is None else work

    def detect(self, frames: Sequence[Plane]) -> FeaturePoints:
        """Find the corners of frames."""
        started = coding_time_s()
        found = []
        for luma in frames:
            points = find_corners(luma, self._num_points, _MARGIN_PX, self._settings)
            found.append(points[column_scan(points)].astype(np.float64))
        self.work.num_corners += sum(map(len, found))
        self.work.cpu_s += coding_time_s() - started
        return FeaturePoints(tuple(found))


def _response(luma: Plane, settings: CornerSettings) -> tuple[NDArray[np.float32], int]:
    """Return the response to corners, and how many times smaller than the frame it is."""
    import cv2

    shrink = 2 if settings.grid_px >= _SPARSE_GRID_PX else 1
    if shrink > 1:
        size = (-(-luma.shape[1] // shrink), -(-luma.shape[0] // shrink))
        luma = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
    return quick_corner_response(luma, settings.window_px), shrink
