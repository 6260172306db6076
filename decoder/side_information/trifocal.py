"""Trifocal transfer: from a point of one view and its depth, or its match in a second, to any other view.

Cameras are 3x4 matrices in the normalised coordinates of the model, of any scale and sign. Between two views
they become a *transfer*, a 3x4 matrix ``[A | b]`` in pixels: the point x (homogeneous) of the source view
with inverse depth rho lies at ``A x + rho b`` in the target view. Planes are affine in inverse depth,
whatever the camera; it is 0 at infinity and grows towards the camera.
"""

import enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels_3d
from sfm.model import PixelFrame

Floats = NDArray[np.float64]

EPIPOLE_MARGIN_PX = 4.0
"""Points closer than this to the epipole say nothing about depth."""
SINGULAR = 1e-9


class Status(enum.IntEnum):
    """What became of a transferred point."""

    VALID = 0
    BEHIND = 1
    NEAR_EPIPOLE = 2


class Transferred(NamedTuple):
    """Points in another view.

    Attributes
    ----------
    points : ndarray of shape (N, 2), float64
        Image points (x, y) in pixels; the source's own point where the status is not valid.
    inverse_depth : ndarray of shape (N,), float64
        Inverse depth in the source view; 0 where the status is not valid.
    status : ndarray of shape (N,), int8
        A `Status` for each.
    """

    points: Floats
    inverse_depth: Floats
    status: NDArray[np.int8]


def transfer_matrix(source: Floats, target: Floats, frame: PixelFrame) -> Floats:
    """Return the transfer from one camera's view to another's.

    Parameters
    ----------
    source, target : ndarray of shape (3, 4), float64
        Cameras in normalised coordinates.
    frame : PixelFrame
        Size of the images.

    Returns
    -------
    ndarray of shape (3, 4), float64
        ``[A | b]`` in pixels. Transfers of one set of cameras agree: going from a to b and on to c, with the
        inverse depth divided by the third coordinate at b, is going from a to c.

    Raises
    ------
    ValueError
        If a camera has another shape, is not finite, or the source has its centre at infinity.
    """
    for name, camera in (("source", source), ("target", target)):
        if camera.shape != (3, 4) or not np.isfinite(camera).all():
            raise ValueError(f"`{name}` must be a finite 3x4 matrix, got shape {camera.shape}")
    basis = np.vstack([_oriented(source, frame), [0.0, 0.0, 0.0, 1.0]])
    if abs(np.linalg.det(source[:, :3])) < SINGULAR * max(np.abs(source).max(), 1e-300) ** 3:
        raise ValueError("`source` has its centre at infinity")
    matrix: Floats = np.ascontiguousarray(_oriented(target, frame) @ np.linalg.inv(basis))
    return matrix


def _oriented(camera: Floats, frame: PixelFrame) -> Floats:
    """Camera in pixels, with the sign that gives points before it a positive depth."""
    sign = -1.0 if np.linalg.det(camera[:, :3]) < 0 else 1.0
    oriented: Floats = sign * (frame.pixel_from_normalized @ camera)
    return oriented


def inverse_transfer(transfer: Floats) -> Floats:
    """Return the transfer of the way back.

    Parameters
    ----------
    transfer : ndarray of shape (3, 4), float64
        From a to b.

    Returns
    -------
    ndarray of shape (3, 4), float64
        From b to a.
    """
    inverse = np.linalg.inv(transfer[:, :3])
    return np.column_stack([inverse, -inverse @ transfer[:, 3]])


