"""Confidence of surfaces: how likely a disparity is right, from the view and what other cameras see."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.stereo.surfaces.occupancy import Labels, Neighbours, fineness, neighbours, seen_elsewhere

Floats = NDArray[np.floating]

TEXTURE_PX, SUPPORT_PX = 15, 31
"""Sides of the windows in which texture is measured, and support by other cameras."""
JUMP_PX, JUMP_REACH_PX = 2.0, 15.0
"""Change of parallax from pixel to pixel that is a jump, and the distance from one at which it counts 1/e."""


class Evidence(NamedTuple):
    """What tells how sure a surface is: weights of measures, or measures of each pixel, (H, W), float32."""

    constant: Floats | float  # 1 everywhere
    texture: Floats | float  # log(1 + mean slope of the luma along the parallax, in levels)
    near_jump: Floats | float  # 1 at a jump of the surface, falling to 0 away from it
    agreement: Floats | float  # 1 where another camera has the same label
    support: Floats | float  # share of the pixels around where that is so


WEIGHTS = Evidence(0.1, 0.8, -3.2, 0.6, 3.2)
"""Of the log-odds: by `benchmarks.searches.confidence` on `settings.TUNING_PAIRS`, rounded."""


def confidence(measures: Evidence) -> NDArray[np.float32]:
    """Return the probability that each disparity is right within a pixel."""
    log_odds = sum(weight * measure for weight, measure in zip(WEIGHTS, measures, strict=True))
    found: NDArray[np.float32] = (1.0 / (1.0 + np.exp(-log_odds))).astype(np.float32)
    return found


def evidence(array: CameraArray, labels: DisparityLabels, maps: Sequence[Labels], index: int) -> Evidence:
    """Measure what the confidence of a camera's surface rests on, from the labels of all cameras."""
    fine, near, view = fineness(array, labels), neighbours(array, index), array[index]
    same = seen_elsewhere(array, labels, maps, index, int(0.5 * fine)).astype(np.float32)
    parallax_px = (maps[index] / fine).astype(np.float32)
    return Evidence(
        np.ones(view.shape, np.float32),
        _texture(view.image, near),
        np.exp(-_distance_from_jumps(parallax_px) / JUMP_REACH_PX),
        same,
        np.asarray(cv2.blur(same, (SUPPORT_PX, SUPPORT_PX)), np.float32),
    )


def _texture(image: NDArray[np.uint8], near: Neighbours) -> Floats:
    """Texture along the directions in which there are other cameras: the larger one of two."""
    luma = image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    ways = [way for way, others in (((1, 0), near.horizontal), ((0, 1), near.vertical)) if others]
    slopes = [np.abs(cv2.Sobel(luma, cv2.CV_32F, *way)) / 8.0 for way in ways]
    found: Floats = np.log1p(np.max([cv2.blur(slope, (TEXTURE_PX, TEXTURE_PX)) for slope in slopes], axis=0))
    return found


def _distance_from_jumps(parallax_px: NDArray[np.float32]) -> Floats:
    """Distance of each pixel from the nearest jump; far where there is none."""
    around = np.ones((3, 3), np.uint8)
    is_even = cv2.dilate(parallax_px, around) - cv2.erode(parallax_px, around) <= JUMP_PX
    if is_even.all():
        return np.full(parallax_px.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform(is_even.astype(np.uint8), cv2.DIST_L2, 5))
