"""Steps of the alternated reweighted least squares: cameras while depths stay, and the other way round."""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import homogeneous
from sfm.cameras.projective_basis import CAMERA_NORM, projection_equations
from sfm.least_squares import normal_matrix

Floats = NDArray[np.float64]

MIN_DEPTH = 1e-12


def nonzero(values: Floats, min_magnitude: float = MIN_DEPTH) -> Floats:
    """Replace values too near zero to divide by.

    Parameters
    ----------
    values : ndarray, float64
        Any values.
    min_magnitude : float
        What takes the place of those whose magnitude is less.

    Returns
    -------
    ndarray, float64
        The same otherwise.
    """
    return np.where(np.abs(values) > min_magnitude, values, min_magnitude)


def camera_step(first: Floats, depths: Floats, observed: Floats, kappa: Floats, basis: Floats) -> Floats:
    """Find the camera with the least reweighted error while the depths stay.

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points of the first frame, normalised.
    depths : ndarray of shape (N,), float64
        Depths in the first camera.
    observed : ndarray of shape (N, 2), float64
        Where the camera sees them.
    kappa : ndarray of shape (N,), float64
        Weights, from `denominators`.
    basis : ndarray of shape (12, K), float64
        W, or the identity for a free camera.

    Returns
    -------
    ndarray of shape (3, 4), float64
        Projection matrix, Frobenius norm sqrt(3), with most of the points before it.

    References
    ----------
    [Maitre2008] Eqs. (B.2) and (B.3).
    """
    points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(first))])
    equations = projection_equations(kappa[:, None] * points, observed)
    normal = normal_matrix(*(rows @ basis for rows in equations))
    camera: Floats = CAMERA_NORM * (basis @ np.linalg.eigh(normal)[1][:, 0]).reshape(3, 4)
    return -camera if np.count_nonzero(points @ camera[2] < 0) > 0.5 * len(points) else camera


def depth_step(first: Floats, observed: Floats, camera: Floats, kappa: Floats) -> Floats:
    """Find the depths with the least reweighted error while the camera stays.

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points of the first frame, normalised.
    observed : ndarray of shape (N, 2), float64
        Where the camera sees them.
    camera : ndarray of shape (3, 4), float64
        Projection matrix.
    kappa : ndarray of shape (N,), float64
        Weights: the inverse denominators of the projections.

    Returns
    -------
    ndarray of shape (N,), float64
        Depths in the first camera; nan where the camera does not tell.

    References
    ----------
    [Maitre2008] Eq. (B.4).
    """
    turned, moved = homogeneous(first) @ camera[:, :3].T, camera[:, 3]
    a = kappa[:, None] * (observed * turned[:, 2:] - turned[:, :2])
    b = kappa[:, None] * (observed * moved[2:] - moved[:2])
    aa, ab = (a * a).sum(axis=1), (a * b).sum(axis=1)
    depths: Floats = np.where(aa > 0, -ab / np.where(aa > 0, aa, 1.0), np.nan)
    return depths


def denominators(first: Floats, depths: Floats, camera: Floats) -> Floats:
    """Return the weights kappa: the inverse depths of the points in a camera.

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points of the first frame, normalised.
    depths : ndarray of shape (N,), float64
        In the first camera.
    camera : ndarray of shape (3, 4), float64
        Projection matrix.

    Returns
    -------
    ndarray of shape (N,), float64
        Weights.

    References
    ----------
    [Maitre2008] Eq. (B.1).
    """
    kappa: Floats = 1.0 / nonzero(depths * (homogeneous(first) @ camera[2, :3]) + camera[2, 3])
    return kappa
