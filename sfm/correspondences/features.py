"""Corners of a key frame, spread over the whole frame by adapting the detector's sensitivity locally."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.corners import SENSITIVITY, SOBEL_GAIN, corner_response, is_local_max

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class FeatureSettings:
    """What makes a corner."""

    num_corners: int = 2400  # most corners that are returned
    sensitivity: float = SENSITIVITY  # harris's k in ``det - k trace^2``
    # half size of the binomial window over which the structure tensor is averaged
    integration_radius_px: int = 1
    separation_px: int = 1  # a corner is the strongest within this distance, by rows and by columns
    border_px: int = 8  # corners keep this distance from the frame's edge, so that neighbourhoods fit
    min_gradient: float = 1.0  # below ``min_gradient ** 4`` a response is noise, luma levels per pixel
    robustness: float = 0.9  # a corner is suppressed only by others whose response times this is larger

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.num_corners, self.integration_radius_px, self.separation_px, self.border_px) < 1:
            raise ValueError(f"`num_corners`, radii and distances must be at least 1, got {self}")
        if not (0 < self.sensitivity < 0.25 and 0 < self.robustness <= 1 and self.min_gradient > 0):
            raise ValueError(f"`sensitivity`, `robustness` or `min_gradient` is out of range: {self}")


def detect_corners(luma: Image, settings: FeatureSettings | None = None) -> Floats:
    """Find Harris-Stephens corners by adaptive non-maximal suppression."""
    from sfm.correspondences import _kernels

    if luma.ndim != 2 or luma.dtype != np.uint8:
        raise ValueError(f"`luma` must have shape (H, W) and dtype uint8, got {luma.shape}, {luma.dtype}")
    settings = settings or FeatureSettings()
    radius = settings.integration_radius_px
    window = [math.comb(2 * radius, k) for k in range(2 * radius + 1)]  # whose sum is a power of two
    response = corner_response(luma, window, settings.sensitivity) / (SOBEL_GAIN * sum(window)) ** 4
    rows, columns = _local_maxima(response, settings)
    strength = response[rows, columns]
    order = np.argsort(-strength, kind="stable")
    x, y, strength = columns[order], rows[order], strength[order]
    radii_px2 = np.empty(len(x), dtype=np.int64)
    _kernels.suppression_radii(x, y, strength, settings.robustness, radii_px2)
    kept = np.argsort(-radii_px2, kind="stable")[: settings.num_corners]
    return np.column_stack([x[kept], y[kept]]).astype(np.float64)


def _local_maxima(response: Floats, settings: FeatureSettings) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    corner = is_local_max(response, settings.separation_px) & (response >= settings.min_gradient**4)
    inside = np.zeros_like(corner)
    border = settings.border_px
    inside[border : max(len(inside) - border, border), border : max(inside.shape[1] - border, border)] = True
    rows, columns = np.nonzero(corner & inside)
    return rows, columns
