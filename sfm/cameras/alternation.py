"""Steps of the alternated reweighted least squares: cameras while depths stay, and the other way round."""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import homogeneous
from sfm.cameras.projective_basis import CAMERA_NORM

Floats = NDArray[np.float64]

SMALLEST_DEPTH = 1e-12


def nonzero(values: Floats) -> Floats:
    """Replace values too near zero to divide by.

    Parameters
    ----------
    values : ndarray, float64
        Any values.

    Returns
    -------
    ndarray, float64
        The same, with `SMALLEST_DEPTH` in the place of those whose magnitude is less.
    """
    return np.where(np.abs(values) > SMALLEST_DEPTH, values, SMALLEST_DEPTH)


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
        Weights: the inverse denominators of the projections.
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
    weighted = kappa[:, None] * points
    zero = np.zeros_like(weighted)
    horizontal = np.hstack([-weighted, zero, observed[:, :1] * weighted]) @ basis
    vertical = np.hstack([zero, -weighted, observed[:, 1:] * weighted]) @ basis
    normal = np.einsum("ni,nj->ij", horizontal, horizontal) + np.einsum("ni,nj->ij", vertical, vertical)
    camera: Floats = CAMERA_NORM * (basis @ np.linalg.eigh(normal)[1][:, 0]).reshape(3, 4)
    return -camera if np.count_nonzero(points @ camera[2] < 0) > 0.5 * len(points) else camera


def depth_step(first: Floats, observed: Floats, cameras: Floats, kappa: Floats) -> Floats:
    """Find the depths with the least reweighted error while the cameras stay.

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points of the first frame, normalised.
    observed : ndarray of shape (T, N, 2), float64
        Where the cameras see them.
    cameras : ndarray of shape (T, 3, 4), float64
        Projection matrices.
    kappa : ndarray of shape (T, N), float64
        Weights: the inverse denominators of the projections; 0 where a point was not seen.

    Returns
    -------
    ndarray of shape (N,), float64
        Depths in the first camera; nan where no camera tells.

    References
    ----------
    [Maitre2008] Eq. (B.4).
    """
    turned = homogeneous(first) @ cameras[:, :, :3].transpose(0, 2, 1)
    moved = np.broadcast_to(cameras[:, None, :, 3], turned.shape)
    a = kappa[:, :, None] * (observed * turned[:, :, 2:] - turned[:, :, :2])
    b = kappa[:, :, None] * (observed * moved[:, :, 2:] - moved[:, :, :2])
    aa, ab = (a * a).sum(axis=(0, 2)), (a * b).sum(axis=(0, 2))
    depths: Floats = np.where(aa > 0, -ab / np.where(aa > 0, aa, 1.0), np.nan)
    return depths


def denominators(first: Floats, depths: Floats, camera: Floats) -> Floats:
    """Return the weights kappa: the inverse depths of the points in a camera.

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points of the first frame, normalised.
    depths : ndarray of shape (N,), float64
        Depths in the first camera.
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
