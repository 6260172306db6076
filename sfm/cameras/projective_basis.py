"""The projective basis: a minimal parametrisation of cameras with constant projections of two points."""

import numpy as np

from dvc.arrays import Floats, Integers
from sfm.decompositions import right_singular
from sfm.estimation.epipolar import distances_to_epipole, epipoles, fundamental_from_camera

CAMERA_NORM = 3.0**0.5
"""Frobenius norm of all projection matrices."""
ERROR_QUANTILE = 0.25
"""Quantile of the reprojection errors that bounds those of the two fixed points."""
EPIPOLE_DISTANCE = 0.15
"""Least distance of the fixed points from the epipoles, in extents of the points."""
MUTUAL_DISTANCE = 0.4
"""Least distance of the fixed points from each other, in extents of the points."""
NUM_TRIALS = 100
"""Number of random pairs before the required distances are halved."""


def normalized_camera(camera: Floats) -> Floats:
    """Scale a camera to `CAMERA_NORM`."""
    return np.asarray(CAMERA_NORM * camera / np.sqrt(max(float((camera * camera).sum()), 1e-300)))


def projection_equations(points: Floats, image: Floats) -> tuple[Floats, Floats]:
    """Return projections of points as linear equations in the twelve entries of the camera."""
    zero = np.zeros_like(points)
    horizontal = np.hstack([points, zero, -image[:, :1] * points])
    vertical = np.hstack([zero, points, -image[:, 1:] * points])
    return horizontal, vertical


def camera_basis(points: Floats, image: Floats) -> Floats:
    """Return a basis (12, 8) of the cameras with given projections of two points."""
    if points.shape != (2, 4) or image.shape != (2, 2):
        raise ValueError(f"two points are needed, got shapes {points.shape} and {image.shape}")
    singular, vt = right_singular(np.stack(projection_equations(points, image), axis=1).reshape(-1, 12))
    if not singular[3] > 1e-12 * singular[0]:
        raise ValueError("the two fixed points must differ")
    return vt[4:].T.copy()


def camera_from_coordinates(basis: Floats, r: Floats) -> Floats:
    """Return the camera with coordinates r in a basis."""
    unit = r / np.sqrt((r * r).sum())
    return np.asarray(CAMERA_NORM * (basis @ unit).reshape(3, 4))


def coordinates_of_camera(basis: Floats, camera: Floats) -> Floats:
    """Project a camera on a basis; inverse of `camera_from_coordinates` for cameras within it."""
    r = basis.T @ camera.ravel()
    return np.asarray(r / np.sqrt((r * r).sum()))


def choose_fixed_points(
    first: Floats, second: Floats, camera: Floats, errors: Floats, rng: np.random.Generator
) -> Integers | None:
    """Draw two points with small errors, far from the epipoles and from each other."""
    finite = np.flatnonzero(np.isfinite(errors))
    if len(finite) < 2:
        return None
    limit = np.quantile(errors[finite], ERROR_QUANTILE)
    candidates = finite[errors[finite] <= limit]
    if len(candidates) < 2:
        candidates = finite
    extent = float(np.hypot(*np.ptp(first[finite], axis=0)))
    if not extent > 0:
        return None
    in_first, in_second = epipoles(fundamental_from_camera(camera))
    epipole_distances = np.minimum(
        distances_to_epipole(in_first, first), distances_to_epipole(in_second, second)
    )
    share = 1.0
    for _ in range(8):
        away = candidates[epipole_distances[candidates] >= share * EPIPOLE_DISTANCE * extent]
        if len(away) >= 2:
            pairs = rng.integers(0, len(away), (NUM_TRIALS, 2))
            offset = first[away[pairs[:, 0]]] - first[away[pairs[:, 1]]]
            apart = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) >= share * MUTUAL_DISTANCE * extent)
            if len(apart):
                pair: Integers = away[pairs[apart[0]]]
                return pair
        share *= 0.5
    # Neither far nor apart: the two extreme points along the axis of largest extent.
    along = first[finite][:, np.argmax(np.ptp(first[finite], axis=0))]
    pair = finite[[np.argmin(along), np.argmax(along)]]
    return pair
