"""Corners of two key frames: detected all over each frame, and matched one to one below the pixel."""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.corners import SENSITIVITY, SOBEL_GAIN, corner_response, is_local_max
from sfm.correspondences import outliers
from sfm.correspondences.subpixel import RefinementSettings, check_pair, inside, refine
from sfm.scene_model import Correspondences

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class FeatureSettings:
    """Definition of a corner."""

    num_corners: int = 2400  # largest number of corners
    sensitivity: float = SENSITIVITY  # Harris's k in ``det - k trace^2``
    # half size of the binomial window over which the structure tensor is averaged
    integration_radius_px: int = 1
    separation_px: int = 1  # a corner is the strongest within this distance, by rows and by columns
    border_px: int = 8  # least distance from the frame's edge, so that neighbourhoods fit
    min_gradient: float = 1.0  # responses below ``min_gradient ** 4`` are noise, luma levels per pixel
    robustness: float = 0.9  # share of a neighbour's response that suppresses a corner if it is larger

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.num_corners, self.integration_radius_px, self.separation_px, self.border_px) < 1:
            raise ValueError(f"`num_corners`, radii and distances must be at least 1, got {self}")
        if not (0 < self.sensitivity < 0.25 and 0 < self.robustness <= 1 and self.min_gradient > 0):
            raise ValueError(f"`sensitivity`, `robustness` or `min_gradient` is out of range: {self}")


def detect_corners(luma: Image, settings: FeatureSettings | None = None) -> Floats:
    """Detect Harris-Stephens corners (N, 2) by adaptive non-maximal suppression."""
    if luma.ndim != 2 or luma.dtype != np.uint8:
        raise ValueError(f"`luma` must have shape (H, W) and dtype uint8, got {luma.shape}, {luma.dtype}")
    settings = settings or FeatureSettings()
    radius = settings.integration_radius_px
    window = [math.comb(2 * radius, k) for k in range(2 * radius + 1)]  # the sum is a power of two
    response = corner_response(luma, window, settings.sensitivity) / (SOBEL_GAIN * sum(window)) ** 4
    corner = is_local_max(response, settings.separation_px) & (response >= settings.min_gradient**4)
    interior = np.zeros_like(corner)
    border, (height, width) = settings.border_px, corner.shape
    interior[border : max(height - border, border), border : max(width - border, border)] = True
    y, x = np.nonzero(corner & interior)
    strength = response[y, x]
    order = np.argsort(-strength, kind="stable")
    x, y, strength = x[order], y[order], strength[order]
    radii_px2 = np.empty(len(x), dtype=np.int64)
    suppression_radii(x, y, strength, settings.robustness, radii_px2)
    chosen = np.argsort(-radii_px2, kind="stable")[: settings.num_corners]
    return np.column_stack([x[chosen], y[chosen]]).astype(np.float64)


@kernel
def suppression_radii(
    x: Indices, y: Indices, strength: Floats, robustness: float, radii_px2: Indices
) -> None:
    """Measure squared distances to the nearest clearly stronger maximum; `strength` is in falling order."""
    for i in range(x.size):
        radii_px2[i] = np.int64(1) << 40
        for j in range(i):
            if strength[j] * robustness <= strength[i]:
                break
            radii_px2[i] = min(radii_px2[i], (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)


@dataclass(frozen=True)
class MatchingSettings:
    """Limits of the similarity of two corners."""

    max_motion_share: float = 0.25  # largest motion, as a share of the frame's longer side
    radius_px: int = 6  # half size of the neighbourhoods compared at whole pixels; 90 at most
    max_brightness_change: float = 40.0  # largest difference of the mean luma of two neighbourhoods, levels
    bin_width: float = 12.0  # distance of the samples of intensity distributions, luma levels
    num_bins: int = 16  # number of samples; intensities beyond the ends count for the outermost
    # largest chi-square of two distributions, as a share of that of distributions without overlap
    max_chi_square_share: float = 0.2
    # number of most similar corners of the second frame that are refined, per corner of the first
    num_candidates: int = 3
    min_error: float = 4.0  # mean squared error due to noise and sampling, squared luma levels
    # largest additional error at whole pixels, as a share of the neighbourhood's variance
    error_share: float = 0.6
    shifted_error_share: float = 0.4  # the same after refinement of the position
    refined_error_share: float = 0.12  # the same after refinement of position and shape
    # largest quotient of the errors of the most similar corner and the next one, plus `min_error` each
    max_ambiguity: float = 0.7
    refinement: RefinementSettings = field(default_factory=RefinementSettings)

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 1 <= self.radius_px <= 90 or self.num_candidates < 1 or self.num_bins < 2:
            raise ValueError(f"`radius_px`, `num_candidates` or `num_bins` is out of range: {self}")
        if self.max_motion_share <= 0 or self.bin_width <= 0:
            raise ValueError(f"`max_motion_share` and `bin_width` must be positive, got {self}")


class DescribedCorners(NamedTuple):
    """Corners of a key frame with their descriptions."""

    positions: Floats  # (N, 2)
    patches: Image  # (N, S), samples of the neighbourhoods
    means: Floats
    histograms: Floats


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
    described = describe(luma0, corners0, settings), describe(luma1, corners1, settings)
    i, j, variance = _candidates(*described, settings.max_motion_share * max(luma0.shape), settings)
    second = corners1[j]
    for affine, share in ((False, settings.shifted_error_share), (True, settings.refined_error_share)):
        largest = settings.min_error + share * variance
        refinement = replace(settings.refinement, affine=affine)
        second, error, success = refine(luma0, luma1, corners0[i], second, refinement)
        success &= outliers.mse(error, largest)
        i, j, variance = i[success], j[success], variance[success]
        second, error, largest = second[success], error[success], largest[success]
    chosen = outliers.unicity(i, j, error, largest)
    chosen &= _unambiguous(i, error, settings)
    return Correspondences(corners0[i[chosen]], second[chosen], error[chosen])


def describe(luma: Image, corners: Floats, settings: MatchingSettings) -> DescribedCorners:
    """Cut out the neighbourhoods of corners, and compute their means and distributions of intensity.

    Densities of the deviations from the mean are sampled at the centres of bins, by triangular windows of
    twice their width.
    """
    offset = np.arange(-settings.radius_px, settings.radius_px + 1)
    x, y = corners.astype(np.int64).T
    patches = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].reshape(len(corners), -1)
    means, last = patches.mean(axis=1), settings.num_bins - 1
    position = np.clip((patches - means[:, None]) / settings.bin_width + 0.5 * last, 0.0, last)
    left = np.minimum(position.astype(np.int64), last - 1)
    bins = settings.num_bins * np.arange(len(corners))[:, None] + left
    shares = np.stack([left + 1 - position, position - left], axis=-1)
    size = len(corners) * settings.num_bins
    histograms = np.bincount(np.stack([bins, bins + 1], axis=-1).ravel(), shares.ravel(), size)
    return DescribedCorners(corners, patches, means, np.asarray(histograms.reshape(len(corners), -1), float))


