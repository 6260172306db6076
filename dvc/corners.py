"""Corners: the detector of Harris and Stephens, for encoder and decoder.

The response to corners is ``det(A) - k trace(A)^2`` of the structure tensor A: products of the gradients by
Sobel's operator, summed over a window.

References
----------
Harris and Stephens, "A combined corner and edge detector", 1988.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers, Mask, Singles

SENSITIVITY = 0.04
"""Usual value of k."""

SENT_WINDOW_PX = 5
"""Side of the detection window for transmitted corners, which the decoder detects again."""

SOBEL_GAIN = 8.0
"""Response of the 3x3 operator to a slope of one luma level per pixel."""


def corner_response(luma: Bytes, window: ArrayLike, sensitivity: float = SENSITIVITY) -> Floats:
    """Compute the response under a separable window of whole numbers."""
    import cv2

    taps = np.asarray(window, np.float64)
    dx, dy = cv2.Sobel(luma, cv2.CV_64F, 1, 0), cv2.Sobel(luma, cv2.CV_64F, 0, 1)
    xx, xy, yy = (
        np.asarray(cv2.sepFilter2D(product, cv2.CV_64F, taps, taps), np.float64)
        for product in (dx * dx, dx * dy, dy * dy)
    )
    trace = xx + yy
    response: Floats = xx * yy - xy * xy - sensitivity * trace * trace
    return response


def quick_corner_response(luma: Bytes, window_px: int) -> Singles:
    """Compute the response under a square window in single precision, in half the time."""
    import cv2

    return np.asarray(cv2.cornerHarris(luma, window_px, 3, SENSITIVITY))


def is_local_max(response: NDArray[np.floating], radius_px: int) -> Mask:
    """Return a mask of the values that are largest within a distance, by rows and by columns."""
    import cv2

    side = 2 * radius_px + 1
    return np.asarray(cv2.dilate(response, np.ones((side, side), np.uint8)) == response)


def spaced(points: Integers | Floats, max_points: int, min_distance_px: float) -> Integers:
    """Return indices of points in order, except those that are too close to an earlier one."""
    taken = np.empty(max_points, np.int64)
    return taken[: _take_spaced(points.astype(np.float64), min_distance_px**2, taken)]


@kernel
def _take_spaced(points: Floats, min_distance_px2: float, taken: Integers) -> int:
    """Fill `taken`; return the number of its entries."""
    count = 0
    x, y = np.empty(taken.size), np.empty(taken.size)
    for i in range(points.shape[0]):
        if count == taken.size:
            break
        num_near = 0
        for j in range(count):  # vectorised, which is quicker than an early exit
            dx, dy = x[j] - points[i, 0], y[j] - points[i, 1]
            num_near += dx * dx + dy * dy < min_distance_px2
        if num_near == 0:
            taken[count], x[count], y[count] = i, points[i, 0], points[i, 1]
            count += 1
    return count
