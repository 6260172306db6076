"""Warping: positions in one view of points and pixels of another with known depth.

Convention: between two views (pixels, first pixel centre at 0) cameras become a *warp*, the 3x4 matrix
``[H | e]`` of the infinite homography H and the epipole e. The homogeneous point x of the source view with
inverse depth rho lies at ``H x + rho e`` in the target view; its inverse depth there is rho over the third
coordinate. Planes are affine in inverse depth for every camera.
[Maitre2008] Fig. 5.4: trifocal transfer is triangulation in two views and a warp to the third.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Mask
from dvc.geometry.cameras import PixelFrame, homogeneous, oriented

EMPTY = -1e30
"""Inverse depth of pixels without a surface."""
PADDING = 3
"""Samples that pad each side of an interpolated image."""

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
    return np.ascontiguousarray(to_pixels @ oriented(target) @ np.linalg.inv(basis))


def inverse_warp(warp: Floats) -> Floats:
    """Return the warp from the target back to the source."""
    inverse = np.linalg.inv(warp[:, :3])
    return np.column_stack([inverse, -inverse @ warp[:, 3]])


@kernel
def warp_grid(warp: Floats, inverse_depth: Floats, origin_px: float = 0.0, step_px: float = 1.0) -> Floats:
    """Warp the points of a regular grid, by default all pixels: (x, y, inverse depth); far away if behind."""
    height, width = inverse_depth.shape
    warped = np.empty((height, width, 3))
    for i in range(height):
        for j in range(width):
            rho = inverse_depth[i, j]
            x, y, w = warp_point(warp, origin_px + j * step_px, origin_px + i * step_px, rho)
            warped[i, j, 0], warped[i, j, 1] = x, y
            warped[i, j, 2] = rho / w if w >= 1e-6 else EMPTY
    return warped


@kernel
def warp_point(warp, x, y, rho):
    """Return the position in the other view and the third homogeneous coordinate (positive if visible)."""
    u = warp[0, 0] * x + warp[0, 1] * y + warp[0, 2] + rho * warp[0, 3]
    v = warp[1, 0] * x + warp[1, 1] * y + warp[1, 2] + rho * warp[1, 3]
    w = warp[2, 0] * x + warp[2, 1] * y + warp[2, 2] + rho * warp[2, 3]
    if w < 1e-6:
        return -1e9, -1e9, w
    return u / w, v / w, w


def warp_points(warp: Floats, points: Floats, inverse_depth: Floats) -> tuple[Floats, Mask]:
    """Warp points of known inverse depth."""
    image = np.column_stack([homogeneous(points), np.nan_to_num(inverse_depth)]) @ warp.T
    before = (image[:, 2] > 1e-6) & np.isfinite(inverse_depth)
    warped = np.where(before[:, None], image[:, :2] / np.where(before, image[:, 2], 1.0)[:, None], points)
    return warped, before


def sample(plane: Bytes, positions: Floats) -> Floats:
    """Interpolate a plane by cubic convolution of fourth order (six points), in single precision."""
    samples = np.empty(positions.shape[:2])
    padded = np.pad(plane, PADDING, mode="edge").astype(np.float32)
    _sample(padded, np.ascontiguousarray(positions), samples)
    return samples


@kernel
def _sample(padded, positions, samples):
    """Interpolate a padded image at positions (x, y); repeat its border."""
    height, width = padded.shape[0] - 2 * PADDING, padded.shape[1] - 2 * PADDING
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            x = min(max(positions[i, j, 0], 0.0), width - 1.0)
            y = min(max(positions[i, j, 1], 0.0), height - 1.0)
            left, top = int(x), int(y)
            down, across = _cubic_weights(y - top), _cubic_weights(x - left)
            a = b = c = d = e = f = np.float32(0.0)
            for k in range(6):
                line, weight = padded[top + k + PADDING - 2], down[k]
                column = left + PADDING - 2
                a += weight * line[column]
                b += weight * line[column + 1]
                c += weight * line[column + 2]
                d += weight * line[column + 3]
                e += weight * line[column + 4]
                f += weight * line[column + 5]
            total = (across[0] * a + across[1] * b) + (across[2] * c + across[3] * d)
            total += across[4] * e + across[5] * f
            samples[i, j] = min(max(total, np.float32(0.0)), np.float32(255.0))


@kernel
def _cubic_weights(s):
    """Return the weights of six-point cubic convolution of fourth order at fraction s (Keys 1981)."""
    near, middle, far = _cubics(s)
    near_after, middle_after, far_after = _cubics(1.0 - s)
    return far, middle, near, near_after, middle_after, far_after


@kernel
def _cubics(d):
    """Return the weights of the samples at a distance, and one and two samples beyond it."""
    e, f = 1.0 + d, 2.0 + d
    near = np.float32((4.0 / 3.0 * d - 7.0 / 3.0) * d * d + 1.0)
    middle = np.float32(((-7.0 / 12.0 * e + 3.0) * e - 59.0 / 12.0) * e + 2.5)
    return near, middle, np.float32(((1.0 / 12.0 * f - 2.0 / 3.0) * f + 1.75) * f - 1.5)
