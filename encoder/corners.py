"""Corners of a frame that are worth tracking: the detector of Harris and Stephens, spread over the frame."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.tracks import FeaturePoints
from dvc.tracks.point_sets import column_scan
from dvc.video.frames import Plane
from encoder import _kernels

Points = NDArray[np.int64]

_MARGIN_PX = 3  # where the gradients see the repeated border


@dataclass(frozen=True)
class CornerSettings:
    """How corners are chosen."""

    window_px: int = 9  # side of the window whose gradients count
    sensitivity: float = 0.04  # factor of the squared trace in the response
    # Weakest response, as a share of the response of a checkerboard of full contrast.
    min_response: float = 1e-7
    min_distance: float = 0.5  # of two corners, in units of the distance they had on a square grid
    grid_px: int = 1  # corners lie where both coordinates are multiples of this


def find_corners(
    luma: Plane, max_corners: int, margin_px: int, settings: CornerSettings | None = None
) -> Points:
    """Find corners: where the gradients of a window point in more than one direction.

    Parameters
    ----------
    luma : ndarray of shape (H, W), uint8
        The frame.
    max_corners : int
        Most corners wanted.
    margin_px : int
        Least distance from the frame's border.
    settings : CornerSettings, optional
        How they are chosen.

    Returns
    -------
    ndarray of shape (N, 2), int64
        Points (x, y), strongest first; none in a frame that is flat or too small.

    References
    ----------
    Harris and Stephens, "A combined corner and edge detector", 1988.
    """
    settings = settings or CornerSettings()
    grid = settings.grid_px
    first = -(-margin_px // grid) * grid
    if min(luma.shape) < first + margin_px + 1:
        return np.empty((0, 2), np.int64)
    response = _response(luma, settings)[first : luma.shape[0] - margin_px : grid]
    response = response[:, first : luma.shape[1] - margin_px : grid]
    rows, columns = np.nonzero(_is_maximum(response) & (response > settings.min_response))
    order = np.argsort(-response[rows, columns], kind="stable")
    x, y = columns[order] * grid + first, rows[order] * grid + first
    min_distance_px = settings.min_distance * (luma.size / max_corners) ** 0.5
    chosen = np.empty(max_corners, np.int64)
    count = _kernels.spread(x, y, min_distance_px**2, chosen)
    chosen = chosen[:count]
    return np.stack([x[chosen], y[chosen]], axis=-1)


class CornerDetector:
    """Finds the corners of Wyner-Ziv frames, each frame by itself.

    Parameters
    ----------
    num_points : int
        Most corners of a frame.
    settings : CornerSettings, optional
        How they are chosen.
    """

    def __init__(self, num_points: int, settings: CornerSettings | None = None) -> None:
        self._num_points = num_points
        self._settings = settings or CornerSettings(window_px=5, min_distance=0.4)
        self.num_corners = 0
        self.cpu_s = 0.0

    def detect(self, frames: Sequence[Plane]) -> FeaturePoints:
        """Find the corners of frames.

        Parameters
        ----------
        frames : sequence of ndarray of shape (H, W), uint8
            Luma of each frame.

        Returns
        -------
        FeaturePoints
            Column by column.
        """
        started = time.process_time()
        found = []
        for luma in frames:
            points = find_corners(luma, self._num_points, _MARGIN_PX, self._settings)
            found.append(points[column_scan(points)].astype(np.float64))
        self.num_corners += sum(map(len, found))
        self.cpu_s += time.process_time() - started
        return FeaturePoints(tuple(found))


def _response(luma: Plane, settings: CornerSettings) -> NDArray[np.float32]:
    import cv2

    return np.asarray(cv2.cornerHarris(luma, settings.window_px, 3, settings.sensitivity))


def _is_maximum(response: NDArray[np.float32]) -> NDArray[np.bool_]:
    import cv2

    return np.asarray(cv2.dilate(response, np.ones((3, 3), np.uint8)) == response)
