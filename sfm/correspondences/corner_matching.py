"""Corners of two key frames: detected all over each frame, and matched one to one below the pixel."""

from typing import NamedTuple

import numpy as np

from dvc._jit import inlined_kernel, kernel
from dvc.arrays import Bytes, Floats, Integers, Mask
from dvc.corners import SENSITIVITY, SOBEL_GAIN, corner_response, is_local_max
from sfm.correspondences import outliers
from sfm.correspondences.subpixel import check_pair, inside, refine
from sfm.scene_model import Correspondences

NUM_CORNERS = 2400
"""Largest number of corners."""
BORDER_PX = 8
"""Least distance of a corner from the frame's edge, so that neighbourhoods fit."""
BINOMIAL = (1, 2, 1)
"""Weights of the window over which the structure tensor is averaged."""
SEPARATION_PX = 1
"""Distance within which a corner is the strongest, by rows and by columns."""
MIN_GRADIENT = 1.0
"""Gradient with a response of noise, luma levels per pixel."""
ROBUSTNESS = 0.9
"""Share of a neighbour's response that suppresses a corner if it is larger."""
MAX_MOTION_SHARE = 0.25
"""Largest motion, as a share of the frame's longer side."""
RADIUS_PX = 6
"""Half size of the neighbourhoods compared at whole pixels."""
MAX_BRIGHTNESS_CHANGE = 40.0
"""Largest difference of the mean luma of two neighbourhoods, levels."""
BIN_WIDTH = 12.0
"""Distance of the samples of intensity distributions, luma levels."""
NUM_BINS = 16
"""Number of samples; intensities beyond the ends count for the outermost."""
MAX_CHI_SQUARE_SHARE = 0.2
"""Largest chi-square of two distributions, as a share of that of distributions without overlap."""
NUM_CANDIDATES = 3
"""Number of most similar corners of the second frame that are refined, per corner of the first."""
MIN_ERROR = 4.0
"""Mean squared error due to noise and sampling, squared luma levels."""
ERROR_SHARE, SHIFTED_ERROR_SHARE, REFINED_ERROR_SHARE = 0.6, 0.4, 0.12
"""Largest additional errors at whole pixels, after refinement of the position, and of position and shape.

They are shares of the neighbourhood's variance.
"""
MAX_AMBIGUITY = 0.7
"""Largest quotient of the errors of the most similar corner and the next one, plus `MIN_ERROR` each."""


def detect_corners(luma: Bytes, num_corners: int = NUM_CORNERS) -> Floats:
    """Detect Harris-Stephens corners (N, 2) by adaptive non-maximal suppression."""
    if luma.ndim != 2 or luma.dtype != np.uint8:
        raise ValueError(f"`luma` must have shape (H, W) and dtype uint8, got {luma.shape}, {luma.dtype}")
    response = corner_response(luma, list(BINOMIAL), SENSITIVITY) / (SOBEL_GAIN * sum(BINOMIAL)) ** 4
    corner = is_local_max(response, SEPARATION_PX) & (response >= MIN_GRADIENT**4)
    interior = np.zeros_like(corner)
    height, width = corner.shape
    interior[
        BORDER_PX : max(height - BORDER_PX, BORDER_PX), BORDER_PX : max(width - BORDER_PX, BORDER_PX)
    ] = True
    y, x = np.nonzero(corner & interior)
    strength = response[y, x]
    order = np.argsort(-strength, kind="stable")
    x, y, strength = x[order], y[order], strength[order]
    radii_px2 = np.empty(len(x), dtype=np.int64)
    suppression_radii(x, y, strength, ROBUSTNESS, radii_px2)
    chosen = np.argsort(-radii_px2, kind="stable")[:num_corners]
    return np.column_stack([x[chosen], y[chosen]]).astype(np.float64)


