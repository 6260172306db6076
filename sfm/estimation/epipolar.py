"""Epipolar geometry: lines, epipoles, distances, and fundamental matrices of cameras."""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import PixelFrame, homogeneous

Floats = NDArray[np.float64]

TINY = 1e-300  # keeps a point on an epipole, which has no line, from dividing by zero


def skew(vector: Floats) -> Floats:
    """Return the matrix of the cross product with a vector.

    Parameters
    ----------
    vector : ndarray of shape (3,), float64
        Left factor.

    Returns
    -------
    ndarray of shape (3, 3), float64
        ``skew(v) @ u == cross(v, u)``.
    """
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def unit_norm(fundamental: Floats) -> Floats:
    """Scale a matrix to Frobenius norm 1; a matrix of zeros stays.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        Any matrix that is defined up to scale.

    Returns
    -------
    ndarray of shape (3, 3), float64
        The same matrix, scaled.
    """
    norm = float(np.sqrt((fundamental * fundamental).sum()))
    return fundamental / norm if norm > 0 else fundamental


def epipolar_lines(fundamental: Floats, points: Floats) -> Floats:
    """Find the lines of the second image on which points of the first lie; with ``F.T`` the other way.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0``.
    points : ndarray of shape (N, 2), float64
        Points of the first image.

    Returns
    -------
    ndarray of shape (N, 3), float64
        Lines ``a x + b y + c = 0`` with ``a^2 + b^2 = 1``; zeros for a point on the epipole.

    References
    ----------
    [Maitre2008] Eq. (5.1).
    """
    lines = homogeneous(points) @ fundamental.T
    norm = np.hypot(lines[:, 0], lines[:, 1])
    return lines / np.where(norm > 0, norm, np.inf)[:, None]


def epipoles(fundamental: Floats) -> tuple[Floats, Floats]:
    """Find both epipoles: the image of each camera centre in the other image.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0``.

    Returns
    -------
    first, second : ndarray of shape (3,), float64
        Homogeneous, of unit norm: ``F first = 0`` and ``F' second = 0``. A third entry near zero is an
        epipole at infinity.
    """
    u, _, vt = np.linalg.svd(fundamental)
    return vt[2].copy(), u[:, 2].copy()


def distances_to_epipole(epipole: Floats, points: Floats) -> Floats:
    """Measure how far points are from an epipole.

    Parameters
    ----------
    epipole : ndarray of shape (3,), float64
        Homogeneous, of unit norm, as `epipoles` gives it.
    points : ndarray of shape (N, 2), float64
        Points of the same image.

    Returns
    -------
    ndarray of shape (N,), float64
        Distances in the unit of the points; inf if the epipole is at infinity.
    """
    if abs(epipole[2]) <= 1e-12:
        return np.full(len(points), np.inf)
    offset = points - epipole[:2] / epipole[2]
    distances: Floats = np.hypot(offset[:, 0], offset[:, 1])
    return distances


def _bilinear(fundamental: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats, Floats]:
    """Return x1' F x0, and the squared norms of the normals of ``F x0`` and ``F' x1``."""
    lines_second = homogeneous(first) @ fundamental.T
    lines_first = homogeneous(second) @ fundamental
    product = (homogeneous(second) * lines_second).sum(axis=1)
    return product, (lines_second[:, :2] ** 2).sum(axis=1), (lines_first[:, :2] ** 2).sum(axis=1)


def sampson_distances(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Measure, to first order, how far pairs of points must move to satisfy the epipolar constraint.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0``.
    first, second : ndarray of shape (N, 2), float64
        Points of the first and of the second image.

    Returns
    -------
    ndarray of shape (N,), float64
        Signed distances in the unit of the points.
    """
    product, in_second, in_first = _bilinear(fundamental, first, second)
    distance: Floats = product / np.sqrt(np.maximum(in_second + in_first, TINY))
    return distance


def symmetric_distances(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Measure the distances of pairs of points to each other's epipolar lines.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F, that maps points to lines.
    first, second : ndarray of shape (N, 2), float64
        Pairs of points, one in each image.

    Returns
    -------
    ndarray of shape (N,), float64
        Root mean square of the two distances of each pair, in the unit of the points.
    """
    product, in_second, in_first = _bilinear(fundamental, first, second)
    squared = 0.5 * product * product
    distance: Floats = np.sqrt(squared / np.maximum(in_second, TINY) + squared / np.maximum(in_first, TINY))
    return distance


def fundamental_from_camera(camera: Floats) -> Floats:
    """Find the fundamental matrix of the cameras ``[I | 0]`` and ``[R | t]``.

    Parameters
    ----------
    camera : ndarray of shape (3, 4), float64
        The second camera.

    Returns
    -------
    ndarray of shape (3, 3), float64
        ``[t]x R``, of unit norm; zeros if t is zero.

    References
    ----------
    [Maitre2008] Sec. 5.2.3.
    """
    return unit_norm(skew(camera[:, 3]) @ camera[:, :3])


def fundamental_to_normalized(fundamental: Floats, frame: PixelFrame) -> Floats:
    """Convert a fundamental matrix from pixels to normalised coordinates.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F in pixels.
    frame : PixelFrame
        Size of both images.

    Returns
    -------
    ndarray of shape (3, 3), float64
        F in normalised coordinates, unit norm.
    """
    return unit_norm(frame.pixel_from_normalized.T @ fundamental @ frame.pixel_from_normalized)


def fundamental_to_pixels(fundamental: Floats, frame: PixelFrame) -> Floats:
    """Convert a fundamental matrix to pixels; inverse of `fundamental_to_normalized`.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F in normalised coordinates.
    frame : PixelFrame
        Size of both images.

    Returns
    -------
    ndarray of shape (3, 3), float64
        F in pixels, unit norm.
    """
    return unit_norm(frame.normalized_from_pixel.T @ fundamental @ frame.normalized_from_pixel)
