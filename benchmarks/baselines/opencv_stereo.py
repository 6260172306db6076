"""Baseline of stereo: semi-global matching of OpenCV with filled holes."""

from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SemiGlobalSettings:
    """Settings of `cv2.StereoSGBM`, by its names."""

    block_size: int = 3  # side of the window in pixels
    # penalties of steps of one disparity and of more: 8 and 32 times 3 channels times the window
    p1: int = 8 * 3 * 3**2
    p2: int = 32 * 3 * 3**2
    uniqueness_ratio: int = 10  # margin of the best disparity, in per cent
    disp12_max_diff: int = 1  # largest difference between both views
    speckle_window_size: int = 100  # smallest region that stays
    speckle_range: int = 2

    def __str__(self) -> str:
        values = ", ".join(f"{name} {value}" for name, value in asdict(self).items())
        return f"StereoSGBM of OpenCV {cv2.__version__}: {values}, mode SGBM"


BASELINE = SemiGlobalSettings()


def semi_global_baseline(
    left: NDArray[np.uint8], right: NDArray[np.uint8], highest: float, settings: SemiGlobalSettings = BASELINE
) -> NDArray[np.float64]:
    """Match a rectified pair by OpenCV, and fill its holes."""
    num_disparities = 16 * (int(highest) // 16 + 1)
    names: dict[str, Any] = {
        "blockSize": settings.block_size,
        "P1": settings.p1,
        "P2": settings.p2,
        "disp12MaxDiff": settings.disp12_max_diff,
        "uniquenessRatio": settings.uniqueness_ratio,
        "speckleWindowSize": settings.speckle_window_size,
        "speckleRange": settings.speckle_range,
    }
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=num_disparities, mode=cv2.StereoSGBM_MODE_SGBM, **names
    )
    wider = [
        cv2.copyMakeBorder(view, 0, 0, num_disparities, 0, cv2.BORDER_REPLICATE) for view in (left, right)
    ]
    disparity = matcher.compute(*wider)[:, num_disparities:].astype(np.float64) / 16.0
    return fill_holes(np.where(disparity < 0.0, np.nan, disparity))


def fill_holes(disparity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fill undefined pixels with the smaller of the nearest disparities to their left and right."""
    height, width = disparity.shape
    defined = np.isfinite(disparity)
    columns, rows = np.arange(width), np.arange(height)[:, None]
    before = np.maximum.accumulate(np.where(defined, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(defined, columns, width)[:, ::-1], axis=1)[:, ::-1]
    sides = [
        np.where(there, disparity[rows, np.clip(nearest, 0, width - 1)], np.inf)
        for nearest, there in ((before, before >= 0), (after, after < width))
    ]
    filled = np.where(defined, disparity, np.minimum(*sides))
    return np.where(np.isfinite(filled), filled, 0.0)