@kernel
def suppression_radii(
    x: Integers, y: Integers, strength: Floats, robustness: float, radii_px2: Integers
) -> None:
    """Measure squared distances to the nearest clearly stronger maximum; `strength` is in falling order."""
    for i in range(x.size):
        radii_px2[i] = np.int64(1) << 40
        for j in range(i):
            if strength[j] * robustness <= strength[i]:
                break
            radii_px2[i] = min(radii_px2[i], (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)


class DescribedCorners(NamedTuple):
    """Corners of a key frame with their descriptions."""

    positions: Floats  # (N, 2)
    patches: Bytes  # (N, S), samples of the neighbourhoods
    means: Floats
    histograms: Floats


def match_corners(luma0: Bytes, luma1: Bytes, corners0: Floats, corners1: Floats) -> Correspondences:
    """Match the corners of two key frames."""
    check_pair(luma0, luma1)
    corners0 = corners0[inside(corners0, luma0, RADIUS_PX)]
    corners1 = corners1[inside(corners1, luma1, RADIUS_PX)]
    if len(corners0) == 0 or len(corners1) == 0:
        return Correspondences.empty()
    described = describe(luma0, corners0), describe(luma1, corners1)
    i, j, variance = _candidates(*described, MAX_MOTION_SHARE * max(luma0.shape))
    second = corners1[j]
    for affine, share in ((False, SHIFTED_ERROR_SHARE), (True, REFINED_ERROR_SHARE)):
        largest = MIN_ERROR + share * variance
        second, error, success = refine(luma0, luma1, corners0[i], second, affine=affine)
        success &= outliers.mse(error, largest)
        i, j, variance = i[success], j[success], variance[success]
        second, error, largest = second[success], error[success], largest[success]
    chosen = outliers.unicity(i, j, error, largest)
    chosen &= _unambiguous(i, error)
    return Correspondences(corners0[i[chosen]], second[chosen], error[chosen])


def describe(luma: Bytes, corners: Floats) -> DescribedCorners:
    """Cut out the neighbourhoods of corners, and compute their means and distributions of intensity.

    Densities of the deviations from the mean are sampled at the centres of bins, by triangular windows of
    twice their width.
    """
    offset = np.arange(-RADIUS_PX, RADIUS_PX + 1)
    x, y = corners.astype(np.int64).T
    patches = luma[y[:, None, None] + offset[:, None], x[:, None, None] + offset].reshape(len(corners), -1)
    means, last = patches.mean(axis=1), NUM_BINS - 1
    position = np.clip((patches - means[:, None]) / BIN_WIDTH + 0.5 * last, 0.0, last)
    left = np.minimum(position.astype(np.int64), last - 1)
    bins = NUM_BINS * np.arange(len(corners))[:, None] + left
    shares = np.stack([left + 1 - position, position - left], axis=-1)
    size = len(corners) * NUM_BINS
    histograms = np.bincount(np.stack([bins, bins + 1], axis=-1).ravel(), shares.ravel(), size)
    return DescribedCorners(corners, patches, means, np.asarray(histograms.reshape(len(corners), -1), float))


def _candidates(
    first: DescribedCorners, second: DescribedCorners, max_motion_px: float
) -> tuple[Integers, Integers, Floats]:
    """Return pairs of indices of similar corners, and the variance of each first neighbourhood."""
    num_samples = first.patches.shape[1]
    variance = first.patches.var(axis=1)
    chosen = np.full((len(variance), NUM_CANDIDATES), -1, dtype=np.int64)
    best_candidates(
        first,
        second,
        max_motion_px,
        MAX_BRIGHTNESS_CHANGE,
        MAX_CHI_SQUARE_SHARE * num_samples,
        num_samples * (MIN_ERROR + ERROR_SHARE * variance),
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
    chosen: Integers,
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
def sum_of_squares(a: Bytes, b: Bytes) -> float:
    """Sum squared differences of samples; in 32 bits, so that the compiler vectorises the loop."""
    total = np.int32(0)
    for k in range(a.size):
        difference = np.int32(np.int32(a[k]) - np.int32(b[k]))
        total = np.int32(total + np.int32(difference * difference))
    return np.float64(total)


def _unambiguous(i: Integers, error: Floats) -> Mask:
    """Return a mask of pairs that are clearly more similar than any other pair of the same first corner."""
    order = np.lexsort((error, i))
    i, error = i[order], error[order] + MIN_ERROR
    best = np.diff(i, prepend=-1) != 0
    second = np.append(np.where(i[1:] == i[:-1], error[1:], np.inf), np.inf)
    clear = np.empty(len(i), dtype=bool)
    clear[order] = best & (error <= MAX_AMBIGUITY * second)
    return clear
