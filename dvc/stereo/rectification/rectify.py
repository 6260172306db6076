"""Rectification of calibrated cameras: their lattice, a common crop of their pictures, and refined pairs."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from dvc.arrays import Floats, Mask, Singles
from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import LARGEST, Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.rectification.camera_lattice import (
    Lattice,
    Orientation,
    as_positions,
    assign_positions,
    fit_lattice,
    snapped,
    upright,
)
from dvc.stereo.rectification.rectified_space import Rectification

MAX_GROWTH = 1.25
"""Largest ratio of the pixels of a rectified picture and an original, by cropping and scaling."""
MIN_COVERED = 0.15
"""Mean share of covered pixels of a row or column that is not cropped."""
USUAL_PARALLAX = 0.25
"""Parallax of the nearest point between the farthest cameras if depth is unknown, in picture widths."""
POSITION_TOLERANCE_PX = 0.25
"""Largest change of parallax from snapping cameras to the lattice."""
_CELLS = 128
_INWARDS = np.diag([1, 1, -1, -1])
MAX_ERROR_PX = 1.5
"""Largest distance of matches from their epipolar lines."""
MIN_MATCHES = 30
GOOD_ROWS_PX = 0.5
"""Error of rows of a calibration that is not refined."""
MIN_GAIN = 0.1
"""Smallest relative gain in rms error of a refinement."""
_SEED = 0
_NOISE_PX = 0.3
_TURN_SIGMA = np.radians(0.3)
_FOCAL_SIGMA = 0.005
_MAX_SIGMAS = 6.0


def rectify(
    cameras: Sequence[Camera],
    positions: Sequence[LatticePosition] | None = None,
    points: Floats | None = None,
) -> Rectification:
    """Find the rectified space of cameras, and the crop with the best overlap of their pictures.

    Parameters
    ----------
    cameras : sequence of Camera
        At least two.
    positions : sequence of LatticePosition, optional
        Their positions, up to the signs of m and n; by default from the centres. Centres off the lattice
        get real-valued positions.
    points : ndarray of shape (N, 3), float64, optional
        Points of the scene, for cameras that are slightly off a plane.

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
        raise ConfigError("the cameras are at one point: nothing has parallax")
    orientation = mean_orientation(cameras)
    if positions is None:
        lattice, coordinates = assign_positions(centres, orientation)
    else:
        given = np.array(positions, dtype=np.float64)
        _check_apart(cameras, given, "have one position")
        lattice, coordinates = upright(fit_lattice(centres, given, orientation), given, orientation)
    focal = float(np.mean([camera.focal_length_px for camera in cameras]))
    width = max(camera.size[0] for camera in cameras)
    lowest, highest = _disparity_range(lattice, coordinates, points, focal, width)
    coordinates = snapped(lattice, centres, coordinates, POSITION_TOLERANCE_PX / highest)
    _check_apart(cameras, coordinates, "were taken from one point")
    middle = 0.5 * (lowest + highest)
    bare = Rectification(tuple(cameras), lattice, as_positions(coordinates), focal, middle)
    return _cropped(bare)


def _check_apart(cameras: Sequence[Camera], points: Floats, message: str) -> None:
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.diag(np.full(len(points), np.inf))
    first, second = np.unravel_index(apart.argmin(), apart.shape)
    if apart[first, second] <= 1e-3 * np.ptp(points, axis=0).max():
        raise ConfigError(f"{cameras[first].name} and {cameras[second].name} {message}")


def mean_orientation(cameras: Sequence[Camera]) -> Orientation:
    """Return the mean orientation of cameras."""
    axes = np.mean([camera.R for camera in cameras], axis=0)
    lengths = np.linalg.norm(axes, axis=1)
    if lengths.min() < 0.2:
        raise ConfigError("the cameras look in opposite directions: such views cannot be rectified together")
    right, down, forward = axes / lengths[:, None]
    return Orientation(right, down, forward)


def _disparity_range(
    lattice: Lattice, coordinates: Floats, points: Floats | None, focal: float, width: int
) -> tuple[float, float]:
    """Return the range of disparities of points in the frame of the equations, or a usual one."""
    if points is not None and len(points):
        distance = lattice.coordinates(points)[:, 2]
        if np.any(distance > 0.0):
            lowest, highest = np.quantile(focal / distance[distance > 0.0], (0.01, 0.99))
            return float(lowest), float(highest)
    return 0.0, usual_disparity(as_positions(coordinates), width)