def _candidates(
    first: DescribedCorners, second: DescribedCorners, max_motion_px: float, settings: MatchingSettings
) -> tuple[Indices, Indices, Floats]:
    """Return pairs of indices of similar corners, and the variance of each first neighbourhood."""
    num_samples = first.patches.shape[1]
    variance = first.patches.var(axis=1)
    chosen = np.full((len(variance), settings.num_candidates), -1, dtype=np.int64)
    best_candidates(
        first,
        second,
        max_motion_px,
        settings.max_brightness_change,
        settings.max_chi_square_share * num_samples,
        num_samples * (settings.min_error + settings.error_share * variance),
        chosen,
        np.empty(chosen.shape),
    )
    i, k = np.nonzero(chosen >= 0)
    return i, chosen[i, k], variance[i]


@kernel
def best_candidates(
    first: DescribedCorners,
    second: DescribedCorners,
    max_motion_px: float,
    max_brightness_change: float,
    max_chi_square: float,
    limits: Floats,
    chosen: Indices,
    errors: Floats,
) -> None:
    """Choose the most similar corners within the motion bound, by rising error; -1 fills the rows.

    Errors are squared differences of the deviations from the means.
    """
    corners_a, patches_a, means_a, histograms_a = first
    corners_b, patches_b, means_b, histograms_b = second
    count = chosen.shape[1]
    for i in range(corners_a.shape[0]):
        num_chosen = 0
        for j in range(corners_b.shape[0]):
            dx, dy = corners_b[j, 0] - corners_a[i, 0], corners_b[j, 1] - corners_a[i, 1]
            if dx * dx + dy * dy > max_motion_px * max_motion_px:
                continue
            brighter = means_a[i] - means_b[j]
            if abs(brighter) > max_brightness_change:
                continue
            limit = min(limits[i], errors[i, count - 1]) if num_chosen == count else limits[i]
            error = sum_of_squares(patches_a[i], patches_b[j]) - patches_a.shape[1] * brighter * brighter
            if error > limit or chi_square(histograms_a[i], histograms_b[j]) > max_chi_square:
                continue
            rank = min(num_chosen, count - 1)
            while rank > 0 and errors[i, rank - 1] > error:
                errors[i, rank] = errors[i, rank - 1]
                chosen[i, rank] = chosen[i, rank - 1]
                rank -= 1
            errors[i, rank] = error
            chosen[i, rank] = j
            num_chosen = min(num_chosen + 1, count)


@kernel
def chi_square(a: Floats, b: Floats) -> float:
    """Half the sum of (a - b)^2 / (a + b): from 0 (the same) to the number of samples (nothing shared)."""
    total = 0.0
    for k in range(a.size):
        both = a[k] + b[k]
        if both > 0.0:
            total += (a[k] - b[k]) ** 2 / both
    return 0.5 * total


@inlined_kernel
def sum_of_squares(a: Image, b: Image) -> float:
    """Sum squared differences of samples; in 32 bits, so that the compiler vectorises the loop."""
    total = np.int32(0)
    for k in range(a.size):
        difference = np.int32(np.int32(a[k]) - np.int32(b[k]))
        total = np.int32(total + np.int32(difference * difference))
    return np.float64(total)


def _unambiguous(i: Indices, error: Floats, settings: MatchingSettings) -> NDArray[np.bool_]:
    """Return a mask of pairs that are clearly more similar than any other pair of the same first corner."""
    order = np.lexsort((error, i))
    i, error = i[order], error[order] + settings.min_error
    best = np.diff(i, prepend=-1) != 0
    second = np.append(np.where(i[1:] == i[:-1], error[1:], np.inf), np.inf)
    clear = np.empty(len(i), dtype=bool)
    clear[order] = best & (error <= settings.max_ambiguity * second)
    return clear
