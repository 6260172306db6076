"""Figures 3.9 to 3.12: levels, disparities by method and rate, rendered views and their errors."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.dibr.codec.decoder import decode
from dvc.dibr.codec.encoder import Encoded
from dvc.dibr.codec.views import Picture as View
from dvc.dibr.codec.views import Views
from dvc.dibr.stream.layers import decode_stream
from dvc.dibr.thesis.curves import Curves, Point
from dvc.dibr.thesis.tables import TITLES
from dvc.multiview.camera_array import DisparityLabels
from dvc.page.drawing import Picture, colour_disparity, in_rows, with_title

ERROR_GAIN = 3
"""Differences are drawn so many times as large."""
LEVELS = 0, 2, 4, 6
"""Resolutions of figure 3.9."""


def coloured(disparity: NDArray[np.floating], labels: DisparityLabels) -> Picture:
    """Colour disparities by the range of their labels."""
    return colour_disparity(disparity, labels.lowest, labels.highest)


def difference(found: View, truth: View) -> View:
    """Draw the difference between two gray pictures around a mid gray."""
    levels = 128.0 + ERROR_GAIN * (found.astype(np.float64) - truth)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def resolution_levels(encoded: Encoded, labels: DisparityLabels) -> Picture:
    """Draw figure 3.9: picture and disparities at several resolutions, enlarged to one size."""
    stream = decode_stream(encoded.data)
    height, width = stream.header.shape
    tops, bottoms = [], []
    for level in LEVELS:
        if min(height, width) < 4 << level:
            break
        pair = decode(stream, resolution=level).pairs[0]
        rows, columns = pair.picture.shape[:2]
        label = f"level {level}: {columns}x{rows}"
        tops.append(with_title(_enlarged(pair.picture, (height, width)), label))
        full = coloured(pair.disparity * 2.0**level, labels)
        bottoms.append(with_title(_enlarged(full, (height, width)), f"disparity, level {level}"))
    return in_rows([*tops, *bottoms], len(tops))


def disparity_maps(curves: Curves, indices: Sequence[int], labels: DisparityLabels) -> Picture:
    """Draw figures 3.10 and 3.11: decoded references, and disparities of all methods, at several rates."""
    first = next(iter(curves.values()))
    panels = [
        with_title(first[index].pair.picture, f"reference, {first[index].reference_bpp:.2f} bpp")
        for index in indices
    ]
    for method, points in curves.items():
        for index in indices:
            share = f"{8.0 * points[index].disparity_bytes / points[index].num_pixels:.3f} bpp"
            panels.append(
                with_title(coloured(points[index].pair.disparity, labels), f"{TITLES[method]}, {share}")
            )
    return in_rows(panels, len(indices))


def rendered_panels(views: Views, points: Sequence[Point], view: int) -> Picture:
    """Draw figure 3.12: a view rendered at several rates, and its errors."""
    truth = views.pictures[view]
    tops = [
        with_title(point.rendered[view], f"{point.rate_bpp:.2f} bpp: {point.quality.by_view_db[view]:.2f} dB")
        for point in points
    ]
    bottoms = [
        with_title(difference(point.rendered[view], truth), f"difference, {ERROR_GAIN} times")
        for point in points
    ]
    return in_rows([*tops, with_title(truth, "as the camera saw it"), *bottoms], len(points) + 1)


def decompositions(points: Mapping[str, Point], labels: DisparityLabels) -> Picture:
    """Draw disparities by decomposition."""
    panels = [
        with_title(coloured(point.pair.disparity, labels), f"{label}: {point.quality.pooled_db:.2f} dB")
        for label, point in points.items()
    ]
    return in_rows(panels, len(panels))


def _enlarged(picture: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    resized = cv2.resize(picture, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, np.uint8)
