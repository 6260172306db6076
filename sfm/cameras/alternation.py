"""Steps of the alternated reweighted least squares: cameras while depths stay, and the other way round."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import homogeneous
from sfm.cameras.projective_basis import CAMERA_NORM, projection_equations
from sfm.decompositions import least_singular
from sfm.least_squares import normal_matrix

Floats = NDArray[np.float64]

MIN_DEPTH = 1e-12


def nonzero(values: Floats, min_magnitude: float = MIN_DEPTH) -> Floats:
    """Replace values too near zero to divide by."""
    return np.where(np.abs(values) > min_magnitude, values, min_magnitude)


def camera_step(first: Floats, depths: Floats, observed: Floats, kappa: Floats, basis: Floats) -> Floats:
    """Find the camera with the least reweighted error while the depths stay."""
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(first))])
    equations = projection_equations(kappa[:, None] * points, observed)
    normal = normal_matrix(*(rows @ basis for rows in equations))
    camera: Floats = CAMERA_NORM * (basis @ least_singular(normal)).reshape(3, 4)
    return -camera if np.count_nonzero(points @ camera[2] < 0) > 0.5 * len(points) else camera


def depth_step(first: Floats, observed: Floats, camera: Floats, kappa: Floats) -> Floats:
    """Find the depths with the least reweighted error while the camera stays."""
    turned, moved = homogeneous(first) @ camera[:, :3].T, camera[:, 3]
    a = kappa[:, None] * (observed * turned[:, 2:] - turned[:, :2])
    b = kappa[:, None] * (observed * moved[2:] - moved[:2])
    aa, ab = (a * a).sum(axis=1), (a * b).sum(axis=1)
    depths: Floats = np.where(aa > 0, -ab / np.where(aa > 0, aa, 1.0), np.nan)
    return depths


def denominators(first: Floats, depths: Floats, camera: Floats) -> Floats:
    """Return the weights kappa: the inverse depths of the points in a camera."""
    kappa: Floats = 1.0 / nonzero(depths * (homogeneous(first) @ camera[2, :3]) + camera[2, 3])
    return kappa
