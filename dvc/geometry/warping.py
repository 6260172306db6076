"""Warping: where points and pixels of one view with known depth lie in another.

Convention: between two views (pixels, first pixel centre at 0) cameras become a *warp*, the 3x4 matrix
``[H | e]`` of the infinite homography H and the epipole e. The homogeneous point x of the source view with
inverse depth rho lies at ``H x + rho e`` in the target view; its inverse depth there is rho over the third
coordinate. Planes are affine in inverse depth, whatever the camera.

References
----------
[Maitre2008] Sec. 5.3.2, Fig. 5.4: trifocal transfer is triangulation in two views and a warp to the third.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels
from dvc.geometry.cameras import PixelFrame, homogeneous, oriented

Floats = NDArray[np.float64]

SINGULAR = 1e-9
"""Determinant of a camera's left part, relative to its entries, below which its centre is at infinity."""


def warp_matrix(source: Floats, target: Floats, frame: PixelFrame) -> Floats:
    """Return the warp from one camera's view to another's."""
    for name, camera in (("source", source), ("target", target)):
        if camera.shape != (3, 4) or not np.isfinite(camera).all():
            raise ValueError(f"`{name}` must be a finite 3x4 matrix, got shape {camera.shape}")
    if abs(np.linalg.det(source[:, :3])) < SINGULAR * max(np.abs(source).max(), 1e-300) ** 3:
        raise ValueError("`source` has its centre at infinity")
    to_pixels = frame.pixel_from_normalized
    basis = np.vstack([to_pixels @ oriented(source), [0.0, 0.0, 0.0, 1.0]])
    matrix: Floats = np.ascontiguousarray(to_pixels @ oriented(target) @ np.linalg.inv(basis))
    return matrix


def inverse_warp(warp: Floats) -> Floats:
    """Return the warp of the way back."""
    inverse = np.linalg.inv(warp[:, :3])
    return np.column_stack([inverse, -inverse @ warp[:, 3]])


def warp_grid(warp: Floats, inverse_depth: Floats, origin_px: float = 0.0, step_px: float = 1.0) -> Floats:
    """Warp every point of a regular grid, by default every pixel."""
    warped = np.empty((*inverse_depth.shape, 3))
    _kernels.warp_grid(warp, inverse_depth, origin_px, step_px, warped)
    return warped


def warp_points(warp: Floats, points: Floats, inverse_depth: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Warp points of known inverse depth."""
    image = np.column_stack([homogeneous(points), np.nan_to_num(inverse_depth)]) @ warp.T
    before = (image[:, 2] > 1e-6) & np.isfinite(inverse_depth)
    warped = np.where(before[:, None], image[:, :2] / np.where(before, image[:, 2], 1.0)[:, None], points)
    return warped, before