def transfer_surface(
    transfer: Floats, surface: Floats, origin_px: float = 0.0, step_px: float = 1.0
) -> Floats:
    """Transfer every point of a regular grid of inverse depths.

    Parameters
    ----------
    transfer : ndarray of shape (3, 4), float64
        From the grid's view to another.
    surface : ndarray of shape (rows, columns), float64
        Inverse depth of the grid's points.
    origin_px : float
        x and y of the first point.
    step_px : float
        Distance of the points.

    Returns
    -------
    ndarray of shape (rows, columns, 3), float64
        (x, y) in pixels and inverse depth in the other view; (-1e9, -1e9, `_kernels_3d.EMPTY`) behind it.
    """
    moved = np.empty((*surface.shape, 3))
    _kernels_3d.transfer_grid(transfer, surface, origin_px, step_px, moved)
    return moved


def transfer_depths(transfer: Floats, points: Floats, inverse_depth: Floats) -> Transferred:
    """Transfer points of known inverse depth.

    Parameters
    ----------
    transfer : ndarray of shape (3, 4), float64
        From the points' view to another.
    points : ndarray of shape (N, 2), float64
        Image points in pixels.
    inverse_depth : ndarray of shape (N,), float64
        Inverse depth of each.

    Returns
    -------
    Transferred
        Where they are.
    """
    known = np.nan_to_num(inverse_depth)
    image = np.column_stack([points, np.ones(len(points)), known]) @ transfer.T
    before = (image[:, 2] > 1e-6) & np.isfinite(inverse_depth)
    moved = np.where(before[:, None], image[:, :2] / np.where(before, image[:, 2], 1.0)[:, None], points)
    status = np.where(before, Status.VALID, Status.BEHIND).astype(np.int8)
    return Transferred(moved, np.where(before, known, 0.0), status)


def inverse_depths(transfer: Floats, points: Floats, matches: Floats) -> tuple[Floats, NDArray[np.int8]]:
    """Triangulate: find the inverse depths that bring points closest to their matches in another view.

    Parameters
    ----------
    transfer : ndarray of shape (3, 4), float64
        From the points' view to the matches'.
    points, matches : ndarray of shape (N, 2), float64
        Image points in pixels.

    Returns
    -------
    inverse_depth : ndarray of shape (N,), float64
        Linear least squares of (5.3); 0 where there is none.
    status : ndarray of shape (N,), int8
        A `Status` for each.

    References
    ----------
    [Maitre2008] Eq. (5.3).
    """
    at_infinity = np.column_stack([points, np.ones(len(points))]) @ transfer[:, :3].T
    towards = transfer[:, 3]
    constant = at_infinity[:, :2] - matches * at_infinity[:, 2:]
    slope = towards[:2] - matches * towards[2]
    squared = (slope * slope).sum(axis=1)
    # slope / |b_3| is the way from the epipole to the match; one at infinity is near nothing
    near = squared <= (EPIPOLE_MARGIN_PX * towards[2]) ** 2 + SINGULAR
    inverse_depth = np.where(near, 0.0, -(constant * slope).sum(axis=1) / np.where(near, 1.0, squared))
    behind = at_infinity[:, 2] + inverse_depth * towards[2] <= 1e-6
    status = np.where(near, Status.NEAR_EPIPOLE, np.where(behind, Status.BEHIND, Status.VALID))
    return np.where(behind, 0.0, inverse_depth), status.astype(np.int8)


def transfer_points(to_second: Floats, to_third: Floats, points: Floats, matches: Floats) -> Transferred:
    """Transfer correspondences of two views to a third.

    Parameters
    ----------
    to_second, to_third : ndarray of shape (3, 4), float64
        Transfers from the first view.
    points, matches : ndarray of shape (N, 2), float64
        Image points in pixels of the first and the second view.

    Returns
    -------
    Transferred
        Where they are in the third view.

    References
    ----------
    [Maitre2008] Sec. 5.3.2, Fig. 5.4.
    """
    inverse_depth, status = inverse_depths(to_second, points, matches)
    moved = transfer_depths(to_third, points, inverse_depth)
    status = np.where(status == Status.VALID, moved.status, status).astype(np.int8)
    valid = status == Status.VALID
    return Transferred(
        np.where(valid[:, None], moved.points, points), np.where(valid, inverse_depth, 0.0), status
    )
