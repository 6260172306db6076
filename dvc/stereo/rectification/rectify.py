"""Rectification of calibrated cameras: their lattice, and a common crop of their pictures."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.calibration.cameras import LARGEST, Camera
from dvc.errors import ConfigError
from dvc.multiview.camera_array import LatticePosition
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

MAX_GROWTH = 2.0
"""Of a side of the rectified pictures over that of the originals; what lies beyond is cropped."""
USUAL_PARALLAX = 0.25
"""Of the nearest point between the farthest cameras, in widths of a picture, where no depth is known."""
POSITION_TOLERANCE_PX = 0.25
"""Cameras count as standing on the lattice if this changes no parallax by more."""


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
    """Choose offset and shift so that the middles of the pictures meet, and a window round all pictures."""
    places = np.array(bare.positions)
    borders = [bare.border(index) for index in range(len(bare.cameras))]
    middles = np.stack([_middle_of_view(bare, index) for index in range(len(bare.cameras))])
    spread = places - places.mean(axis=0)
    shift = -float((spread * middles).sum() / (spread**2).sum())
    moved = [border + place * shift for border, place in zip(borders, places, strict=True)]
    low, high = (end(np.concatenate(moved), axis=0) for end in (np.min, np.max))
    target = (middles + places * shift).mean(axis=0)
    largest = np.max([camera.size for camera in bare.cameras], axis=0)
    room = 0.5 * (MAX_GROWTH * largest - 1)
    low, high = np.maximum(low, target - room), np.minimum(high, target + room)
    width, height = (int(side) for side in np.ceil(high - low - 1e-3).astype(np.int64) + 1)
    return Rectification(
        bare.cameras,
        bare.lattice,
        bare.positions,
        bare.focal_length_px,
        bare.middle_disparity,
        (-float(low[0]), -float(low[1])),
        shift,
        (width, height),
    )


def _middle_of_view(rectification: Rectification, index: int) -> Floats:
    width, height = rectification.cameras[index].size
    middle = np.array([[0.5 * (width - 1), 0.5 * (height - 1)]])
    return np.asarray(rectification.rectified_points(index, middle)[0])
