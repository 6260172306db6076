"""Epipolar geometry: lines, epipoles, distances, and fundamental matrices of cameras."""

import numpy as np

from dvc.arrays import Floats
from dvc.geometry.cameras import PixelFrame, homogeneous
from sfm.decompositions import least_singular

TINY = 1e-300
"""Divisor for points on an epipole, which have no line."""


def skew(vector: Floats) -> Floats:
    """Return the matrix of the cross product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def unit_norm(fundamental: Floats) -> Floats:
    """Scale a matrix to Frobenius norm 1; a matrix of zeros stays."""
    norm = float(np.sqrt((fundamental * fundamental).sum()))
    return fundamental / norm if norm > 0 else fundamental


def epipolar_lines(fundamental: Floats, points: Floats) -> Floats:
    """Return the lines in the second image of points of the first; with ``F.T`` the other way round."""
    lines = homogeneous(points) @ fundamental.T
    norm = np.hypot(lines[:, 0], lines[:, 1])
    return lines / np.where(norm > 0, norm, np.inf)[:, None]


def epipoles(fundamental: Floats) -> tuple[Floats, Floats]:
    """Return both epipoles: the image of each camera centre in the other image."""
    return least_singular(fundamental), least_singular(fundamental.T)


def distances_to_epipole(epipole: Floats, points: Floats) -> Floats:
    """Return the distances of points from an epipole."""
    if abs(epipole[2]) <= 1e-12:
        return np.full(len(points), np.inf)
    offset = points - epipole[:2] / epipole[2]
    return np.asarray(np.hypot(offset[:, 0], offset[:, 1]))


def _bilinear(fundamental: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats, Floats]:
    """Return x1' F x0, and the squared norms of the normals of ``F x0`` and ``F' x1``."""
    lines_second = homogeneous(first) @ fundamental.T
    lines_first = homogeneous(second) @ fundamental
    product = (homogeneous(second) * lines_second).sum(axis=1)
    return product, (lines_second[:, :2] ** 2).sum(axis=1), (lines_first[:, :2] ** 2).sum(axis=1)


def sampson_distances(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Return first-order signed distances of pairs of points from the epipolar constraint."""
    product, in_second, in_first = _bilinear(fundamental, first, second)
    return product / np.sqrt(np.maximum(in_second + in_first, TINY))


def symmetric_distances(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Return the distances of pairs of points to each other's epipolar lines."""
    product, in_second, in_first = _bilinear(fundamental, first, second)
    squared = 0.5 * product * product
    return np.sqrt(squared / np.maximum(in_second, TINY) + squared / np.maximum(in_first, TINY))


def distances_in_second(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Return the distances of second points to the epipolar lines of first points."""
    product, in_second, _ = _bilinear(fundamental, first, second)
    return np.abs(product) / np.sqrt(np.maximum(in_second, TINY))


def fundamental_from_camera(camera: Floats) -> Floats:
    """Return the fundamental matrix of the cameras ``[I | 0]`` and ``[R | t]``."""
    return unit_norm(skew(camera[:, 3]) @ camera[:, :3])


def fundamental_to_normalized(fundamental: Floats, frame: PixelFrame) -> Floats:
    """Convert a fundamental matrix from pixels to normalised coordinates."""
    return unit_norm(frame.pixel_from_normalized.T @ fundamental @ frame.pixel_from_normalized)


def fundamental_to_pixels(fundamental: Floats, frame: PixelFrame) -> Floats:
    """Convert a fundamental matrix to pixels; inverse of `fundamental_to_normalized`."""
    return unit_norm(frame.normalized_from_pixel.T @ fundamental @ frame.normalized_from_pixel)
