"""Corners of a key frame, spread over the whole frame by adapting the detector's sensitivity locally."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dvc.corners import SENSITIVITY, SOBEL_GAIN, corner_response, is_local_max
from sfm.correspondences import outliers
from sfm.correspondences.subpixel import RefinementSettings, check_pair, inside, refine
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Indices = NDArray[np.int64]


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


@dataclass(frozen=True)
class MatchingSettings:
    """When two corners are similar."""

    max_motion_share: float = 0.25  # largest motion, as a share of the frame's larger side
    radius_px: int = 6  # half size of the neighbourhoods compared at whole pixels; 90 at most
    max_brightness_change: float = 40.0  # largest difference of the mean luma of two neighbourhoods, levels
    bin_width: float = 12.0  # distance of the samples of intensity distributions, luma levels
    num_bins: int = 16  # number of samples; what lies outside counts for the outermost
    # largest chi-square of two distributions, as a share of that of distributions without overlap
    max_chi_square_share: float = 0.2
    # most similar corners of the second frame that are refined, per corner of the first
    num_candidates: int = 3
    min_error: float = 4.0  # mean squared error that noise and sampling alone can cause, squared luma levels
    # largest mean squared error at whole pixels beyond, as a share of the neighbourhood's variance
    error_share: float = 0.6
    shifted_error_share: float = 0.4  # the same after refinement of the position
    refined_error_share: float = 0.12  # the same after refinement of position and shape
    # largest quotient of the errors of the most similar corner and the next one, both beyond `min_error`
    max_ambiguity: float = 0.7
    refinement: RefinementSettings = field(default_factory=RefinementSettings)  # sub-pixel refinement

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 1 <= self.radius_px <= 90 or self.num_candidates < 1 or self.num_bins < 2:
            raise ValueError(f"`radius_px`, `num_candidates` or `num_bins` is out of range: {self}")
        if self.max_motion_share <= 0 or self.bin_width <= 0:
            raise ValueError(f"`max_motion_share` and `bin_width` must be positive, got {self}")


def match_corners(
    luma0: Image,
    luma1: Image,
    corners0: Floats,
    corners1: Floats,
    settings: MatchingSettings | None = None,
) -> Correspondences:
    """Match the corners of two key frames."""
    settings = settings or MatchingSettings()
    check_pair(luma0, luma1)
    corners0 = corners0[inside(corners0, luma0, settings.radius_px)]
    corners1 = corners1[inside(corners1, luma1, settings.radius_px)]
    if len(corners0) == 0 or len(corners1) == 0:
        return Correspondences.empty()
    i, j, variance = _candidates(luma0, luma1, corners0, corners1, settings)
    second = corners1[j]
    for affine, share in ((False, settings.shifted_error_share), (True, settings.refined_error_share)):
        largest = settings.min_error + share * variance
        how = replace(settings.refinement, affine=affine)
        second, error, success = refine(luma0, luma1, corners0[i], second, how)
        success &= outliers.mse(error, largest)
        i, j, variance = i[success], j[success], variance[success]
        second, error, largest = second[success], error[success], largest[success]
    chosen = outliers.unicity(i, j, error, largest)
    chosen &= _unambiguous(i, error, settings)
    return Correspondences(corners0[i[chosen]], second[chosen], error[chosen])


def _candidates(
    luma0: Image, luma1: Image, corners0: Floats, corners1: Floats, settings: MatchingSettings
) -> tuple[Indices, Indices, Floats]:
    """Return pairs of indices, and the variance of each first neighbourhood."""
    from sfm.correspondences import _kernels

    first = _kernels.Corners(corners0, *describe(luma0, corners0, settings))
    second = _kernels.Corners(corners1, *describe(luma1, corners1, settings))
    num_samples = first.patches.shape[1]
    variance = first.patches.var(axis=1)
    chosen = np.full((len(corners0), settings.num_candidates), -1, dtype=np.int64)
    errors = np.empty(chosen.shape)
    _kernels.best_candidates(
        first,
        second,
        _kernels.Similarity(
            settings.max_motion_share * max(luma0.shape),
            settings.max_brightness_change,
            settings.max_chi_square_share * num_samples,
        ),
        num_samples * (settings.min_error + settings.error_share * variance),
        chosen,
        errors,
    )
    i, k = np.nonzero(chosen >= 0)
    return i, chosen[i, k], variance[i]


def _unambiguous(i: Indices, error: Floats, settings: MatchingSettings) -> NDArray[np.bool_]:
    """Tell which pairs are clearly more similar than any other pair of the same first corner."""
    order = np.lexsort((error, i))
    i, error = i[order], error[order] + settings.min_error
    best = np.diff(i, prepend=-1) != 0
    second = np.append(np.where(i[1:] == i[:-1], error[1:], np.inf), np.inf)
    clear = np.empty(len(i), dtype=bool)
    clear[order] = best & (error <= settings.max_ambiguity * second)
    return clear


def describe(
    luma: Image, corners: Floats, settings: MatchingSettings
) -> tuple[NDArray[np.uint8], Floats, Floats]:
    """Cut out the neighbourhoods of corners; return their means and distributions of intensity, too."""
    from sfm.correspondences import _kernels

    offset = np.arange(-settings.radius_px, settings.radius_px + 1)
    x, y = corners.astype(np.int64).T
    patches = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].reshape(len(corners), -1)
    means = patches.mean(axis=1)
    histograms = np.empty((len(corners), settings.num_bins))
    _kernels.parzen_histograms(patches - means[:, None], settings.bin_width, histograms)
    return patches, means, histograms