def usual_disparity(positions: Sequence[LatticePosition], width: int) -> float:
    """Return the disparity with a parallax of `USUAL_PARALLAX` between the farthest cameras."""
    extent = np.ptp(np.array(positions), axis=0)
    return USUAL_PARALLAX * width / float(np.hypot(*extent))


def _cropped(bare: Rectification) -> Rectification:
    """Choose offset and shift that align the middles of the pictures, a window round them, and its scale."""
    positions = np.array(bare.positions)
    borders = [bare.border(index) for index in range(len(bare.cameras))]
    middles = np.stack([_middle_of_view(bare, index) for index in range(len(bare.cameras))])
    spread = positions - positions.mean(axis=0)
    shift = -float((spread * middles).sum() / (spread**2).sum())
    hulls = [
        cv2.convexHull((border + position * shift).astype(np.float32))[:, 0]
        for border, position in zip(borders, positions, strict=True)
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


def _window(hulls: Sequence[Singles], most: float) -> tuple[Floats, Floats]:
    """Return the corners of a window round pictures; crop sides with low coverage if it is large."""
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
        if shares[side] >= MIN_COVERED:
            break
        left, top, right, bottom = np.add((left, top, right, bottom), _INWARDS[side])
    return low + cell * (left, top), low + cell * (right, bottom)


def _middle_of_view(rectification: Rectification, index: int) -> Floats:
    width, height = rectification.cameras[index].size
    middle = np.array([[0.5 * (width - 1), 0.5 * (height - 1)]])
    return np.asarray(rectification.rectified_points(index, middle)[0])


def refined_pair(cameras: Sequence[Camera], first: Floats, second: Floats) -> tuple[Camera, ...]:
    """Tilt and roll two cameras, and balance their focal lengths, until the rows of matches agree."""
    from scipy.optimize import least_squares

    inliers = _consistent(first, second)
    if np.count_nonzero(inliers) < MIN_MATCHES:
        return tuple(cameras)
    first, second = first[inliers], second[inliers]
    bare = rectify(cameras, (LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)))

    def _rows(correction: Floats) -> Floats:
        changed = replace(bare, cameras=_corrected(cameras, correction))
        return np.asarray((changed.rectified_points(0, first) - changed.rectified_points(1, second))[:, 1])

    sigmas = np.array([_TURN_SIGMA] * 4 + [_FOCAL_SIGMA])
    solved = least_squares(
        lambda x: np.concatenate([_rows(x * sigmas), _NOISE_PX * x]), np.zeros(5), max_nfev=100
    )
    before, after = (float(np.sqrt((_rows(x * sigmas) ** 2).mean())) for x in (np.zeros(5), solved.x))
    gains = before > GOOD_ROWS_PX and after < (1.0 - MIN_GAIN) * before
    if not gains or np.abs(solved.x).max() > _MAX_SIGMAS:
        return tuple(cameras)
    return _corrected(cameras, solved.x * sigmas)


def _consistent(first: Floats, second: Floats) -> Mask:
    """Return the mask of matches that one epipolar geometry explains."""
    import pycolmap

    options = pycolmap.RANSACOptions(max_error=MAX_ERROR_PX, random_seed=_SEED, num_threads=1)
    answer = pycolmap.estimate_fundamental_matrix(first, second, options) if len(first) >= 8 else None
    if answer is None:
        return np.zeros(len(first), dtype=np.bool_)
    return np.asarray(answer["inlier_mask"], dtype=np.bool_)


def _corrected(cameras: Sequence[Camera], correction: Floats) -> tuple[Camera, ...]:
    """Apply tilt and roll of both cameras, radians, and half the log of the ratio of their focal lengths."""
    from scipy.spatial.transform import Rotation

    corrected = []
    for camera, (tilt, roll), sign in zip(cameras, correction[:4].reshape(2, 2), (1.0, -1.0), strict=True):
        R = Rotation.from_rotvec([tilt, 0.0, roll]).as_matrix() @ camera.R
        scale = float(np.exp(sign * correction[4]))
        K = camera.K * np.array([[scale, scale, 1.0], [1.0, scale, 1.0], [1.0, 1.0, 1.0]])
        corrected.append(replace(camera, K=K, R=R, t=-R @ camera.centre))
    return tuple(corrected)
