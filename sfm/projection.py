"""Projection, triangulation and trifocal transfer with projective cameras."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def homogeneous(points: Floats) -> Floats:
    """Append a third coordinate 1.

    Parameters
    ----------
    points : ndarray of shape (N, 2), float64
        Points of a plane.

    Returns
    -------
    ndarray of shape (N, 3), float64
        The same points.
    """
    return np.column_stack([points, np.ones(len(points))])


def project(camera: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Project 3D points.

    Parameters
    ----------
    camera : ndarray of shape (3, 4), float64
        Projection matrix.
    points : ndarray of shape (N, 4), float64
        Homogeneous 3D points.

    Returns
    -------
    xy : ndarray of shape (N, 2), float64
        Image points; not finite on the focal plane.
    depth : ndarray of shape (N,), float64
        Projective depth; its sign tells on which side of the camera a point lies.
    """
    image = points @ camera.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return image[:, :2] / image[:, 2:], image[:, 2]


def triangulate_depth(first: Floats, camera: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Find the projective depths of correspondences, by least squares of (5.3).

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points seen by the camera ``[I | 0]``, normalised.
    camera : ndarray of shape (3, 4), float64
        The other camera, ``[R | t]``.
    second : ndarray of shape (N, 2), float64
        Points seen by it, normalised.

    Returns
    -------
    depth_first, depth_second : ndarray of shape (N,), float64
        Depths in ``depth_second * x1 = depth_first * R x0 + t``; not finite where the rays are parallel.

    References
    ----------
    [Maitre2008] Eq. (5.3).
    """
    a = homogeneous(first) @ camera[:, :3].T
    b, t = homogeneous(second), camera[:, 3]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    at, bt = a @ t, b @ t
    determinant = aa * bb - ab * ab
    with np.errstate(divide="ignore", invalid="ignore"):
        return (ab * bt - bb * at) / determinant, (aa * bt - ab * at) / determinant


def inverse_depths(first: Floats, camera: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Find the inverse depths that project points of the first image nearest to points of the second.

    Unlike `triangulate_depth` this minimises a distance in the second image, and points at infinity are
    no exception: the nearest point of the epipolar line is found, then the depth that projects there.

    Parameters
    ----------
    first : ndarray of shape (N, 2), float64
        Points seen by the camera ``[I | 0]``, normalised.
    camera : ndarray of shape (3, 4), float64
        The other camera, ``[R | t]``.
    second : ndarray of shape (N, 2), float64
        Points seen by it, normalised.

    Returns
    -------
    inverse : ndarray of shape (N,), float64
        Inverse depth in the first camera: ``R x0 + inverse * t`` is what the second camera sees; 0 for a
        point on the epipole, where all depths are as good.
    ratio : ndarray of shape (N,), float64
        Depth in the second camera over depth in the first.

    References
    ----------
    [Maitre2008] The minimum of (5.6) over the depth.
    """
    a, t = homogeneous(first) @ camera[:, :3].T, camera[:, 3]
    lines = np.cross(t, a)
    norm2 = (lines[:, :2] ** 2).sum(axis=1)
    offset = (lines[:, :2] * second).sum(axis=1) + lines[:, 2]
    foot = homogeneous(second - (offset / np.where(norm2 > 0, norm2, np.inf))[:, None] * lines[:, :2])
    along, across = np.cross(foot, t), np.cross(foot, a)
    along2 = (along * along).sum(axis=1)
    inverse = -(along * across).sum(axis=1) / np.where(along2 > 0, along2, np.inf)
    return inverse, a[:, 2] + inverse * t[2]
