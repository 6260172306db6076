"""Corners of a frame that are worth tracking, spread over the frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Integers
from dvc.corners import SENT_WINDOW_PX, is_local_max, quick_corner_response, spaced
from dvc.tracks import FeaturePoints
from dvc.tracks.coding import column_scan
from dvc.video.frames import Plane
from encoder.encoder_report import TrackingWork, coding_time_s

_CANDIDATES = 20  # candidates per corner: those too near to stronger ones are dropped
_SPARSE_GRID_PX = 4  # grid with a candidate at every position
_MARGIN_PX = 3  # margin of gradients that contain the repeated border


@dataclass(frozen=True)
class CornerSettings:
    """Settings of the choice of corners."""

    # Both coordinates of a corner are multiples of this: 1, 2, 3 or even. From 4 on, a corner is a trackable
    # block rather than a junction of edges: half the resolution is enough to detect it.
    grid_px: int = 1
    window_px: int = SENT_WINDOW_PX  # window of the gradients, at the resolution of the response
    min_response: float = 1e-7  # least response, at least 0; gradients in units of the full range of luma
    min_distance: float = 0.4  # least distance of two corners over that of evenly spread ones


TRACKED_CORNERS = CornerSettings(grid_px=4, window_px=3, min_distance=0.65)
"""Settings of corners to be tracked: a grid saves time, since any nearby position tracks as well; a large
distance spreads the corners over the scene."""


def find_corners(
    luma: Plane, max_corners: int, margin_px: int, settings: CornerSettings | None = None
) -> Integers:
    """Detect corners: windows with gradients in more than one direction."""
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


def _strongest(response: NDArray[np.float32], worthy: NDArray[np.bool_], most: int) -> Integers:
    """Return the raster indices of the largest positive responses, largest first."""
    indices = np.flatnonzero(worthy)
    # Positive numbers are in the order of their bits; of equal ones the first index comes first.
    keys = response[worthy].view(np.int32).astype(np.int64) << 32
    keys -= indices
    keys.sort()
    strongest: Integers = -keys[: -most - 1 : -1] & 0xFFFFFFFF
    return strongest


class CornerDetector:
    """Detects the corners of Wyner-Ziv frames, each frame by itself."""

    def __init__(self, num_points: int, work: TrackingWork | None = None) -> None:
        self._num_points, self.work = num_points, work or TrackingWork()

    def detect(self, frames: Sequence[Plane]) -> FeaturePoints:
        """Detect the corners of frames."""
        started = coding_time_s()
        detected = []
        for luma in frames:
            points = find_corners(luma, self._num_points, _MARGIN_PX)
            detected.append(points[column_scan(points)].astype(np.float64))
        self.work.num_corners += sum(map(len, detected))
        self.work.cpu_s += coding_time_s() - started
        return FeaturePoints(tuple(detected))


def _response(luma: Plane, settings: CornerSettings) -> tuple[NDArray[np.float32], int]:
    """Return the response to corners, and the size of the frame over that of the response."""
    import cv2

    shrink = 2 if settings.grid_px >= _SPARSE_GRID_PX else 1
    if shrink > 1:
        size = (-(-luma.shape[1] // shrink), -(-luma.shape[0] // shrink))
        luma = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
    return quick_corner_response(luma, settings.window_px), shrink
