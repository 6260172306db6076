"""Rectification of calibrated cameras: their lattice, and a common crop of their pictures."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import LARGEST, Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.rectification.lattice import (
    Lattice,
    Orientation,
    as_positions,
    assign_positions,
    fit_lattice,
    snapped,
    upright,
)
from dvc.stereo.rectification.rectified_space import Rectification

Floats = NDArray[np.float64]

MAX_GROWTH = 1.25
"""Of the pixels of a rectified picture over those of an original; beyond, it is cropped and made smaller."""
LEAST_COVERED = 0.15
"""Share of a row or column that pictures cover, on the mean, beyond which nothing is cropped."""
USUAL_PARALLAX = 0.25
"""Of the nearest point between the farthest cameras, in widths of a picture, where no depth is known."""
POSITION_TOLERANCE_PX = 0.25
"""Cameras count as standing on the lattice if this changes no parallax by more."""
_CELLS = 128
_INWARDS = np.diag([1, 1, -1, -1])


def rectify(
    cameras: Sequence[Camera],
    positions: Sequence[LatticePosition] | None = None,
    points: Floats | None = None,
) -> Rectification:
    """Find the rectified space of cameras, and the crop in which their pictures lie best over each other.

    Parameters
    ----------
    cameras : sequence of Camera
        At least two.
    positions : sequence of LatticePosition, optional
        Their places, up to the signs of m and n; found from the centres if None. Centres that do not stand
        on the lattice so given get real-valued places.
    points : ndarray of shape (N, 3), float64, optional
        Points of the scene, for cameras that are not quite in a plane.

    Returns
    -------
    Rectification
        With the cameras in this order.

    Raises
    ------
    ConfigError
        If the cameras span no lattice, or a picture looks along the plane of the cameras.
    """
    if len(cameras) < 2:
        raise ConfigError("at least two views are needed")
    centres = np.stack([camera.centre for camera in cameras])
    if np.ptp(centres, axis=0).max() < 1.0 / LARGEST:
        raise ConfigError("the cameras stand at one place: nothing has parallax")
    orientation = mean_orientation(cameras)
    if positions is None:
        lattice, places = assign_positions(centres, orientation)
    else:
        told = np.array(positions, dtype=np.float64)
        _check_apart(cameras, told, "have one position")
        lattice, places = upright(fit_lattice(centres, told, orientation), told, orientation)
    focal = float(np.mean([camera.focal_length_px for camera in cameras]))
    width = max(camera.size[0] for camera in cameras)
    lowest, highest = _disparity_range(lattice, places, points, focal, width)
    places = snapped(lattice, centres, places, POSITION_TOLERANCE_PX / highest)
    _check_apart(cameras, places, "were taken from one place")
    middle = 0.5 * (lowest + highest)
    bare = Rectification(tuple(cameras), lattice, as_positions(places), focal, middle)
    return _cropped(bare)


def _check_apart(cameras: Sequence[Camera], places: Floats, message: str) -> None:
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + np.diag(np.full(len(places), np.inf))
    first, second = np.unravel_index(apart.argmin(), apart.shape)
    if apart[first, second] <= 1e-3 * np.ptp(places, axis=0).max():
        raise ConfigError(f"{cameras[first].name} and {cameras[second].name} {message}")


def mean_orientation(cameras: Sequence[Camera]) -> Orientation:
    """Return how cameras look, on the mean."""
    axes = np.mean([camera.R for camera in cameras], axis=0)
    lengths = np.linalg.norm(axes, axis=1)
    if lengths.min() < 0.2:
        raise ConfigError("the cameras look in opposite directions: such views cannot be rectified together")
    right, down, forward = axes / lengths[:, None]
    return Orientation(right, down, forward)


def _disparity_range(
    lattice: Lattice, places: Floats, points: Floats | None, focal: float, width: int
) -> tuple[float, float]:
    """Return the range of disparities of points in the frame of the equations, or a usual one."""
    if points is not None and len(points):
        distance = lattice.coordinates(points)[:, 2]
        if np.any(distance > 0.0):
            lowest, highest = np.quantile(focal / distance[distance > 0.0], (0.01, 0.99))
            return float(lowest), float(highest)
    return 0.0, usual_disparity(as_positions(places), width)


def usual_disparity(positions: Sequence[LatticePosition], width: int) -> float:
    """Return the disparity at which the farthest cameras see a parallax of `USUAL_PARALLAX`."""
    extent = np.ptp(np.array(positions), axis=0)
    return USUAL_PARALLAX * width / float(np.hypot(*extent))


def _cropped(bare: Rectification) -> Rectification:
    """Choose offset and shift so that the middles of the pictures meet, a window round them, its scale."""
    places = np.array(bare.positions)
    borders = [bare.border(index) for index in range(len(bare.cameras))]
    middles = np.stack([_middle_of_view(bare, index) for index in range(len(bare.cameras))])
    spread = places - places.mean(axis=0)
    shift = -float((spread * middles).sum() / (spread**2).sum())
    hulls = [
        cv2.convexHull((border + place * shift).astype(np.float32))[:, 0]
        for border, place in zip(borders, places, strict=True)
    ]
    num_pixels = float(np.mean([np.prod(camera.size) for camera in bare.cameras]))
    shown = float(np.mean([cv2.contourArea(hull) for hull in hulls]))
    low, high = _window(hulls, MAX_GROWTH * max(num_pixels, shown))
    growth = float(np.prod(high - low)) / num_pixels
    scale = min(1.0, np.sqrt(MAX_GROWTH / growth))
    width, height = (int(side) for side in np.ceil(scale * (high - low) - 1e-3).astype(np.int64) + 1)
    return replace(
        bare,
        focal_length_px=scale * bare.focal_length_px,
        middle_disparity=scale * bare.middle_disparity,
        offset=(-scale * float(low[0]), -scale * float(low[1])),
        disparity_shift=scale * shift,
        size=(width, height),
    )


def _window(hulls: Sequence[NDArray[np.float32]], most: float) -> tuple[Floats, Floats]:
    """Return the corners of a window round pictures, without sides that few of them cover if it is large."""
    corners = np.concatenate(hulls).astype(np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    cell = (high - low) / _CELLS
    covered = np.zeros((_CELLS, _CELLS))
    for hull in hulls:
        mask = np.zeros((_CELLS, _CELLS), np.uint8)
        covered += cv2.fillConvexPoly(mask, np.floor((hull - low) / cell).astype(np.int32), 1) / len(hulls)
    left, top, right, bottom = 0, 0, _CELLS, _CELLS
    while (right - left) * (bottom - top) * np.prod(cell) > most:
        inner = covered[top:bottom, left:right]
        shares = inner[:, 0].mean(), inner[0].mean(), inner[:, -1].mean(), inner[-1].mean()
        side = int(np.argmin(shares))
        if shares[side] >= LEAST_COVERED:
            break
        left, top, right, bottom = np.add((left, top, right, bottom), _INWARDS[side])
    return low + cell * (left, top), low + cell * (right, bottom)


def _middle_of_view(rectification: Rectification, index: int) -> Floats:
    width, height = rectification.cameras[index].size
    middle = np.array([[0.5 * (width - 1), 0.5 * (height - 1)]])
    return np.asarray(rectification.rectified_points(index, middle)[0])
