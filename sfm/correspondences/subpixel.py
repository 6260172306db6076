"""Sub-pixel positions of second points: least squares between neighbourhoods by Levenberg-Marquardt."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

SPLINE_POLE = math.sqrt(3.0) - 2.0
POLE_HORIZON = 40  # powers of the pole that can change a double


@dataclass(frozen=True)
class RefinementSettings:
    """How second points are refined."""

    radius_px: int = 5  # half size of the neighbourhood
    max_iterations: int = 12  # steps of Levenberg-Marquardt, rejected ones included
    min_step_px: float = 2e-3  # the search ends with a step shorter than this
    max_shift_px: float = 2.0  # points that move farther from where they started are lost
    affine: bool = False  # whether neighbourhoods may also turn, scale and shear

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.radius_px < 1 or self.max_iterations < 1:
            raise ValueError(f"`radius_px` and `max_iterations` must be at least 1, got {self}")
        if self.min_step_px <= 0 or self.max_shift_px <= 0:
            raise ValueError(f"`min_step_px` and `max_shift_px` must be positive, got {self}")


def refine(
    luma0: Image,
    luma1: Image,
    first: Floats,
    second: Floats,
    settings: RefinementSettings | None = None,
    shapes: Floats | None = None,
) -> tuple[Floats, Floats, Mask]:
    """Move second points to where their neighbourhoods are most like those of the first points."""
    from sfm.correspondences import _kernels

    settings = settings or RefinementSettings()
    check_pair(luma0, luma1)
    if not np.array_equal(first, np.rint(first)):
        raise ValueError("`first` must be in whole pixels")
    refined, error = second.copy(), np.full(len(first), np.inf)
    room = np.flatnonzero(inside(first, luma0, settings.radius_px))
    parameters = second[room]
    if settings.affine:
        start = np.tile(np.eye(2), (len(first), 1, 1)) if shapes is None else shapes
        parameters = np.column_stack([parameters, start[room].reshape(-1, 4)])
    found = np.empty(len(room))
    _kernels.refine_points(
        luma0.astype(np.float64),
        spline(luma1),
        first[room].astype(np.int64),
        parameters,
        window(settings.radius_px),
        _kernels.Descent(settings.max_iterations, settings.min_step_px, settings.max_shift_px),
        found,
    )
    good = found >= 0.0
    refined[room[good]], error[room[good]] = parameters[good, :2], found[good]
    return refined, error, np.isfinite(error)


def check_pair(luma0: Image, luma1: Image) -> None:
    """Refuse two frames that are not planes of one size."""
    if luma0.ndim != 2 or luma0.shape != luma1.shape:
        raise ValueError(f"`luma0` and `luma1` must have one shape (H, W), got {luma0.shape}, {luma1.shape}")


def inside(points: Floats, luma: Image, distance_px: float) -> Mask:
    """Tell which points keep a distance from the frame's edge."""
    last = np.array([luma.shape[1] - 1, luma.shape[0] - 1])
    return np.asarray(((points >= distance_px) & (points <= last - distance_px)).all(axis=1))


def window(radius_px: int) -> Floats:
    """Make the weights of a neighbourhood: Epanechnikov's kernel, reaching zero beyond its corners."""
    offset = np.arange(-radius_px, radius_px + 1, dtype=np.float64)
    weights: Floats = 2.0 * (radius_px + 1) ** 2 - (offset[:, None] ** 2 + offset**2)
    weights /= weights.sum()
    return weights


def spline(image: Image | Floats) -> Floats:
    """Compute these coefficients with more around them, as kernels take them."""
    from sfm.correspondences._kernels import MARGIN

    return np.pad(spline_coefficients(image), MARGIN, "reflect")


def half_pixel_samples(spline: Floats) -> Floats:
    """Sample such a spline half a pixel apart: (2 H, 2 W)."""
    for _ in range(2):
        before, at, after, beyond = (spline[1 + k : len(spline) - 3 + k] for k in range(4))
        samples = np.empty((2 * len(at), at.shape[1]))
        samples[::2] = (before + 4.0 * at + after) / 6.0
        samples[1::2] = (before + 23.0 * (at + after) + beyond) / 48.0
        spline = np.ascontiguousarray(samples.T)
    return spline


def spline_coefficients(image: Image | Floats) -> Floats:
    """Compute the coefficients of the cubic B-spline that interpolates an image, mirrored at its edges."""
    along_columns = _filter_rows(np.asarray(image, dtype=np.float64))
    return np.ascontiguousarray(_filter_rows(np.ascontiguousarray(along_columns.T)).T)


def _filter_rows(samples: Floats) -> Floats:
    """Apply the recursive filter down the first axis, causal and then anticausal."""
    length, z = len(samples), SPLINE_POLE
    if length < 2:
        return samples.copy()
    filtered = samples * 6.0
    start, power = filtered[0].copy(), 1.0
    for k in range(1, POLE_HORIZON):
        power *= z
        turned = k % (2 * length - 2)
        start += power * filtered[min(turned, 2 * length - 2 - turned)]
    filtered[0] = start
    for k in range(1, length):
        filtered[k] += z * filtered[k - 1]
    filtered[-1] = z / (z * z - 1.0) * (filtered[-1] + z * filtered[-2])
    for k in range(length - 2, -1, -1):
        filtered[k] = z * (filtered[k + 1] - filtered[k])
    return filtered
